"""Planar steps (x, y, yaw), one or many at a time: metres, metres, radians in [-pi, pi).

A step is the relative pose from one pose of a trajectory to the next; its covariance is in the axes
of the pose that it starts from.
"""

import numpy as np

from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.planar_poses import relative_pose


def steps_between(poses: FloatArray) -> FloatArray:
    """(N - 1, 3) the step from each of (N, 3) poses to the next."""
    return relative_pose(poses[:-1], poses[1:])


def integrate_steps(steps: FloatArray, start: FloatArray | None = None) -> FloatArray:
    """(N + 1, 3) poses of (N, 3) steps composed one after the other, from ``start`` or the
    origin."""
    poses = np.zeros((len(steps) + 1, 3))
    if start is not None:
        poses[0] = start
    # Yaw is a cumulative sum; with the yaws known, so is the position.
    poses[1:, 2] = poses[0, 2] + np.cumsum(steps[:, 2])
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    poses[1:, 0] = poses[0, 0] + np.cumsum(c * steps[:, 0] - s * steps[:, 1])
    poses[1:, 1] = poses[0, 1] + np.cumsum(s * steps[:, 0] + c * steps[:, 1])
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


def subtract_poses(first: FloatArray, second: FloatArray) -> FloatArray:
    """(..., 3) first - second entry by entry, the yaw wrapped."""
    difference: FloatArray = first - second
    difference[..., 2] = wrap_angle(difference[..., 2])
    return difference


def rotate_covariance(yaw_rad: FloatArray | float, covariance: FloatArray) -> FloatArray:
    """(..., 3, 3) covariance of (x, y, yaw) expressed in axes rotated by ``yaw_rad``."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    zero, one = np.zeros_like(c), np.ones_like(c)
    rows = [[c, s, zero], [-s, c, zero], [zero, zero, one]]
    rotation = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    result: FloatArray = rotation @ covariance @ np.swapaxes(rotation, -1, -2)
    return result
