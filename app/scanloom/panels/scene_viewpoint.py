"""From where one browser looks at the scene: the viewpoints of the steps, by name and by key."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser

from fusion_core.model.conventions import FloatArray
from scanloom.client_session import ClientSession
from scanloom.scene import camera_views
from scanloom.scene.camera_views import CameraView, StageExtent, stage_extent
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.map_nodes import MapPlane
from scanloom.scene.nodes import SceneNodes
from scanloom.state.view import PanelName

# A camera that stands nearer than this to where it was put has not been moved by a person.
_UNMOVED_M = 0.02
# Screens of about one shape show the same.
_ASPECT_RATIO = 1.08
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
        # The viewpoint of the step as it was applied, and the screen's shape that it was fitted to.
        self._fitted: tuple[CameraView, float] | None = None

    @property
    def aspect(self) -> float:
        """Width over height of the screen."""
        # The size is zero in a minimised window.
        return max(self._camera.image_width, 1) / max(self._camera.image_height, 1)

    def reset(self) -> None:
        """Look from the viewpoint of the open step at the current frame."""
        step, subject = self._session.view.panel, self._subject()
        if subject.geometry is not None:
            together = subject.together if step in _OF_ALL_CAMERAS else ()
            self._extent = stage_extent(subject.geometry, together)
        aspect, view = self.aspect, self._step_view(step, subject)
        if view is not None:
            self._look(view)
        self._fitted = None if view is None else (view, aspect)

    def look_by_name(self, name: str) -> None:
        """Look from one of ``VIEWS``."""
        extent, subject = self._extent, self._subject()
        if extent is None or subject.geometry is None:
            return
        frustum = subject.geometry.frustum
        match name:
            case "From above":
                self._look(self._view_from_above(extent, subject))
            case "As the camera" if frustum is not None:
                self._look(camera_views.from_camera(frustum))
            case _:
                self.reset()

    def camera_moved(self) -> None:
        """Turn the shapes to a person who walks around; fit the view anew to a screen of another
        shape, as when its columns are laid out, unless a person has moved it."""
        camera = self._camera
        if self._fitted is not None:
            view, aspect = self._fitted
            is_ours = np.linalg.norm(np.array(camera.position) - view.position_m) < _UNMOVED_M
            ratio = self.aspect / aspect
            if is_ours and max(ratio, 1.0 / ratio) > _ASPECT_RATIO:
                self.reset()
                return
        with self._drawing:
            self._nodes.face(
                CameraView(
                    position_m=np.array(camera.position),
                    look_at_m=np.array(camera.look_at),
                    up=np.array(camera.up_direction),
                    fov_rad=camera.fov,
                )
            )

    def _step_view(self, step: PanelName, subject: Subject) -> CameraView | None:
        extent = self._extent
        if extent is None:
            return None
        if subject.lone_path_m is not None and len(subject.lone_path_m):
            return camera_views.path_from_above(subject.lone_path_m, self.aspect)
        if step == "Map":
            return self._view_from_above(extent, subject)
        return camera_views.step_view(step, extent, self.aspect)

    def _view_from_above(self, extent: StageExtent, subject: Subject) -> CameraView:
        """The whole map in the step of the map, else what the LiDAR sees near the rig."""
        if self._session.view.panel == "Map" and subject.map is not None:
            T_lidar_map, plane = subject.map
            return camera_views.map_from_above(
                T_lidar_map, plane.origin_m, plane.size_m, self.aspect
            )
        return camera_views.from_above(extent, self.aspect)

    def _look(self, view: CameraView) -> None:
        with self._drawing, self._session.batch_updates():
            self._nodes.face(view)
            camera_views.apply(self._camera, view)
