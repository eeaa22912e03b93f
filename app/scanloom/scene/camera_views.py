"""The viewpoints of the steps, chosen so that what a step is about fills the screen."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np
import numpy.typing as npt

from fusion_core.model.conventions import Float32Array, FloatArray, read_only
from fusion_core.model.geometry import rotation_from_quaternion, rotation_from_yaw_pitch_roll
from fusion_core.model.geometry import transform_points as apply_transform
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.geometry import Frustum
from scanloom.scene.glyphs import USUAL_FOV_RAD, facing
from scanloom.state.view import PanelName

# Narrow: from far above, what lies above or below the plane hardly moves sideways.
_ABOVE_FOV_RAD = float(np.deg2rad(20.0))
_LEAST_ASPECT = 0.3
# Of a window too low for what lies over it, so much is taken to be free.
_LEAST_FREE = 0.2
# Share of the half screen that is left free at each edge.
_EDGE = 0.04
# Set by hand for rooms; the default is for frames without a point.
_MIN_VIEW_RANGE_M, _DEFAULT_VIEW_RANGE_M, _MAX_VIEW_RANGE_M = 2.0, 4.0, 12.0
# As many points tell the extent of a surface as well as all.
_FITTED_POINTS = 800
# A robot that stands still is seen with its surroundings.
_LEAST_PATH_M = 4.0
# From a sensor's place to its edges, and to the ends of its handles.
_SENSOR_M, _HANDLES_M = 0.15, 0.35
# Set by hand: how steeply a map in space is looked down at.
_OVERVIEW_SLOPE = 0.7
_UP = np.array([0.0, 0.0, 1.0])
# A camera that stands nearer than this to where it was put has not been moved by a person.
_UNMOVED_M = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraView:
    """A viewpoint. ``up``: (3,) the direction that is up on the screen; ``fov_rad`` is vertical."""

    position_m: FloatArray
    look_at_m: FloatArray
    up: FloatArray
    fov_rad: float = USUAL_FOV_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneWindow:
    """The part of the page that shows the scene, in CSS pixels. ``above_px`` and ``below_px`` of
    its height are covered."""

    width_px: float
    height_px: float
    above_px: float = 0.0
    below_px: float = 0.0

    @property
    def aspect(self) -> float:
        """Width over height."""
        return self.width_px / self.height_px

    @property
    def above(self) -> float:
        """The share of the height that is covered at the upper edge."""
        return self.above_px * self._shown_of_covered / self.height_px

    @property
    def below(self) -> float:
        """The share of the height that is covered at the lower edge."""
        return self.below_px * self._shown_of_covered / self.height_px

    @property
    def _shown_of_covered(self) -> float:
        covered_px = self.above_px + self.below_px
        return min(1.0, (1.0 - _LEAST_FREE) * self.height_px / max(covered_px, 1.0))


class ViewerCamera(Protocol):
    """A browser's camera (viser's CameraHandle)."""

    position: npt.NDArray[np.float64]
    look_at: npt.NDArray[np.float64]
    up_direction: npt.NDArray[np.float64]
    fov: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StageExtent:
    """What there is to look at, in the LiDAR's frame.

    ``yaw_rad``: where the camera looks. ``surface_m``: (N, 3) some points of the depth surface;
    ``view_m``: (V, 3) the field of view at the distance of most of them, with depth there or not;
    ``matched_m``: (M, 3) the beams' ends in the camera's view; ``near_m``: (K, 3) those anywhere
    that are not far behind the rest; ``sensors_m``: (1 or 2, 3) the LiDAR and the camera, if any.
    ``view_range_m``: within it are 90 % of the points.
    """

    yaw_rad: float
    surface_m: Float32Array
    view_m: FloatArray
    matched_m: Float32Array
    near_m: Float32Array
    sensors_m: FloatArray
    view_range_m: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                read_only(value)

    def ahead(self, forward_m: float, left_m: float, up_m: float) -> FloatArray:
        """(3,) a point given relative to the camera's heading, in the LiDAR frame."""
        R_lidar_ahead = rotation_from_yaw_pitch_roll(self.yaw_rad, 0.0, 0.0)
        point: FloatArray = R_lidar_ahead @ np.array([forward_m, left_m, up_m])
        return point


