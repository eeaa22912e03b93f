"""Poses of all scans from the poses of the keyframes among them."""

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.planar_poses import compose_poses, interpolate_pose, relative_pose


def interpolate_poses(
    poses_local_scan: FloatArray, keyframes: IntArray, poses_map_keyframe: FloatArray
) -> FloatArray:
    """(N, 3) every scan by the keyframes before and after it, the nearer one weighing more.

    ``poses_local_scan``: (N, 3). ``keyframes``: (K,) scan numbers, rising, K >= 1.
    ``poses_map_keyframe``: (K, 3).
    """
    number = np.arange(len(poses_local_scan))
    before = np.maximum(np.searchsorted(keyframes, number, side="right") - 1, 0)
    after = np.minimum(before + 1, keyframes.size - 1)
    by_before, by_after = (
        compose_poses(
            poses_map_keyframe[node],
            relative_pose(poses_local_scan[keyframes[node]], poses_local_scan),
        )
        for node in (before, after)
    )
    span = np.maximum(keyframes[after] - keyframes[before], 1)
    fraction = np.clip((number - keyframes[before]) / span, 0.0, 1.0)
    return interpolate_pose(by_before, by_after, fraction)
