"""The 3D scene: the frame, the image planes of heatmap and depth, clicks, and camera presets."""

import threading
from collections.abc import Callable

import numpy as np
import viser

from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import invert_transform, transform_from_planar
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.recorded_poses import PoseLookup
from scanloom.client_session import ClientSession, Panel
from scanloom.frame_view import FrameView
from scanloom.panels.widgets.controls import Controls
from scanloom.plots.depth_image import DepthPicture, PairOverlay, depth_picture
from scanloom.plots.grid_image import grid_texture
from scanloom.plots.heatmap import Heatmap
from scanloom.plots.pair_pixels import pixels_of_match, repaired_depth_m
from scanloom.scene import camera_views
from scanloom.scene.color_picture import upright_color
from scanloom.scene.frame_geometry import (
    FrameGeometry,
    UnmatchedFrame,
    frame_geometry,
    unmatched_geometry,
)
from scanloom.scene.image_planes import ImagePlane, Layout, layout_of
from scanloom.scene.layers import LAYERS, Layer
from scanloom.scene.nodes import MapPlane, PickResult, SceneNodes

_VIEWS = ("3D", "Curve", "From above", "Heatmap", "Depth")
_PLANE_PX = (560, 470)


class ScenePanel(Panel):
    """Draws each view in the browser's scene and reads its clicks."""

    def __init__(self, client: viser.ClientHandle, session: ClientSession) -> None:
        gui = client.gui
        self._session = session
        self._camera = client.camera
        self._nodes = SceneNodes(client.scene)
        self._layout: Layout | None = None
        self._opened: object = None
        self._planes: dict[str, ImagePlane] = {}
        self._hidden: frozenset[Layer] = frozenset()
        # Nodes are drawn in the session's worker, and switched and picked in viser's threads.
        self._drawing = threading.RLock()
        self._draw_heatmap: Callable[[], Heatmap] | None = None
        self._heatmap: Heatmap | None = None
        self._grid: OccupancyGrid | None = None
        self._map_poses: PoseLookup | None = None
        self._T_lidar_map: FloatArray | None = None
        self._path_of: object = None
        self._depth: DepthPicture | None = None
        # The frame and options of the last drawing.
        self._depth_of: tuple[object, object] = None, None
        self._are_planes_visible = True
        self._views = gui.add_button_group("View", _VIEWS, hint="Viewpoint of the scene")
        with gui.add_folder("Shown in 3D", expand_by_default=False):
            rows = gui.add_slider(
                "Every k-th row", min=1, max=40, step=1, initial_value=session.view.row_step
            )
            switches = {name: gui.add_checkbox(name.capitalize(), True) for name in LAYERS}
        self._controls = Controls(gui, session)
        self._controls.bind_field(rows, "row_step", int)

        self._switches = switches
        for box in switches.values():
            box.on_update(lambda _: self._show_layers())
        self._views.on_click(lambda _: self._look(self._views.value))
        client.scene.on_click()(self._clicked)

    def set_heatmap_source(self, draw: Callable[[], Heatmap] | None) -> None:
        """Set the function that draws the heatmap's image plane when visible; None for none."""
        self._draw_heatmap = draw

    def set_map(self, grid: OccupancyGrid | None, poses: PoseLookup | None = None) -> None:
        """The map on the floor, None for none; from the Map panel. ``poses``: the LiDAR's in that
        map, where they are not the recorded ones."""
        self._grid, self._map_poses = grid, poses
        with self._drawing:
            self._nodes.show_map(None if grid is None else _plane_of(grid))
        self._path_of = None

    def show(self, frame_view: FrameView) -> None:
        """Draw the frame, without pairs if it could not be matched."""
        self._controls.show(frame_view.view)
        geometry = _geometry(frame_view)
        with self._drawing:
            if geometry is not None and frame_view.chain is not None:
                self._draw(frame_view, geometry, frame_view.chain.alignment.mount.yaw_rad)
            else:
                # The current nodes belong to another frame.
                self._nodes.hide_frame()
                self._show_planes(frame_view)

    def _draw(self, frame_view: FrameView, geometry: FrameGeometry, yaw_rad: float) -> None:
        if self._opened is not frame_view.open_recording:
            self._opened = frame_view.open_recording
            self._nodes.clear()
            self._planes = {}
            self.set_map(self._grid, self._map_poses)
            self._layout = layout_of(geometry, yaw_rad)
            self._look("3D")
        self._nodes.show(geometry)
        if frame_view.color is not None:
            rgb = upright_color(
                frame_view.color.rgb, frame_view.open_recording.fuse_session.rig, geometry.camera
            )
            self._nodes.show_color(geometry.camera, rgb)
        self._nodes.mark_beam(frame_view.view.selected_beam)
        self._update_map(frame_view)
        self._show_planes(frame_view)

    def _update_map(self, frame_view: FrameView) -> None:
        """Place map and trajectory around the LiDAR, if the recording has poses."""
        poses = None
        if self._grid is not None:
            poses = frame_view.open_recording.poses if self._map_poses is None else self._map_poses
        if poses is None or frame_view.match is None:
            self._nodes.place_map(None)
            return
        if self._path_of is not poses:
            self._path_of = poses
            found = [poses.at(int(stamp)) for stamp in frame_view.open_recording.frames.times_ns]
            path = [pose for pose in found if pose is not None]
            self._nodes.show_path(np.array(path).reshape(-1, 3)[:, :2])
        pose = poses.at(frame_view.match.scan.stamp_ns)
        T_map_lidar = None if pose is None else transform_from_planar(pose)
        self._T_lidar_map = None if T_map_lidar is None else invert_transform(T_map_lidar)
        self._nodes.place_map(T_map_lidar)

    def _show_planes(self, frame_view: FrameView) -> None:
        if self._layout is None or not self._are_planes_visible:
            return
        view, frame = frame_view.view, frame_view.frame or frame_view.paired
        inputs = (view.frame_index, view.show_repaired, view.visible_classes, view.selected_beam)
        if self._depth_of[0] is not frame or self._depth_of[1] != inputs:
            self._depth_of = frame, inputs
            self._depth = _depth(frame_view)
        self._heatmap = None if self._draw_heatmap is None else self._draw_heatmap()
        image_planes = {}
        if self._depth is not None:
            image_planes["depth"] = self._layout.depth_plane(self._depth.rgb)
        if self._heatmap is not None:
            image_planes["heatmap"] = self._layout.heatmap_plane(self._heatmap.rgb)
        for name in self._planes.keys() - image_planes.keys():
            self._nodes.hide_image_plane(name)
        for image_plane in image_planes.values():
            self._nodes.show_image_plane(image_plane)
        self._planes = image_planes

    def _look(self, name: str) -> None:
        if self._layout is None:
            return
        match name:
            case "Curve":
                view = camera_views.curve(self._layout)
            case "From above" if self._grid is not None and self._T_lidar_map is not None:
                plane = _plane_of(self._grid)
                view = camera_views.map_from_above(self._T_lidar_map, plane.origin_m, plane.size_m)
            case "From above":
                self._session.notify("There is no map yet", "Build it in the Map panel.")
                return
            case "Heatmap" | "Depth" if name.lower() in self._planes:
                view = camera_views.face_plane(self._planes[name.lower()])
            case _:
                # The size is zero in a minimised window.
                aspect = max(self._camera.image_width, 1) / max(self._camera.image_height, 1)
                view = camera_views.perspective(self._layout, aspect)
        self._hidden = view.hides
        with self._session.batch_updates():
            self._show_layers()
            camera_views.apply(self._camera, view)

    def _show_layers(self) -> None:
        """Show the layers that are on and visible from the camera preset."""
        chosen = frozenset(name for name, box in self._switches.items() if box.value)
        are_visible = "images" in chosen - self._hidden
        with self._drawing:
            self._nodes.show_layers(chosen - self._hidden)
            were_visible, self._are_planes_visible = self._are_planes_visible, are_visible
        if are_visible and not were_visible:
            # Hidden pictures are not updated.
            self._session.refresh()

    def _clicked(self, event: viser.SceneClickEvent) -> None:
        origin, direction = np.array(event.ray_origin), np.array(event.ray_direction)
        # A browser may send any numbers.
        if not (np.isfinite(origin).all() and np.isfinite(direction).all()):
            return
        with self._drawing:
            picked = self._nodes.pick(origin, direction)
        if picked is not None:
            self._apply_pick(picked)

    def _apply_pick(self, picked: PickResult) -> None:
        if picked.beam is not None:
            self._session.change(selected_beam=picked.beam)
        elif picked.plane == "heatmap" and self._heatmap is not None and picked.pixel is not None:
            place = self._heatmap.offset_at(*picked.pixel)
            if place is not None:
                self._session.change_settings(picked_offset=place)
        elif picked.plane == "depth" and self._depth is not None and picked.pixel is not None:
            pixel = self._depth.pixel_at(*picked.pixel)
            if pixel is not None:
                self._session.change(selected_beam=self._beam_near(*pixel))

    def _beam_near(self, row: int, column: int) -> int | None:
        match = self._session.frame_view.match if self._session.frame_view is not None else None
        return None if match is None else pixels_of_match(match).beam_near(row, column)


