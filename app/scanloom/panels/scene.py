"""The 3D scene: the frame, the map, clicks and the legend."""

import threading
from collections.abc import Callable
from functools import partial

import numpy as np
import viser

from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_quaternion,
    transform_from_planar,
)
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.recorded_poses import PoseLookup
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.jobs.latest_only_worker import LatestOnlyWorker
from scanloom.page.bridge import PageBridge
from scanloom.page_parts import Panel
from scanloom.panels.scene_legend import SceneLegend
from scanloom.panels.scene_viewpoint import VIEWS, SceneViewpoint, Subject
from scanloom.panels.visual_stage import VisualStage
from scanloom.panels.widgets.controls import Controls
from scanloom.plots.theme import LIGHT, theme_of
from scanloom.scene.camera_nodes import TOGETHER_NS
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.frame_stage import (
    StagedCamera,
    depth_span_m,
    other_cameras,
    pose_stamp_ns,
    pose_stamps_ns,
    staged_frame,
    surface_colors,
)
from scanloom.scene.layers import LAYERS, OF_VISUAL_MAP, absent_layers, layers_of_step
from scanloom.scene.map_nodes import MapPlane, map_plane
from scanloom.scene.nodes import SceneNodes
from scanloom.scene.picking import points_in_box
from scanloom.scene.visual_shapes import floor_place
from scanloom.state.hover import Hover
from scanloom.state.possible_steps import map_mode_of, why_not
from scanloom.state.view import Layer, PanelName

# A change of the scene keeps the page from all else for about this long, so what is read out beside
# the pointer goes before it.
_READ_FIRST_S = 0.05
# A beam of the scan and a place of the depth image, down and right, from 0 to 1.
_Pointed = tuple[int | None, tuple[float, float] | None]
_PATH: frozenset[Layer] = frozenset({"map"})


