"""The floor in a map: the lowest large level plane in depth images whose poses are known.

The camera may be held in a hand: its height and tilt may change from image to image.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fusion_core.mapping.floor_plane import level_patches
from fusion_core.mapping.level_plane import LevelPlaneSearch
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
_BELOW_M = 2.0 * _TOLERANCE_M
# Patches that a plane needs to be the floor.
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
    search = LevelPlaneSearch(
        up=up,
        tilt_max_rad=tilt_max_rad,
        is_near=_is_near,
        camera_height_m=lambda plane: float(np.median(centres_m @ plane[:3])) + plane[3],
        camera_height_min_m=_NEAREST_BELOW_M,
        points_min=_PATCHES_MIN,
        below_m=_BELOW_M,
        draws=_RANSAC_DRAWS,
    )
    plane = search.find(points_m, rng)
    if plane is None:
        raise _no_floor(f"{len(points_m)} level patches in {len(found)} images")
    plane = search.refit(points_m, plane)
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
