"""The map of visual SLAM on one browser's stage: as much of its cloud as the view needs."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import viser

from fusion_core.model.conventions import FloatArray
from scanloom.client_session import ClientSession
from scanloom.jobs.latest_only_worker import LatestOnlyWorker
from scanloom.panels.scene_viewpoint import scene_window
from scanloom.scene import camera_views
from scanloom.scene.camera_views import CameraView
from scanloom.scene.level_of_detail import POINTS_MAX, DetailLevels, point_width_m
from scanloom.scene.map_nodes import MapPlane
from scanloom.scene.visual_nodes import PickedKeyframe, VisualNodes
from scanloom.scene.visual_picture import VisualPicture
from scanloom.scene.visual_shapes import Boxes, HalfView, floor_place, nearest_keyframe
from scanloom.state.view import Layer

# A camera that is being moved is waited for: each cloud is some megabytes.
_REST_S = 0.25
_OVERDUE_S = 1.0
# A click this far beside a keyframe still means it.
_CLICK_M = 0.07
# From a camera's place to the edges of its drawing.
_CAMERA_M = 0.15
# A map that grows by less of its size is still seen nearly whole.
_OUTGROWN = 0.04


@dataclass(frozen=True, slots=True)
class _Look:
    """Where a browser's camera looks at which cloud."""

    view: CameraView
    aspect: float
    cloud: DetailLevels | None


class VisualStage:
    """Draws what a panel gives it, in the map; ``draw`` and the camera's moves choose the points.

    ``on_keyframe``, ``on_place``: called with the keyframe, or the (2,) place on the floor, that a
    person has clicked, in viser's threads.
    """

    def __init__(self, client: viser.ClientHandle, session: ClientSession) -> None:
        self._session, self._camera = session, client.camera
        self._nodes = VisualNodes(client.scene)
        self._drawing = threading.RLock()
        self._picture: VisualPicture | None = None
        self._cloud: DetailLevels | None = None
        self._now: FloatArray | None = None
        self._sent_s = 0.0
        self._placed: tuple[CameraView, tuple[FloatArray, FloatArray]] | None = None
        self._is_seen, self._floor_m = False, 0.0
        self._plane: MapPlane | None = None
        self._closed = threading.Event()
        self.on_keyframe: Callable[[int], None] = lambda _: None
        self.on_place: Callable[[FloatArray], None] = lambda _: None
        self.on_points: Callable[[int, int], None] = lambda sent, total: None
        self._sending = LatestOnlyWorker(
            f"cloud {client.client_id}", self._send_cloud, session.show_failure
        )

    @property
    def has_map(self) -> bool:
        """Whether there is a map to be seen."""
        return self._picture is not None

    def draw(
        self, picture: VisualPicture | None, half_view: HalfView | None = None, *, is_new: bool
    ) -> None:
        """Show a map, None for none. ``is_new``: another one, not the same grown on, which the
        camera is moved for."""
        with self._drawing:
            before, self._picture = self._picture, picture
            self._nodes.show(picture, half_view)
            self._now = None if picture is None else picture.now
            if picture is None:
                self._cloud = None
                return
            if before is None or before.points_m is not picture.points_m:
                self._cloud = DetailLevels(picture.points_m, picture.rgb)
        if is_new or before is None or self._has_outgrown(picture):
            self.look()
        self._sending.submit(self._look_now())

    def draw_boxes(self, boxes: Boxes | None) -> None:
        """Boxes instead of the cloud; None for the cloud."""
        with self._drawing:
            self._nodes.draw_boxes(boxes)
        if boxes is None and self._picture is not None:
            self._sending.submit(self._look_now())

    def show_grid(self, plane: MapPlane | None, floor_m: float = 0.0) -> None:
        """A grid on the floor, None for none. ``floor_m``: z of the floor in the map."""
        with self._drawing:
            self._plane, self._floor_m = plane, floor_m
            self._nodes.show_grid(plane, floor_m)

    def pick(self, frusta: Sequence[PickedKeyframe]) -> None:
        """The picked keyframes: their poses, images and colours."""
        with self._drawing:
            self._nodes.pick(frusta)

    def mark_now(self, T_map_camera: FloatArray | None) -> None:
        """Where the camera is at the displayed frame."""
        with self._drawing:
            self._now = T_map_camera
            self._nodes.mark_now(T_map_camera)

    def show(self, layers: frozenset[Layer], *, is_dark: bool, is_seen: bool) -> None:
        """Show these layers of the map where it ``is_seen``."""
        with self._drawing:
            is_entered = is_seen and not self._is_seen
            is_cloud_back = "cloud" in layers and not self._nodes.shows("cloud")
            self._is_seen = is_seen
            self._nodes.set_dark(is_dark=is_dark)
            self._nodes.show_layers(layers if is_seen else frozenset(), is_seen=is_seen)
        if is_entered and self.has_map:
            self.look()
        if (is_entered or is_cloud_back) and self.has_map:
            self._sending.submit(self._look_now())

    @property
    def is_seen(self) -> bool:
        """Whether the scene shows the map now."""
        return self._is_seen and self._picture is not None

    def look_by_name(self, name: str) -> None:
        """Look from one of the scene's viewpoints."""
        picture = self._picture
        match name:
            case "From above":
                self.look_from_above()
            case "As the camera" if picture is not None and self._now is not None:
                self.look_from(self._now)
            case _:
                self.look()

    def look(self) -> None:
        """Look at the whole map from behind and above where the camera has been."""
        picture = self._picture
        if picture is None or not self._is_seen:
            return
        extent_m = _extent_m(picture)
        window = scene_window(self._camera, self._session)
        view = camera_views.overview(extent_m, _heading(picture), window)
        self._go(view)
        self._placed = view, extent_m

    def _has_outgrown(self, picture: VisualPicture) -> bool:
        """Whether a growing map leaves the screen of a camera that nobody has moved."""
        if self._placed is None:
            return False
        view, (low_m, high_m) = self._placed
        now_low_m, now_high_m = _extent_m(picture)
        grown = np.maximum(low_m - now_low_m, now_high_m - high_m).max()
        is_outgrown = bool(grown > _OUTGROWN * np.max(high_m - low_m))
        return is_outgrown and camera_views.is_unmoved(self._camera, view)

    def look_from_above(self) -> None:
        """Straight down on the whole map."""
        picture = self._picture
        if picture is not None and self._is_seen:
            low_m, high_m = (edge_m[:2] for edge_m in _extent_m(picture))
            if self._plane is not None:
                low_m = np.minimum(low_m, self._plane.origin_m)
                high_m = np.maximum(high_m, self._plane.origin_m + self._plane.size_m)
            corner_m, size_m = (float(low_m[0]), float(low_m[1])), high_m - low_m
            window = scene_window(self._camera, self._session)
            self._go(camera_views.map_from_above(np.eye(4), corner_m, size_m, window))

    def look_from(self, T_map_camera: FloatArray) -> None:
        """As a camera of the map sees."""
        if self._is_seen:
            self._go(camera_views.from_optical_frame(T_map_camera))

    def camera_moved(self) -> None:
        """Choose the points anew, once the browser's camera rests."""
        if self._is_seen and self._picture is not None:
            self._sending.submit(self._look_now())

    def clicked(self, ray_origin_m: FloatArray, ray_direction: FloatArray) -> None:
        """Take a click's ray for the keyframe that it hits, else for a place on the floor."""
        picture = self._picture
        if picture is None or not self._is_seen:
            return
        keyframe = nearest_keyframe(picture.T_map_keyframe, ray_origin_m, ray_direction, _CLICK_M)
        if keyframe is not None and self._nodes.shows("keyframes"):
            self.on_keyframe(keyframe)
            return
        place_m = floor_place(ray_origin_m, ray_direction, self._floor_m)
        if place_m is not None:
            self.mark_cell(place_m)
            self.on_place(place_m)

    def mark_cell(self, place_m: FloatArray) -> None:
        """Outline the grid's cell at an (x, y)."""
        with self._drawing:
            self._nodes.mark_cell(place_m)

    def close(self) -> None:
        """Send nothing more."""
        self._closed.set()
        self._sending.close()

    def _send_cloud(self, look: _Look, is_newest: Callable[[], bool]) -> None:
        """Send the points of the cloud that the view needs."""
        self._closed.wait(_REST_S)
        cloud = look.cloud
        # A map that grows, or a camera that never rests, must not keep the cloud back for ever.
        is_overdue = time.monotonic() - self._sent_s > _OVERDUE_S
        if cloud is None or not self._nodes.wants_cloud or not (is_newest() or is_overdue):
            return
        chosen = cloud.seen_from(look.view, look.aspect, POINTS_MAX)
        points_m, rgb = cloud.points_m[chosen], cloud.rgb[chosen]
        width_m = point_width_m(points_m)
        with self._drawing, self._session.batch_updates():
            if self._cloud is None or self._closed.is_set():
                return
            self._nodes.draw_cloud(points_m, rgb, width_m)
        self._sent_s = time.monotonic()
        self.on_points(len(chosen), len(cloud.points_m))

    def _look_now(self) -> _Look:
        view = camera_views.view_of(self._camera)
        return _Look(view, scene_window(self._camera, self._session).aspect, self._cloud)

    def _go(self, view: CameraView) -> None:
        with self._session.batch_updates():
            camera_views.apply(self._camera, view)


