"""The rig's pitch, roll and height by the floor that it sees: the LiDAR sweeps parallel to it.

The floor is the lowest surface with much of the image on it. On a plane the inverse depth is linear
in the pixel's ray, so that the rays, which are exact, explain the depths, which are not. The mount
has no roll of its own: a rig that shows one takes it into its cameras' poses.
"""

from collections.abc import Mapping, Sequence
from itertools import product

import cv2
import numpy as np

from fusion_core.alignment.mount_cost import places_of
from fusion_core.alignment.mount_observation import MountObservation
from fusion_core.alignment.mount_settings import MountSettings
from fusion_core.alignment.rig_tilt import RigTilt, images_for_tilt
from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.geometry import rotation_from_yaw_pitch_roll
from fusion_core.model.two_way_covariance import (
    frame_blocks,
    shared_grouping,
    two_way_covariance,
)

# So many rows of an image, with columns as far apart: more have the same errors.
_ROWS = 40
# Tilts tried, and the layers that a floor is looked for in: what half a degree leaves of it.
_PITCHES_RAD = np.deg2rad(np.arange(-20.0, 20.5, 1.0))
# Of a camera that is meant to be level; tried where the floor is not that of a level one.
_ROLLS_RAD = np.deg2rad([-2.0, 2.0, -4.0, 4.0, -6.0, 6.0])
_LAYER_M = 0.04
# So much of the images may lie below the floor: mirrors, flying pixels.
_BELOW = 0.02
# A floor takes at least so much of the images, over so long a way ahead.
_LEAST_FRACTION = 0.02
_LEAST_EXTENT_M = 0.5
# The first fit takes in what is within so many tolerances; its scale is then the residuals' own.
_FIRST_NOISE = 0.4
_ITERATIONS = 12
# Residuals beyond this many standard deviations are of something else.
_OUTLIER_SD = 3.0
# The fit stays near the tilt that it started from, which noise in the depths bends.
_NEAR_RAD = np.deg2rad(5.0)


def find_floor_tilt(
    frames: Sequence[MountObservation], headings_rad: FloatArray, settings: MountSettings
) -> RigTilt | None:
    """The tilt; None where no floor is seen, or too little of it to tell a deviation.

    ``headings_rad``: (F,) of the LiDAR at each frame. What is no floor to a level rig counts only
    where it shows for sure that the rig is rolled.
    """
    views = {index: _View(frames[index]) for index in images_for_tilt(len(frames))}
    level = _fit_floor(views, headings_rad, settings, np.zeros(1))
    if level is not None:
        return level
    rolled = _fit_floor(views, headings_rad, settings, _ROLLS_RAD)
    return rolled if rolled is not None and rolled.is_rolled else None


def _fit_floor(
    view_of_frame: Mapping[int, "_View"],
    headings_rad: FloatArray,
    settings: MountSettings,
    rolls_rad: FloatArray,
) -> RigTilt | None:
    """The tilt, from the fullest layer under one of these rolls."""
    views = list(view_of_frame.values())
    rays = np.concatenate([view.rays for view in views])
    depth_m = np.concatenate([view.depth_m for view in views])
    frame = np.repeat(list(view_of_frame), [view.depth_m.size for view in views])
    start = _lowest_layer(rays * depth_m[:, None], rolls_rad)
    if start is None:
        return None
    # Of what is on the plane n . X = -h, the inverse depth is -(n . ray) / h.
    inverse = 1.0 / depth_m
    scale = (settings.tolerance_m + settings.tolerance_fraction * depth_m) * inverse**2
    plane: FloatArray = start
    noise = _FIRST_NOISE
    for _ in range(_ITERATIONS):
        off = (inverse - rays @ plane) / scale
        near = _without_rims(views, np.abs(off) < _OUTLIER_SD * noise)
        design = rays[near] / scale[near, None]
        information = design.T @ design
        if near.mean() < _LEAST_FRACTION or np.linalg.cond(information) > 1e8:
            return None
        # Not from a median: more than half may be of one step of disparity, and fit exactly.
        noise = min(noise, float(np.sqrt(np.mean(off[near] ** 2))))
        plane = np.linalg.solve(information, design.T @ (inverse[near] / scale[near])).astype(float)
    pitch = _pitch_rad(plane)
    heights_m = (rays * depth_m[:, None]) @ (-plane / np.linalg.norm(plane))
    below = np.mean(heights_m < np.median(heights_m[near]) - 2.0 * _LAYER_M)
    ahead_m = np.quantile(rays[near, 0] * depth_m[near], [0.05, 0.95])
    if (
        below > _BELOW
        or ahead_m[1] - ahead_m[0] < _LEAST_EXTENT_M
        or _angle_between_rad(plane, start) > _NEAR_RAD
    ):
        return None
    off = (inverse[near] - rays[near] @ plane) / scale[near] / noise
    design = design / noise
    scores = off[:, None] * design
    place = places_of(headings_rad[frame[near]], rays[near])
    # The depths of a row have the rounding of their disparity in common, whatever their direction.
    row = np.concatenate([view.row for view in views])[near]
    covariance = two_way_covariance(
        scores,
        design[:, :, None] * design[:, None, :],
        np.zeros((3, 3)),
        frame_blocks(scores, frame[near]),
        shared_grouping(off, (place, row)),
    )
    if covariance is None:
        return None
    # Of arctan2(a, hypot(b, c)).
    flat = float(np.hypot(plane[1], plane[2]))
    slope = np.array([flat, -plane[0] * plane[1] / flat, -plane[0] * plane[2] / flat])
    slope /= plane @ plane
    # Of arctan2(-b, -c).
    across = np.array([0.0, plane[2], -plane[1]]) / (plane[1] ** 2 + plane[2] ** 2)
    return RigTilt(
        pitch_rad=pitch,
        pitch_sd_rad=float(np.sqrt(slope @ covariance @ slope)),
        roll_rad=float(np.arctan2(-plane[1], -plane[2])),
        roll_sd_rad=float(np.sqrt(across @ covariance @ across)),
        height_m=float(1.0 / np.linalg.norm(plane) - np.mean([view.above_rig_m for view in views])),
    )


