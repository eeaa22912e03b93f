"""From where one browser looks at the scene: the viewpoints of the steps, by name and by key."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import viser

from fusion_core.model.conventions import FloatArray
from scanloom.client_session import ClientSession
from scanloom.page.layout import covered_px
from scanloom.scene import camera_views
from scanloom.scene.camera_views import CameraView, SceneWindow, StageExtent, stage_extent
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.map_nodes import MapPlane
from scanloom.scene.nodes import SceneNodes
from scanloom.state.view import PanelName

# Windows of about one shape, and as much covered, show the same.
_ASPECT_RATIO, _COVERED = 1.08, 0.02
# The other steps are about the pairs of one camera.
_OF_ALL_CAMERAS: frozenset[PanelName] = frozenset({"Recording", "Map"})
VIEWS = {"Reset view": "R", "From above": "T", "As the camera": "C"}
"""Viewpoints, with their keys."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """What there is to look at.

    ``geometry``: of the displayed frame, None without one; ``together``: what other cameras see at
    the same instant. ``lone_path_m``: (N, 2) the trajectory, where it is all there is. ``map``: the
    transform from the map to the LiDAR's frame and the map's plane, where it is placed.
    """

    geometry: FrameGeometry | None
    together: tuple[FrameGeometry, ...]
    lone_path_m: FloatArray | None
    map: tuple[FloatArray, MapPlane] | None


class SceneViewpoint:
    """Moves a browser's camera, and turns the shapes of ``nodes`` towards it.

    ``subject`` is asked whenever the camera is put somewhere. ``drawing``: the lock of ``nodes``.
    """

    def __init__(
        self,
        camera: viser.CameraHandle,
        session: ClientSession,
        nodes: SceneNodes,
        drawing: threading.RLock,
        subject: Callable[[], Subject],
    ) -> None:
        self._camera, self._session = camera, session
        self._nodes, self._drawing = nodes, drawing
        self._subject = subject
        self._extent: StageExtent | None = None
        # The viewpoint of the step as it was applied, and the window that it was fitted to.
        self._fitted: tuple[CameraView, SceneWindow] | None = None
        # From where the browser's camera was last moved.
        self._left: CameraView | None = None

    @property
    def window(self) -> SceneWindow:
        """What the browser shows of the scene now."""
        return scene_window(self._camera, self._session)

    def reset(self) -> None:
        """Look from the viewpoint of the open step at the current frame."""
        step, subject = self._session.view.panel, self._subject()
        if subject.geometry is not None:
            together = subject.together if step in _OF_ALL_CAMERAS else ()
            self._extent = stage_extent(subject.geometry, together)
        window = self.window
        view = self._step_view(step, subject, window)
        if view is not None:
            self._look(view)
        self._fitted = None if view is None else (view, window)

    def look_by_name(self, name: str) -> None:
        """Look from one of ``VIEWS``."""
        extent, subject = self._extent, self._subject()
        if extent is None or subject.geometry is None:
            return
        frustum = subject.geometry.frustum
        match name:
            case "From above":
                self._look(self._view_from_above(extent, subject, self.window))
            case "As the camera" if frustum is not None:
                self._look(camera_views.from_camera(frustum))
            case _:
                self.reset()

    def camera_moved(self) -> None:
        """Turn the shapes to a person who walks around; fit the view anew as ``fit`` does."""
        # What a browser has told before it was moved may come after that.
        if self._left is not None and camera_views.is_unmoved(self._camera, self._left):
            return
        self._left = None
        if self.fit():
            return
        with self._drawing:
            self._nodes.face(camera_views.view_of(self._camera))

    def fit(self) -> bool:
        """Fit the view anew to a window of another shape, as when its columns are laid out, unless
        a person has moved it; return whether it was."""
        if self._fitted is None:
            return False
        view, before = self._fitted
        now = self.window
        ratio = now.aspect / before.aspect
        covered = max(abs(now.above - before.above), abs(now.below - before.below))
        is_other = max(ratio, 1.0 / ratio) > _ASPECT_RATIO or covered > _COVERED
        if not is_other or not camera_views.is_unmoved(self._camera, view):
            return False
        self.reset()
        return True

    def _step_view(
        self, step: PanelName, subject: Subject, window: SceneWindow
    ) -> CameraView | None:
        extent = self._extent
        if extent is None:
            return None
        if subject.lone_path_m is not None and len(subject.lone_path_m):
            return camera_views.path_from_above(subject.lone_path_m, window)
        if step == "Map":
            return self._view_from_above(extent, subject, window)
        return camera_views.step_view(step, extent, window)

    def _view_from_above(
        self, extent: StageExtent, subject: Subject, window: SceneWindow
    ) -> CameraView:
        """The whole map in the step of the map, else what the LiDAR sees near the rig."""
        if self._session.view.panel == "Map" and subject.map is not None:
            T_lidar_map, plane = subject.map
            return camera_views.map_from_above(T_lidar_map, plane.origin_m, plane.size_m, window)
        return camera_views.from_above(extent, window)

    def _look(self, view: CameraView) -> None:
        with self._drawing, self._session.batch_updates():
            if not camera_views.is_unmoved(self._camera, view):
                self._left = camera_views.view_of(self._camera)
            self._nodes.face(view)
            camera_views.apply(self._camera, view)


def scene_window(camera: viser.CameraHandle, session: ClientSession) -> SceneWindow:
    """What a browser shows of the scene now, and what of it its panels cover."""
    above_px, below_px = covered_px(*session.window_px, is_large=session.view.large_text)
    # The scene is as high as the page. Both sizes of its image are zero in a minimised window.
    height_px = max(session.window_px[1], 1)
    aspect = max(camera.image_width, 1) / max(camera.image_height, 1)
    return SceneWindow(
        width_px=aspect * height_px, height_px=height_px, above_px=above_px, below_px=below_px
    )