def stage_extent(geometry: FrameGeometry, others: Sequence[FrameGeometry] = ()) -> StageExtent:
    """The extent of a frame's geometry. ``others``: what other cameras see at the same instant."""
    seen = [geometry, *others]
    surface_m = np.concatenate([each.surface.points_m for each in seen])
    surface_m = surface_m[:: max(1, len(surface_m) // _FITTED_POINTS)]
    frusta = [each.frustum for each in seen if each.frustum is not None]
    headings = sum((_ahead(each.wxyz) for each in frusta), np.zeros(3))
    sensors_m = [np.zeros(3)]
    if geometry.frustum is not None:
        sensors_m.append(geometry.frustum.position_m)
    beams_m = geometry.beams_m[np.isfinite(geometry.beams_m[:, 0])]
    farthest_m = surface_m if len(surface_m) else beams_m
    view_range_m = _DEFAULT_VIEW_RANGE_M
    if len(farthest_m):
        view_range_m = float(np.percentile(np.linalg.norm(farthest_m, axis=1), 90.0))
    view_range_m = float(np.clip(view_range_m, _MIN_VIEW_RANGE_M, _MAX_VIEW_RANGE_M))
    near_m = beams_m[np.linalg.norm(beams_m, axis=1) < 1.2 * view_range_m]
    pixels_m = geometry.pixels_m[np.isfinite(geometry.pixels_m[:, 0])]
    return StageExtent(
        # Zero without a camera.
        yaw_rad=float(np.arctan2(headings[1], headings[0])),
        surface_m=surface_m,
        view_m=np.concatenate([_field_of_view(each) for each in seen]),
        matched_m=pixels_m,
        near_m=near_m,
        sensors_m=np.stack(sensors_m),
        view_range_m=view_range_m,
    )


def _field_of_view(geometry: FrameGeometry) -> FloatArray:
    """(V, 3) a grid over a camera's field of view, at its median depth; empty without depth."""
    depth_m = geometry.surface.depth_m
    if not depth_m.size or geometry.frustum is None:
        return np.empty((0, 3))
    half = np.tan(0.5 * geometry.frustum.fov_rad)
    down, right = np.meshgrid(np.linspace(-half, half, 9), np.linspace(-half, half, 9))
    rays = np.stack([geometry.frustum.aspect * right, down, np.ones_like(down)], axis=-1)
    w, x, y, z = geometry.frustum.wxyz
    R_lidar_camera = rotation_from_quaternion(x, y, z, w)
    view_m: FloatArray = float(np.median(depth_m)) * rays.reshape(-1, 3) @ R_lidar_camera.T
    return view_m + geometry.frustum.position_m


@dataclass(frozen=True, slots=True, kw_only=True)
class _Angle:
    """From where a step is seen: degrees above the LiDAR's plane, and to the left of the line of
    sight of the camera. ``inside_percent``: of the surface, so much is within the screen's edges;
    the rest may be cut off."""

    above_deg: float
    aside_deg: float
    inside_percent: float
    shows_sensors: bool


# From high up and the side, the curve's course along the surface is seen; from near the camera's
# own direction, the surface is seen without gaps.
_ANGLES: dict[PanelName, _Angle] = {
    "Recording": _Angle(above_deg=24.0, aside_deg=16.0, inside_percent=88.0, shows_sensors=True),
    "Match": _Angle(above_deg=14.0, aside_deg=10.0, inside_percent=90.0, shows_sensors=False),
    "Register": _Angle(above_deg=52.0, aside_deg=8.0, inside_percent=97.0, shows_sensors=False),
    "Repair": _Angle(above_deg=20.0, aside_deg=12.0, inside_percent=80.0, shows_sensors=False),
    "Review": _Angle(above_deg=20.0, aside_deg=12.0, inside_percent=80.0, shows_sensors=False),
    "Map": _Angle(above_deg=50.0, aside_deg=0.0, inside_percent=80.0, shows_sensors=True),
    "Calibrate": _Angle(above_deg=30.0, aside_deg=20.0, inside_percent=90.0, shows_sensors=True),
}


# Of a scan alone the course is seen from high up.
_SCAN_ANGLE = _Angle(above_deg=55.0, aside_deg=0.0, inside_percent=97.0, shows_sensors=True)


def step_view(step: PanelName, extent: StageExtent, window: SceneWindow) -> CameraView:
    """The viewpoint of a step."""
    angle = _ANGLES[step]
    may_m: FloatArray | Float32Array = extent.surface_m
    if step == "Recording" and len(extent.view_m):
        # It is opened at a frame that may see little, and stays while others are shown.
        may_m = extent.view_m
    elif step == "Register" and len(extent.matched_m):
        may_m = extent.matched_m
    elif not len(may_m):
        may_m, angle = extent.near_m, _SCAN_ANGLE
    must_m: list[FloatArray | Float32Array] = []
    if angle.shows_sensors:
        # The sensors whole, with the handles at the camera.
        around_m = _HANDLES_M if step == "Calibrate" else _SENSOR_M
        around = np.concatenate([np.eye(3), -np.eye(3)]) * around_m
        must_m += [extent.sensors_m + offset for offset in around]
    if step in {"Match", "Repair", "Review"}:
        must_m.append(extent.matched_m)
    yaw_rad = extent.yaw_rad - np.deg2rad(angle.aside_deg)
    ahead = rotation_from_yaw_pitch_roll(yaw_rad, np.deg2rad(angle.above_deg), 0.0)[:, 0]
    if not len(may_m):
        may_m = np.array([extent.ahead(extent.view_range_m, 0.0, 0.0)])
        must_m = [extent.sensors_m]
    must: FloatArray = np.concatenate([np.empty((0, 3)), *must_m])
    return _fitted(ahead, may_m, must, window, inside_percent=angle.inside_percent)


def from_above(extent: StageExtent, window: SceneWindow) -> CameraView:
    """Straight down, to scale: x to the right and z ahead, as in Xu 2024's figures."""
    near_m = extent.near_m if len(extent.near_m) else extent.surface_m
    ahead, left = extent.ahead(1.0, 0.0, 0.0), extent.ahead(0.0, 1.0, 0.0)
    # Beside and behind the rig as far as the camera looks ahead, and the sensors whole.
    (low, high), (right, left_most) = (
        _reach(near_m @ axis, extent.sensors_m @ axis) for axis in (ahead, left)
    )
    middle_m = 0.5 * (low + high) * ahead + 0.5 * (right + left_most) * left
    return _above(middle_m, (left_most - right, high - low), window, up=ahead)


def _reach(points_m: FloatArray, sensors_m: FloatArray) -> tuple[float, float]:
    """The least and the greatest coordinate of nearly all points and of the whole sensors."""
    low_m, high_m = sensors_m.min() - _SENSOR_M, sensors_m.max() + _SENSOR_M
    if len(points_m):
        low_m = min(low_m, np.percentile(points_m, 2.0))
        high_m = max(high_m, np.percentile(points_m, 98.0))
    return float(low_m), float(high_m)


def map_from_above(
    T_lidar_map: FloatArray,
    origin_m: tuple[float, float],
    size_m: FloatArray,
    window: SceneWindow,
) -> CameraView:
    """Straight down on a whole map. ``origin_m``: its corner of least x and y in the map frame,
    ``size_m``: (2,) its extent; the map's y is up on the screen."""
    middle_m = np.array([origin_m[0] + 0.5 * size_m[0], origin_m[1] + 0.5 * size_m[1], 0.0])
    size = float(size_m[0]), float(size_m[1])
    return _above(apply_transform(T_lidar_map, middle_m), size, window, up=T_lidar_map[:3, 1])


def path_from_above(path_m: FloatArray, window: SceneWindow) -> CameraView:
    """Straight down on a whole trajectory, (N, 2) with at least one position."""
    low_m, high_m = path_m.min(axis=0), path_m.max(axis=0)
    size_m = np.maximum(high_m - low_m, _LEAST_PATH_M)
    x_m, y_m = 0.5 * (low_m + high_m - size_m)
    return map_from_above(np.eye(4), (float(x_m), float(y_m)), size_m, window)


def overview(
    extent_m: tuple[FloatArray, FloatArray], heading: FloatArray, window: SceneWindow
) -> CameraView:
    """A whole map in space, from behind and above. ``extent_m``: (3,) least and (3,) greatest x, y,
    z; ``heading``: (2,) the direction in which it was looked at."""
    low_m, high_m = extent_m
    corners_m = np.array(
        [[x, y, z] for x in (low_m[0], high_m[0]) for y in (low_m[1], high_m[1])
         for z in (low_m[2], high_m[2])]
    )  # fmt: skip
    ahead = np.array([heading[0], heading[1], -_OVERVIEW_SLOPE])
    return _fitted(
        ahead / np.linalg.norm(ahead), corners_m, corners_m[:0], window, inside_percent=100.0
    )


def from_optical_frame(T_map_camera: FloatArray) -> CameraView:
    """As a camera sees whose (4, 4) pose is of its optical frame."""
    position_m = T_map_camera[:3, 3].copy()
    return CameraView(
        position_m=position_m,
        look_at_m=position_m + 2.0 * T_map_camera[:3, 2],
        up=-T_map_camera[:3, 1],
    )


def from_camera(frustum: Frustum) -> CameraView:
    """As a depth camera sees."""
    w, x, y, z = frustum.wxyz
    down = rotation_from_quaternion(x, y, z, w)[:, 1]
    return CameraView(
        position_m=frustum.position_m,
        look_at_m=frustum.position_m + 2.0 * _ahead(frustum.wxyz),
        up=-down,
        fov_rad=frustum.fov_rad,
    )


def _ahead(wxyz: FloatArray) -> FloatArray:
    """(3,) the optical axis of a camera's orientation."""
    w, x, y, z = wxyz
    ahead: FloatArray = rotation_from_quaternion(x, y, z, w)[:, 2]
    return ahead


def apply(camera: ViewerCamera, view: CameraView) -> None:
    """Move a browser's camera to a viewpoint."""
    camera.fov = view.fov_rad
    # Setting the position moves the look-at point, too, so that is set afterwards.
    camera.position = view.position_m
    camera.look_at = view.look_at_m
    camera.up_direction = view.up


def view_of(camera: ViewerCamera) -> CameraView:
    """The viewpoint of a browser's camera now."""
    return CameraView(
        position_m=np.array(camera.position),
        look_at_m=np.array(camera.look_at),
        up=np.array(camera.up_direction),
        fov_rad=camera.fov,
    )


def is_unmoved(camera: ViewerCamera, view: CameraView) -> bool:
    """Whether a browser's camera still stands where it was put: no person has moved it."""
    return float(np.linalg.norm(np.array(camera.position) - view.position_m)) < _UNMOVED_M


def _fitted(
    ahead: FloatArray,
    may_m: FloatArray | Float32Array,
    must_m: FloatArray,
    window: SceneWindow,
    *,
    inside_percent: float,
) -> CameraView:
    """The nearest viewpoint looking ``ahead`` from which ``inside_percent`` of the points are right
    of the left edge of what nothing covers, and so on for each edge, and all of ``must_m`` are.

    In the screen's axes a point at (x, y, z) is within the right edge where x - x_eye <= k (z -
    z_eye): linear in the eye's place, whose greatest z the edges at both sides decide together.
    """
    half = np.tan(0.5 * USUAL_FOV_RAD)
    side = (1.0 - _EDGE) * max(window.aspect, _LEAST_ASPECT) * half
    top = (1.0 - max(_EDGE, 2.0 * window.above)) * half
    bottom = (1.0 - 2.0 * window.below) * half
    seen_from = facing(np.zeros(3), ahead, _UP)
    axes = np.stack([seen_from.right, seen_from.up, ahead])
    may, must = may_m @ axes.T, must_m @ axes.T

    def outermost(axis: int, sign: float, slope: float) -> float:
        bound = float(np.percentile(sign * may[:, axis] - slope * may[:, 2], inside_percent))
        if len(must):
            bound = max(bound, float(np.max(sign * must[:, axis] - slope * must[:, 2])))
        return bound

    right, left = outermost(0, 1.0, side), outermost(0, -1.0, side)
    upper, lower = outermost(1, 1.0, top), outermost(1, -1.0, bottom)
    z = min(-(right + left) / (2.0 * side), -(upper + lower) / (top + bottom))
    x = 0.5 * (right - left)
    # What is left of the height lies half above and half below.
    y = 0.5 * ((upper + top * z) - (lower + bottom * z))
    position_m = np.array([x, y, z]) @ axes
    distance_m = float(np.median(may[:, 2])) - z
    return CameraView(
        position_m=position_m,
        look_at_m=position_m + max(distance_m, 0.5) * ahead,
        up=_UP.copy(),
    )


def _above(
    middle_m: FloatArray, size_m: tuple[float, float], window: SceneWindow, *, up: FloatArray
) -> CameraView:
    """Straight down; the part of the screen that nothing covers shows a width and a height."""
    width_m, height_m = size_m
    free = 1.0 - window.above - window.below
    shown_m = 1.06 * max(height_m / free, width_m / max(window.aspect, _LEAST_ASPECT))
    middle_m = middle_m + 0.5 * (window.above - window.below) * shown_m * np.asarray(up)
    away_m = np.array([0.0, 0.0, 0.5 * shown_m / float(np.tan(0.5 * _ABOVE_FOV_RAD))])
    return CameraView(
        position_m=middle_m + away_m, look_at_m=middle_m, up=up, fov_rad=_ABOVE_FOV_RAD
    )