class _View:
    """Some of an image's pixels: ``rays`` (N, 3) in the rig's axes, 1 m long along the
    optical axis, and ``depth_m`` (N,) of those with a depth, unfiltered: a median of a slanted
    surface beside holes is none of its own. ``above_rig_m``: the camera's height over the rig."""

    def __init__(self, frame: MountObservation) -> None:
        stride = max(1, frame.raw_depth_m.shape[0] // _ROWS)
        depth_m = frame.raw_depth_m[::stride, ::stride]
        self.shape = depth_m.shape
        self.row, self.column = np.nonzero(np.isfinite(depth_m))
        rays = frame.camera.rays(stride * self.row, stride * self.column)
        self.rays = rays @ frame.camera.T_rig_camera[:3, :3].T
        self.depth_m = depth_m[self.row, self.column].astype(np.float64)
        self.above_rig_m = float(frame.camera.T_rig_camera[2, 3])


def _without_rims(views: list[_View], near: BoolArray) -> BoolArray:
    """Without the pixels beside others: at the foot of a wall some of its own are near the floor,
    always on the same side of it."""
    kept = []
    first = 0
    for view in views:
        mask = np.ones(view.shape, dtype=np.uint8)
        last = first + view.depth_m.size
        mask[view.row, view.column] = near[first:last]
        inner = cv2.erode(mask, np.ones((3, 3), dtype=np.uint8))
        kept.append(inner[view.row, view.column] > 0)
        first = last
    return np.concatenate(kept)


def _pitch_rad(plane: FloatArray) -> float:
    """``plane`` is the floor's normal over its (negative) height; straight down is -z."""
    return float(np.arctan2(plane[0], np.hypot(plane[1], plane[2])))


def _angle_between_rad(first: FloatArray, second: FloatArray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(first, second)), first @ second))


def _lowest_layer(points: FloatArray, rolls_rad: FloatArray) -> FloatArray | None:
    """(3,) n / -h of the fullest layer with next to nothing below, over the tilts tried."""
    best, plane = 0, None
    if points.shape[0] == 0:
        return None
    for roll, pitch in product(rolls_rad, _PITCHES_RAD):
        normal = rotation_from_yaw_pitch_roll(0.0, pitch, roll)[2]
        heights_m = points @ normal
        layer = np.floor(heights_m / _LAYER_M).astype(np.int64)
        layer -= layer.min()
        count = np.bincount(layer)
        under = np.cumsum(count) - count
        count[under > _BELOW * heights_m.size] = 0
        fullest = int(count.argmax())
        if count[fullest] <= best:
            continue
        height_m = float(np.median(heights_m[layer == fullest]))
        if height_m < 0.0:
            best, plane = int(count[fullest]), normal / height_m
    return plane
