"""Floor detection in depth images: the lowest large level plane below the camera, by RANSAC.

An error of one degree in the extrinsics lifts the floor 4 m away by 7 cm, and aligning scans with
depth rows does not determine the camera's height and pitch. The floor determines both.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.mapping.level_plane import LARGE_FRACTION, LevelPlaneSearch
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray, read_only
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.robust import robust_sigma
from fusion_core.model.sensors import CameraIntrinsics

# The thresholds below are set by hand.
#
# Samples along the longer side: every fourth pixel of a 320 x 240 image.
_GRID = 80
# Beyond, a Kinect's depth steps (4 cm) exceed the slope over neighbouring samples.
_FAR_M = 4.0
# Least camera height: lower than any robot's camera.
_NEAREST_BELOW_M = 0.08
# Inlier distance: unevenness of floors, and depth noise that grows with range.
_TOLERANCE_M = 0.02
_TOLERANCE_PER_M = 0.005
# RANSAC iterations: three floor points are drawn with a confidence of 99.9 % where 28 % of the
# patches are floor.
_RANSAC_DRAWS = 300
# Tolerance of a local slope, which depth noise between neighbouring samples makes inexact.
_SLOPE_SLACK_RAD = np.deg2rad(12.0)
# What lies this far below a plane is not on it: twice the inlier distance at _FAR_M.
_BELOW_M = 2.0 * (_TOLERANCE_M + _TOLERANCE_PER_M * _FAR_M)
# Ten images of fifteen patches each, 0.3 % of an image's samples.
_PATCHES_MIN = 150
_PATCHES_OF_IMAGE = 15
_IMAGES_MIN = 3
# Patches of an image to which a plane of its own is fitted: depth noise of 1 cm over half a metre
# then tilts it by 0.15 degrees, a tenth of what is tolerated.
_PATCHES_OF_FIT = 60
# Patches below the floor (reflections, depth edges) as a fraction of those on it.
_BELOW_FRACTION_MAX = 0.1
# Largest median deviation of the floor in single images from the common one: a robot pitches a
# little, a camera in a hand more.
_TILT_SPREAD_RAD = np.deg2rad(1.5)
_HEIGHT_SPREAD_M = 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorPlane:
    """The floor in a camera's optical frame: a point p lies ``up @ p + camera_height_m`` above it.

    ``up``: (3,) unit. ``tilt_rad``: between it and what was taken as up. ``patches``: level
    patches that lie on the plane, ``images``: how many images show it. ``sigma_m``: robust
    standard deviation of the patches from the plane.
    """

    up: FloatArray
    camera_height_m: float
    tilt_rad: float
    patches: int
    images: int
    sigma_m: float

    def __post_init__(self) -> None:
        if self.up.shape != (3,):
            raise ValueError(f"up must be (3,), got {self.up.shape}")
        read_only(self.up)


def find_floor(
    depths_m: Sequence[Float32Array],
    intrinsics: CameraIntrinsics,
    up: FloatArray,
    *,
    tilt_max_rad: float,
    seed: int = 0,
) -> FloorPlane:
    """The common floor plane in the images of a camera that is fixed to a robot.

    ``depths_m``: (H, W) each, upright views with ``intrinsics``. ``up``: (3,) what is taken as
    up in the optical frame; the floor may tilt against it by ``tilt_max_rad``.

    Raises AlignmentFailed where no level plane is seen, or too few images agree on one.
    """
    up = up / np.linalg.norm(up)
    found = [level_patches(depth_m, intrinsics, up, tilt_max_rad) for depth_m in depths_m]
    image_of: IntArray = np.repeat(
        np.arange(len(found), dtype=np.int64), [len(points_m) for points_m in found]
    )
    points_m = np.concatenate([*found, np.empty((0, 3))])
    rng = np.random.default_rng(seed)
    search = LevelPlaneSearch(
        up=up,
        tilt_max_rad=tilt_max_rad,
        is_near=_is_near,
        camera_height_m=lambda plane: float(plane[3]),
        camera_height_min_m=_NEAREST_BELOW_M,
        points_min=_PATCHES_MIN,
        below_m=_BELOW_M,
        draws=_RANSAC_DRAWS,
    )
    plane = search.find(points_m, rng)
    if plane is None:
        raise _no_floor_error(f"{len(points_m)} level patches in {len(depths_m)} images")
    plane = search.refit(points_m, plane)
    near = _is_near(points_m, plane)
    heights_m = points_m @ plane[:3] + plane[3]
    images = int((np.bincount(image_of[near], minlength=1) >= _PATCHES_OF_IMAGE).sum())
    tilt_rad = float(np.arccos(np.clip(plane[:3] @ up, -1.0, 1.0)))
    below_fraction = float((heights_m < -_BELOW_M).sum()) / max(int(near.sum()), 1)
    if near.sum() < _PATCHES_MIN or images < min(_IMAGES_MIN, len(depths_m)):
        raise _no_floor_error(f"its best plane has {near.sum()} patches in {images} images")
    if tilt_rad > tilt_max_rad:
        raise _no_floor_error(f"its best plane tilts by {np.rad2deg(tilt_rad):.1f} degrees")
    if below_fraction > _BELOW_FRACTION_MAX:
        raise _no_floor_error(
            f"{below_fraction:.0%} as many patches lie below its best plane as on it"
        )
    _require_fixed_camera(search, points_m, image_of, plane, len(depths_m))
    return FloorPlane(
        up=plane[:3].copy(),
        camera_height_m=float(plane[3]),
        tilt_rad=tilt_rad,
        patches=int(near.sum()),
        images=images,
        sigma_m=robust_sigma(heights_m[near]),
    )


def _no_floor_error(found: str) -> AlignmentFailed:
    return AlignmentFailed(
        f"no floor plane is seen in the depth: {found}.",
        advice="Give virtual_scan.lidar_height_m with extrinsics of the whole mount, or use "
        "--scan lidar.",
    )


def _require_fixed_camera(
    search: LevelPlaneSearch,
    points_m: FloatArray,
    image_of: IntArray,
    plane: FloatArray,
    images: int,
) -> None:
    """Raise AlignmentFailed for a hand-held camera, whose floor differs from image to image."""
    near = _is_near(points_m, plane)
    seen = np.bincount(image_of, minlength=images)
    agreeing = np.bincount(image_of[near], minlength=images)
    rich = seen >= _PATCHES_MIN
    elsewhere = False
    if rich.any():
        elsewhere = bool(np.median(agreeing[rich] / seen[rich]) < LARGE_FRACTION)
    tilts_rad, heights_m = [], []
    for image in np.flatnonzero(agreeing >= _PATCHES_OF_FIT):
        own = search.refit(points_m[image_of == image], plane)
        tilts_rad.append(np.arccos(np.clip(own[:3] @ plane[:3], -1.0, 1.0)))
        heights_m.append(abs(own[3] - plane[3]))
    if tilts_rad:
        elsewhere |= bool(np.median(tilts_rad) > _TILT_SPREAD_RAD)
        elsewhere |= bool(np.median(heights_m) > _HEIGHT_SPREAD_M)
    if elsewhere:
        raise AlignmentFailed(
            "the floor lies elsewhere in each image: the camera's height or tilt changes.",
            advice="A virtual scan needs a camera that is fixed to a robot.",
        )


def level_patches(
    depth_m: Float32Array, intrinsics: CameraIntrinsics, up: FloatArray, tilt_max_rad: float
) -> FloatArray:
    """(K, 3) points below the camera whose local surface normal is vertical."""
    step = max(1, max(depth_m.shape) // _GRID)
    rows = np.arange(0, depth_m.shape[0], step)
    columns = np.arange(0, depth_m.shape[1], step)
    z_m = depth_m[np.ix_(rows, columns)].astype(np.float64)
    z_m[~((z_m > 0.0) & (z_m <= _FAR_M))] = np.nan
    rays = np.empty((rows.size, columns.size, 3))
    rays[..., 0] = (columns - intrinsics.cx) / intrinsics.fx
    rays[..., 1] = ((rows - intrinsics.cy) / intrinsics.fy)[:, np.newaxis]
    rays[..., 2] = 1.0
    points_m = z_m[..., np.newaxis] * rays
    if min(points_m.shape[:2]) < 3:
        return np.empty((0, 3))
    middle_m = points_m[1:-1, 1:-1]
    across_m = points_m[1:-1, 2:] - points_m[1:-1, :-2]
    along_m = points_m[2:, 1:-1] - points_m[:-2, 1:-1]
    normal = np.cross(across_m, along_m)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs(normal @ up) / np.linalg.norm(normal, axis=-1)
        level = cosine >= np.cos(tilt_max_rad + _SLOPE_SLACK_RAD)
        level &= middle_m @ up < -_NEAREST_BELOW_M
    patches: FloatArray = middle_m[level]
    return patches


def _tolerance_m(points_m: FloatArray) -> FloatArray:
    return _TOLERANCE_M + _TOLERANCE_PER_M * np.abs(points_m[:, 2])


def _is_near(points_m: FloatArray, plane: FloatArray) -> BoolArray:
    near: BoolArray = np.abs(points_m @ plane[:3] + plane[3]) <= _tolerance_m(points_m)
    return near
