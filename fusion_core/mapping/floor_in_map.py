"""The floor in a map: the lowest large level plane in depth images whose poses are known.

The camera may be held in a hand: its height and tilt may change from image to image.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fusion_core.mapping.floor_plane import level_patches
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, read_only
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.geometry import transform_points
from fusion_core.model.sensors import CameraIntrinsics

# The thresholds below are set by hand.
#
# Inlier distance: depth noise at 4 m, and the drift of poses.
_TOLERANCE_M = 0.04
_RANSAC_DRAWS = 400
# Least height of the cameras above it.
_NEAREST_BELOW_M = 0.08
# Points that score a draw: the inlier ratio is then known to 1 % (two standard deviations).
_SCORED = 12_000
_REFITS = 4
# Twice the least area of a drawn triangle: smaller ones give no reliable normal.
_TRIANGLE_MIN_M2 = 0.01
# Planes that may lie above the floor, each below the one before: shelf, table, seat, step.
_PLANES_ABOVE_FLOOR = 4
_BELOW_M = 2.0 * _TOLERANCE_M
# Patches that a plane needs to be the floor, as a fraction of those of the plane above it.
_LARGE_FRACTION = 0.15
_PATCHES_MIN = 300
# Patches below the floor (reflections, depth edges) as a fraction of those on it.
_BELOW_FRACTION_MAX = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorInMap:
    """A point p lies ``up @ p + offset_m`` above the floor. ``up``: (3,) unit, in the map.

    ``tilt_rad``: between it and what was taken as up. ``patches``: level patches on the plane.
    """

    up: FloatArray
    offset_m: float
    tilt_rad: float
    patches: int

    def __post_init__(self) -> None:
        read_only(self.up)


def find_floor_in_map(
    views: Iterable[tuple[Float32Array, FloatArray]],
    intrinsics: CameraIntrinsics,
    up: FloatArray,
    *,
    tilt_max_rad: float,
    seed: int = 0,
) -> FloorInMap:
    """The floor by depth images, (H, W) each with its (4, 4) T_map_camera.

    ``intrinsics``: of the depth images. ``up``: (3,) what is taken as up in the map; the floor may
    tilt against it by ``tilt_max_rad``.

    Raises AlignmentFailed where no level plane is seen.
    """
    up = up / np.linalg.norm(up)
    found, centres = [], []
    for depth_m, T_map_camera in views:
        patches_m = level_patches(depth_m, intrinsics, T_map_camera[:3, :3].T @ up, tilt_max_rad)
        found.append(transform_points(T_map_camera, patches_m))
        centres.append(T_map_camera[:3, 3])
    points_m = np.concatenate([*found, np.empty((0, 3))])
    centres_m = np.array(centres).reshape(-1, 3)
    rng = np.random.default_rng(seed)
    plane = _ransac_plane(points_m, centres_m, up, tilt_max_rad, rng)
    if plane is None:
        raise _no_floor(f"{len(points_m)} level patches in {len(found)} images")
    # The largest plane may be a table top: look for the floor below it.
    for _ in range(_PLANES_ABOVE_FLOOR):
        on_plane = int(_is_near(points_m, plane).sum())
        below = points_m @ plane[:3] + plane[3] < -_BELOW_M
        lower = _ransac_plane(points_m[below], centres_m, up, tilt_max_rad, rng)
        if lower is None or _is_near(points_m, lower).sum() < _LARGE_FRACTION * on_plane:
            break
        plane = lower
    plane = _refit_plane(points_m, plane)
    near = int(_is_near(points_m, plane).sum())
    below_count = int((points_m @ plane[:3] + plane[3] < -_BELOW_M).sum())
    tilt_rad = float(np.arccos(np.clip(plane[:3] @ up, -1.0, 1.0)))
    if near < _PATCHES_MIN or tilt_rad > tilt_max_rad:
        raise _no_floor(f"its best plane has {near} patches and a tilt of {tilt_rad:.2f} rad")
    if below_count > _BELOW_FRACTION_MAX * near:
        raise _no_floor(f"{below_count / near:.0%} as many patches lie below its best plane as on")
    return FloorInMap(
        up=plane[:3].copy(), offset_m=float(plane[3]), tilt_rad=tilt_rad, patches=near
    )


def _no_floor(found: str) -> AlignmentFailed:
    return AlignmentFailed(f"no floor plane is seen in the depth: {found}.")


def _is_near(points_m: FloatArray, plane: FloatArray) -> BoolArray:
    near: BoolArray = np.abs(points_m @ plane[:3] + plane[3]) <= _TOLERANCE_M
    return near


def _ransac_plane(
    points_m: FloatArray,
    centres_m: FloatArray,
    up: FloatArray,
    tilt_max_rad: float,
    rng: np.random.Generator,
) -> FloatArray | None:
    """(4,) unit normal towards ``up`` and offset of the plane below the cameras, at ``centres_m``,
    (C, 3), with most inliers; None without."""
    if len(points_m) < _PATCHES_MIN:
        return None
    scored_m = points_m
    if len(points_m) > _SCORED:
        scored_m = points_m[np.sort(rng.choice(len(points_m), _SCORED, replace=False))]
    best: FloatArray | None = None
    most = 0
    for _ in range(_RANSAC_DRAWS):
        a, b, c = points_m[rng.integers(len(points_m), size=3)]
        normal = np.cross(b - a, c - a)
        length = float(np.linalg.norm(normal))
        # Three points in a line, or nearly so, have no normal.
        if length < _TRIANGLE_MIN_M2:
            continue
        normal *= np.sign(normal @ up) / length
        plane = np.append(normal, -float(normal @ a))
        height_m = float(np.median(centres_m @ plane[:3])) + plane[3]
        if normal @ up < np.cos(tilt_max_rad) or height_m < _NEAREST_BELOW_M:
            continue
        count = int(_is_near(scored_m, plane).sum())
        if count > most:
            best, most = plane, count
    return best


def _refit_plane(points_m: FloatArray, plane: FloatArray) -> FloatArray:
    """The least-squares plane of the inliers of a plane, refitted a few times."""
    for _ in range(_REFITS):
        near_m = points_m[_is_near(points_m, plane)]
        if len(near_m) < 3:
            return plane
        middle_m = near_m.mean(axis=0)
        off_m = near_m - middle_m
        normal = np.linalg.eigh(off_m.T @ off_m)[1][:, 0]
        normal *= np.sign(normal @ plane[:3])
        plane = np.append(normal, -float(normal @ middle_m))
    return plane