def _plane_of(grid: OccupancyGrid) -> MapPlane:
    x_m, y_m = map(float, grid.origin_m)
    return MapPlane(picture=grid_texture(grid), resolution_m=grid.resolution_m, origin_m=(x_m, y_m))


def _geometry(frame_view: FrameView) -> FrameGeometry | None:
    chain, view = frame_view.chain, frame_view.view
    if chain is None or frame_view.paired is None:
        return None
    rig = frame_view.open_recording.fuse_session.rig
    if frame_view.frame is not None:
        return frame_geometry(
            frame_view.frame,
            rig,
            chain.alignment,
            row_step=view.row_step,
            classes=view.visible_classes,
            repaired=view.show_repaired,
        )
    paired = frame_view.paired
    unmatched = UnmatchedFrame(
        camera=paired.camera,
        stamp_ns=paired.image.stamp_ns,
        depth_m=frame_view.open_recording.fuse_session.depth_of(
            paired.camera, paired.image.depth_m
        ),
        scan=None if paired.window is None else paired.window.scan,
    )
    return unmatched_geometry(unmatched, rig, chain.alignment, row_step=view.row_step)


def _depth(frame_view: FrameView) -> DepthPicture | None:
    """The depth image, with its pairs if the frame was matched."""
    view, paired = frame_view.view, frame_view.paired
    match = frame_view.match
    title = f"Depth, frame {view.frame_index}"
    if match is not None:
        depth_m, pairs = match.depth_m, pixels_of_match(match, frame_view.fused)
    elif paired is not None:
        depth_m, pairs = (
            frame_view.open_recording.fuse_session.depth_of(paired.camera, paired.image.depth_m),
            None,
        )
    else:
        return None
    if frame_view.fused is not None and view.show_repaired:
        depth_m, title = repaired_depth_m(frame_view.fused), f"{title}, repaired"
    overlay = None
    if pairs is not None:
        overlay = PairOverlay(pixels=pairs, classes=view.visible_classes, beam=view.selected_beam)
    width_px, height_px = _PLANE_PX
    return depth_picture(title, depth_m, overlay, width_px=width_px, height_px=height_px)