class ScenePanel(Panel):
    """Draws each view in the browser's scene and reads its clicks."""

    def __init__(
        self, client: viser.ClientHandle, bridge: PageBridge, session: ClientSession
    ) -> None:
        gui = client.gui
        self._session = session
        self._camera = client.camera
        self._nodes = SceneNodes(client.scene)
        self.visual = VisualStage(client, session)
        self._geometry: FrameGeometry | None = None
        self._coloring: tuple[PanelName, bool] | None = None
        # What each camera saw last.
        self._seen: dict[int, FrameGeometry] = {}
        self._depth_span_m = (0.5, 8.0)
        # The recording and the step that the browser's camera was moved for.
        self._opened: tuple[object, bool] = None, False
        self._seen_step: PanelName | None = None
        # Nodes are drawn in the session's worker, and turned and picked in viser's threads.
        self._drawing = threading.RLock()
        self.viewpoint = SceneViewpoint(
            client.camera, session, self._nodes, self._drawing, self._subject
        )
        self._closed = threading.Event()
        self._pointing = LatestOnlyWorker(
            f"pointer {client.client_id}", self._point_at, session.show_failure
        )
        self._grid: OccupancyGrid | None = None
        self._plane: MapPlane | None = None
        self._map_poses: PoseLookup | None = None
        self._differing_m: FloatArray | None = None
        self._map_theme = LIGHT
        self._T_lidar_map: FloatArray | None = None
        self._path_of: object = None
        # (N, 2) the trajectory, in the map.
        self._path_m: FloatArray = np.empty((0, 2))
        self._is_of_poses = False
        self._views = gui.add_button_group(
            "View",
            tuple(VIEWS),
            hint="The step's own viewpoint (R), straight down (T), from the depth camera (C)",
        )
        self._controls = Controls(gui, session)
        self._rows = gui.add_slider(
            "Every k-th row",
            min=1,
            max=40,
            step=1,
            initial_value=session.view.row_step,
            hint="Rows of the depth image that are drawn in 3D",
        )
        self._legend = SceneLegend(gui, bridge, session)
        self._controls.bind_field(self._rows, "row_step", int)
        self._views.on_click(lambda _: self._look_by_name(self._views.value))
        for name, key in VIEWS.items():
            bridge.add_key(name, key, partial(self._look_by_name, name))
        client.scene.on_click()(self._clicked)
        self._scene = client.scene
        self._is_boxed = False
        client.camera.on_update(self._camera_moved)

    def set_map(
        self,
        grid: OccupancyGrid | None,
        poses: PoseLookup | None = None,
        differing_m: FloatArray | None = None,
    ) -> None:
        """The map, None for none; from the Map panel. ``poses``: the LiDAR's in that map, where
        they are not the recorded ones. ``differing_m``: as of ``MapNodes.show``."""
        is_first = self._grid is None and grid is not None
        self._grid, self._map_poses, self._differing_m = grid, poses, differing_m
        self._plane = None if grid is None else map_plane(grid, self._map_theme)
        with self._drawing:
            self._nodes.map.show(self._plane, differing_m)
        self._path_of = None
        if is_first and self._seen_step == "Map":
            # It is what the step is about: look at it once it is placed.
            self._seen_step = None

    def show(self, frame_view: FrameView) -> None:
        """Draw the frame, without pairs if it could not be matched."""
        view, is_dark = frame_view.view, frame_view.is_dark
        self._controls.show(view)
        step = self._shown_step(frame_view)
        self._rows.visible = "rows" in layers_of_step(step, frozenset())
        layers = layers_of_step(step, view.hidden_layers)
        staged = staged_frame(frame_view, with_rows="rows" in layers)
        if _is_of_poses_alone(frame_view):
            # The trajectory is all there is, in any step.
            layers |= _PATH - view.hidden_layers
        absent = frozenset[Layer]() if staged is None else absent_layers(staged.geometry)
        if frame_view.open_recording.has_turning_lidar:
            absent = frozenset(LAYERS)
        is_visual = self._is_visual(frame_view)
        self.visual.show(OF_VISUAL_MAP - view.hidden_layers, is_dark=is_dark, is_seen=is_visual)
        if is_visual:
            # The frame has no place in that map.
            step, staged, absent = "Map", None, frozenset(LAYERS) - OF_VISUAL_MAP
            layers = frozenset()
            self._seen_step = None
        self._legend.show(step, view, is_dark, absent)
        self._offer_box(is_offered=frame_view.review is not None)
        theme = theme_of(is_dark=is_dark)
        if theme is not self._map_theme:
            self._map_theme = theme
            if self._grid is not None:
                self.set_map(self._grid, self._map_poses, self._differing_m)
        with self._drawing:
            self._nodes.set_dark(is_dark)
            self._nodes.show_layers(layers)
            if staged is None:
                # The current nodes belong to another frame.
                self._geometry = None
                self._nodes.hide_frame()
            else:
                self._draw(frame_view, staged)

    def _is_visual(self, frame_view: FrameView) -> bool:
        """Whether the scene shows a map of visual SLAM instead of the frame."""
        view = frame_view.view
        is_slam = map_mode_of(view, frame_view.open_recording) == "SLAM"
        return view.panel == "Map" and is_slam and self.visual.has_map

    def show_hover(self, frame_view: FrameView, hover: Hover) -> None:
        """Light up what is pointed at: its beam, and its pixel's point."""
        place, match = None, frame_view.match
        if hover.row is not None and hover.column is not None and match is not None:
            height, width = match.depth_m.shape
            place = (hover.row + 0.5) / height, (hover.column + 0.5) / width
        self._pointing.submit((hover.beam, place))

    def close(self) -> None:
        """Follow the pointer no more."""
        self._closed.set()
        self._pointing.close()
        self.visual.close()

    def _point_at(self, pointed: _Pointed, is_newest: Callable[[], bool]) -> None:
        self._closed.wait(_READ_FIRST_S)
        if is_newest():
            with self._drawing, self._session.batch_updates():
                self._nodes.mark_hover(*pointed)

    def _shown_step(self, frame_view: FrameView) -> PanelName:
        step = frame_view.view.panel
        # Until there is a map, its step shows what it is made from. A step that has nothing to work
        # on shows what there is.
        has_no_map = step == "Map" and self._grid is None
        is_off = bool(why_not(step, frame_view.open_recording))
        return "Recording" if has_no_map or is_off else step

    def _draw(self, frame_view: FrameView, staged: StagedCamera) -> None:
        geometry = staged.geometry
        self._is_of_poses = _is_of_poses_alone(frame_view)
        # A guessed mount may look elsewhere than the one that is found.
        is_guessed = frame_view.raw is not None and not frame_view.raw.is_mount_recorded
        if self._opened != (frame_view.open_recording, is_guessed):
            self._opened = frame_view.open_recording, is_guessed
            self._seen_step = None
            self._nodes.clear()
            self.set_map(self._grid, self._map_poses, self._differing_m)
            self._depth_span_m = depth_span_m(geometry)
            self._seen = {}
        coloring = frame_view.view.panel, frame_view.is_dark
        if coloring != self._coloring:
            # What other cameras saw is to be coloured anew.
            self._coloring, self._seen = coloring, {}
        for other in other_cameras(frame_view, self._is_shown):
            colors = surface_colors(other, frame_view, self._depth_span_m)
            self._nodes.show_camera(other.geometry, colors)
            self._remember(other.geometry)
        self._geometry = geometry
        self._remember(geometry)
        self._nodes.show(geometry, surface_colors(staged, frame_view, self._depth_span_m))
        self._nodes.mark_beam(frame_view.view.selected_beam)
        self._update_map(frame_view)
        if self._seen_step != frame_view.view.panel:
            self._seen_step = frame_view.view.panel
            self.viewpoint.reset()
        else:
            # The page may have told its size.
            self.viewpoint.fit()

    def _remember(self, geometry: FrameGeometry) -> None:
        if geometry.camera is not None:
            self._seen[geometry.camera] = geometry

    def _is_shown(self, camera: int, stamp_ns: int) -> bool:
        """Whether the scene shows what a camera saw at about an instant."""
        seen = self._seen.get(camera)
        return seen is not None and abs(seen.stamp_ns - stamp_ns) <= TOGETHER_NS

    def _update_map(self, frame_view: FrameView) -> None:
        """Place map and trajectory around the LiDAR, if the recording has poses. Of odometry alone
        the trajectory stays where it is, and the robot moves along it."""
        poses, stamp_ns = None, pose_stamp_ns(frame_view)
        is_robot = _is_of_poses_alone(frame_view)
        if self._grid is not None or is_robot:
            poses = frame_view.open_recording.poses if self._map_poses is None else self._map_poses
        if poses is None or stamp_ns is None:
            self._nodes.map.place(None)
            return
        if self._path_of is not poses:
            self._path_of = poses
            found = [poses.at(int(stamp)) for stamp in pose_stamps_ns(frame_view)]
            path = [pose for pose in found if pose is not None]
            self._path_m = np.array(path).reshape(-1, 3)[:, :2]
            self._nodes.map.show_path(self._path_m)
        pose = poses.at(stamp_ns)
        if is_robot:
            self._nodes.map.place(np.eye(4))
            return
        T_map_lidar = None if pose is None else transform_from_planar(pose)
        self._T_lidar_map = None if T_map_lidar is None else invert_transform(T_map_lidar)
        self._nodes.map.place(T_map_lidar)

    def _subject(self) -> Subject:
        geometry, plane, T_lidar_map = self._geometry, self._plane, self._T_lidar_map
        together: tuple[FrameGeometry, ...] = ()
        if geometry is not None:
            together = tuple(
                seen
                for camera, seen in self._seen.items()
                if self._is_shown(camera, geometry.stamp_ns) and seen is not geometry
            )
        return Subject(
            geometry=geometry,
            together=together,
            lone_path_m=self._path_m if self._is_of_poses else None,
            map=None if plane is None or T_lidar_map is None else (T_lidar_map, plane),
        )

    def _look_by_name(self, name: str) -> None:
        if self.visual.is_seen:
            self.visual.look_by_name(name)
        else:
            self.viewpoint.look_by_name(name)

    def _camera_moved(self, _: viser.CameraHandle) -> None:
        if self.visual.is_seen:
            self.visual.camera_moved()
        else:
            self.viewpoint.camera_moved()

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        # A browser may send any numbers.
        if not (np.isfinite(origin).all() and np.isfinite(direction).all()):
            return
        if self.visual.is_seen:
            self.visual.clicked(origin, direction)
            return
        with self._drawing:
            beam = self._nodes.pick(origin, direction)
            place_m = self._map_place(origin, direction)
        if place_m is not None:
            self.mark_cell(place_m)
            self.visual.on_place(place_m)
        if beam is not None:
            self._session.change(selected_beam=beam)

    def mark_cell(self, place_m: FloatArray) -> None:
        """Outline the map's cell at an (x, y)."""
        if self.visual.is_seen:
            self.visual.mark_cell(place_m)
            return
        with self._drawing:
            self._nodes.map.mark_cell(place_m)

    def _map_place(self, origin: FloatArray, direction: FloatArray) -> FloatArray | None:
        """(2,) where a click's ray meets the map, in the map; None where none is seen."""
        is_map_seen = self._session.view.panel == "Map" and self._grid is not None
        place_m = floor_place(origin, direction) if is_map_seen else None
        T_lidar_map = self._T_lidar_map
        if place_m is None or T_lidar_map is None:
            return None
        in_map: FloatArray = (invert_transform(T_lidar_map) @ [*place_m, 0.0, 1.0])[:2]
        return in_map

    def _offer_box(self, *, is_offered: bool) -> None:
        """A drag with Shift draws a box in the review; elsewhere it turns the scene."""
        if is_offered == self._is_boxed:
            return
        self._is_boxed = is_offered
        if is_offered:
            self._scene.on_rect_select(modifier="shift")(self._boxed)
        else:
            self._scene.remove_rect_select_callback(self._boxed)

    def _boxed(self, event: viser.SceneRectSelectEvent) -> None:
        """In the review, mark the beams that end within the box."""
        review, geometry = self._session.active_review, self._geometry
        box = (*event.screen_min, *event.screen_max)
        if review is None or geometry is None or not np.isfinite(box).all():
            return
        w, x, y, z = map(float, self._camera.wxyz)
        T_world_camera = make_transform(
            rotation_from_quaternion(x, y, z, w), np.array(self._camera.position)
        )
        beams = points_in_box(
            geometry.beams_m, T_world_camera, self._camera.fov, self.viewpoint.window.aspect, box
        )
        review.mark_beams(beams.tolist(), is_added=False)


def _is_of_poses_alone(frame_view: FrameView) -> bool:
    """Whether the recording has neither scans nor depth images, but poses."""
    return frame_view.lone is not None and frame_view.lone.scan is None
