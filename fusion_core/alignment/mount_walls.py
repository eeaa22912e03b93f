"""The rig's pitch and roll by the walls that it sees: they are upright, and the LiDAR sweeps level.

With R = Ry(pitch) Rx(roll), up in the rig's axes is (-tan(pitch) / cos(roll), tan(roll), 1) / its
length, and n . up = 0 for the normal n of a wall. Which surfaces are walls is told first by the
directions that all of them have (``find_up``), then by their own spread.
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.alignment.mount_cost import places_of
from fusion_core.alignment.mount_observation import MountObservation
from fusion_core.alignment.mount_settings import MountSettings
from fusion_core.alignment.rig_tilt import RigTilt, images_for_tilt
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.robust import MAD_TO_SIGMA
from fusion_core.model.two_way_covariance import (
    frame_blocks,
    shared_grouping,
    two_way_covariance,
)
from fusion_core.patches.depth_patches import find_patches
from fusion_core.patches.inside_surfaces import find_inside
from fusion_core.patches.up_direction import find_up

# Surfaces that lean by more are no walls.
_LEAN_MAX = float(np.sin(np.deg2rad(15.0)))
# Residuals beyond this many standard deviations are of something else.
_OUTLIER_SD = 3.0
_ITERATIONS = 12
# Of depths that are stored in single precision.
_LEAST_NOISE = float(np.finfo(np.float32).eps)
_LEVEL = np.array([0.0, 0.0, 1.0])


def find_wall_tilt(
    frames: Sequence[MountObservation], headings_rad: FloatArray, settings: MountSettings
) -> RigTilt | None:
    """The tilt; None where too few walls are seen to tell a deviation.

    ``headings_rad``: (F,) of the LiDAR at each frame. About an axis that no wall shows, the rig is
    level within ``prior_pitch_sd_deg``.
    """
    frame, depth_m, normals, points_m = _patches_inside_surfaces(frames)
    place = places_of(headings_rad[frame], points_m)
    up = find_up(normals, _LEVEL)
    near = np.abs(normals @ up) < _LEAN_MAX
    if not near.any() or up[2] <= 0.0:
        return None
    # Up is (x, y, 1). A patch is as wide as it is far away, and the noise of its depths grows with
    # the square of that: the noise of its normal in proportion.
    x_y = up[:2] / up[2]
    off = (normals[:, :2] @ x_y + normals[:, 2]) / depth_m
    noise = max(_LEAST_NOISE, MAD_TO_SIGMA * float(np.median(np.abs(off[near]))))
    prior = np.eye(2) / np.deg2rad(settings.prior_pitch_sd_deg) ** 2
    for _ in range(_ITERATIONS):
        near = np.abs(off) < _OUTLIER_SD * noise
        noise = max(_LEAST_NOISE, float(np.sqrt(np.mean(off[near] ** 2))))
        # The sum of normals of walls is level, too, and its direction less noisy: noise there would
        # look like walls of other directions.
        weighted = normals[near] / (noise * depth_m[near, None])
        groups, means = _sums_over_root_count(weighted, np.stack([frame[near], place[near]]))
        design, right = means[:, :2], -means[:, 2]
        x_y = np.linalg.solve(design.T @ design + prior, design.T @ right)
        off = (normals[:, :2] @ x_y + normals[:, 2]) / depth_m
    residual = design @ x_y - right
    scores = residual[:, None] * design
    covariance = two_way_covariance(
        scores,
        design[:, :, None] * design[:, None, :],
        prior,
        frame_blocks(scores, groups[0]),
        shared_grouping(residual, (groups[1],)),
    )
    if covariance is None:
        return None
    x, y = x_y
    across = np.hypot(y, 1.0)
    # Of arctan2(-x, hypot(y, 1)).
    slope = np.array([-across, x * y / across]) / (x**2 + across**2)
    return RigTilt(
        pitch_rad=float(np.arctan2(-x, across)),
        pitch_sd_rad=float(np.sqrt(slope @ covariance @ slope)),
        roll_rad=float(np.arctan(y)),
        roll_sd_rad=float(np.sqrt(covariance[1, 1]) / across**2),
        height_m=None,
    )


def _patches_inside_surfaces(
    frames: Sequence[MountObservation],
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Of N patches: frame and depth, (N,); normal, and point from the camera on, (N, 3) along the
    rig's axes."""
    chosen = images_for_tilt(len(frames))
    cameras = [frames[index].camera for index in chosen]
    images = [
        find_patches(frames[index].raw_depth_m, camera.intrinsics)
        for index, camera in zip(chosen, cameras, strict=True)
    ]
    parts = []
    for index, camera, image, own in zip(chosen, cameras, images, find_inside(images), strict=True):
        turn = camera.T_rig_camera[:3, :3].T
        points_m = image.points_m[own]
        frame = np.full(points_m.shape[0], index)
        parts.append((frame, points_m[:, 2], image.normals[own] @ turn, points_m @ turn))
    frame, depth_m, normals, points_m = map(np.concatenate, zip(*parts, strict=True))
    return frame, depth_m, normals, points_m


def _sums_over_root_count(values: FloatArray, label: IntArray) -> tuple[IntArray, FloatArray]:
    """The groups of (K, N) labels, (K, G), and the sums of (N, D) values in each over the root of
    its count, (G, D): noise of one size stays of that size."""
    groups, index, count = np.unique(label, axis=1, return_inverse=True, return_counts=True)
    sums = np.zeros((count.size, values.shape[1]))
    np.add.at(sums, index.ravel(), values)
    return groups, sums / np.sqrt(count)[:, None]
