"""Planar steps (x, y, yaw), one or many at a time: metres, metres, radians in [-pi, pi).

A covariance of a step is in the axes of the pose that it leaves: errors of x and y along these,
and of the turn.
"""

import numpy as np

from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.planar_poses import relative_pose


def steps_between(poses: FloatArray) -> FloatArray:
    """(N - 1, 3) the step from each of (N, 3) poses to the next."""
    return relative_pose(poses[:-1], poses[1:])


def integrate_steps(steps: FloatArray, start: FloatArray | None = None) -> FloatArray:
    """(N + 1, 3) the poses that (N, 3) steps lead to, from ``start`` or the origin."""
    poses = np.zeros((len(steps) + 1, 3))
    if start is not None:
        poses[0] = start
    # A turn is the sum of those before it, and with the turns known the way is a sum too.
    poses[1:, 2] = poses[0, 2] + np.cumsum(steps[:, 2])
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    poses[1:, 0] = poses[0, 0] + np.cumsum(c * steps[:, 0] - s * steps[:, 1])
    poses[1:, 1] = poses[0, 1] + np.cumsum(s * steps[:, 0] + c * steps[:, 1])
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


def subtract_poses(first: FloatArray, second: FloatArray) -> FloatArray:
    """(..., 3) first - second, the turn wrapped."""
    away: FloatArray = first - second
    away[..., 2] = wrap_angle(away[..., 2])
    return away


def rotate_covariance(yaw_rad: FloatArray | float, covariance: FloatArray) -> FloatArray:
    """(..., 3, 3) a covariance of (x, y, yaw) in axes that are turned by ``yaw_rad``."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    zero, one = np.zeros_like(c), np.ones_like(c)
    rows = [[c, s, zero], [-s, c, zero], [zero, zero, one]]
    turned = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    result: FloatArray = turned @ covariance @ np.swapaxes(turned, -1, -2)
    return result