def _extent_m(picture: VisualPicture) -> tuple[FloatArray, FloatArray]:
    """(3,) least and greatest x, y, z of nearly all points, and of the whole trajectory with the
    camera at its end."""
    parts = [picture.path_m, picture.points_m[:: max(1, len(picture.points_m) // 5000)]]
    points_m = np.concatenate(parts).astype(np.float64)
    points_m = points_m[np.isfinite(points_m).all(axis=1)]
    if not len(points_m):
        return np.full(3, -2.0), np.full(3, 2.0)
    low_m, high_m = np.percentile(points_m, [1.0, 99.0], axis=0)
    path_m = picture.path_m[np.isfinite(picture.path_m).all(axis=1)]
    if len(path_m):
        low_m = np.minimum(low_m, path_m.min(axis=0) - _CAMERA_M)
        high_m = np.maximum(high_m, path_m.max(axis=0) + _CAMERA_M)
    return low_m, np.maximum(high_m, low_m + 0.5)


def _heading(picture: VisualPicture) -> FloatArray:
    """(2,) the horizontal direction in which the keyframes look on the whole."""
    if not len(picture.T_map_keyframe):
        return np.array([1.0, 0.0])
    ahead: FloatArray = picture.T_map_keyframe[:, :2, 2].mean(axis=0)
    length = float(np.linalg.norm(ahead))
    return ahead / length if length > 0.2 else np.array([1.0, 0.0])
