"""Planar poses (x, y, yaw), one or many at a time: metres, metres, radians in [-pi, pi).

Named as transforms are: ``compose(a_b, b_c)`` is the pose of c in a.
"""

from collections.abc import Callable

import numpy as np

from fusion_core.model.conventions import FloatArray, wrap_angle

PosePrior = Callable[[int], FloatArray | None]
"""Stamp in ns to the (3,) pose of the LiDAR by another source, None where it is unknown."""


def compose_poses(pose_a_b: FloatArray, pose_b_c: FloatArray) -> FloatArray:
    """(..., 3) pose_a_c; the two broadcast."""
    c, s = np.cos(pose_a_b[..., 2]), np.sin(pose_a_b[..., 2])
    x, y = pose_b_c[..., 0], pose_b_c[..., 1]
    return _stack_poses(
        pose_a_b[..., 0] + c * x - s * y,
        pose_a_b[..., 1] + s * x + c * y,
        wrap_angle(pose_a_b[..., 2] + pose_b_c[..., 2]),
    )


def invert_pose(pose_a_b: FloatArray) -> FloatArray:
    """(..., 3) pose_b_a."""
    c, s = np.cos(pose_a_b[..., 2]), np.sin(pose_a_b[..., 2])
    x, y = pose_a_b[..., 0], pose_a_b[..., 1]
    return _stack_poses(-c * x - s * y, s * x - c * y, wrap_angle(-pose_a_b[..., 2]))


def relative_pose(pose_a_b: FloatArray, pose_a_c: FloatArray) -> FloatArray:
    """(..., 3) pose_b_c."""
    c, s = np.cos(pose_a_b[..., 2]), np.sin(pose_a_b[..., 2])
    # Subtracted first: products of positions far from the origin would lose their last digits.
    x, y = pose_a_c[..., 0] - pose_a_b[..., 0], pose_a_c[..., 1] - pose_a_b[..., 1]
    yaw = wrap_angle(pose_a_c[..., 2] - pose_a_b[..., 2])
    return _stack_poses(c * x + s * y, c * y - s * x, yaw)


def interpolate_pose(
    before: FloatArray, after: FloatArray, fraction: FloatArray | float
) -> FloatArray:
    """(..., 3) at ``fraction`` (...) in [0, 1] from one pose to another, the yaw along the shorter
    arc."""
    step = after - before
    step[..., 2] = wrap_angle(step[..., 2])
    poses: FloatArray = before + np.asarray(fraction)[..., np.newaxis] * step
    poses[..., 2] = wrap_angle(poses[..., 2])
    return poses


def _stack_poses(x: FloatArray, y: FloatArray, yaw: FloatArray) -> FloatArray:
    """(..., 3); faster than np.stack for single poses, the most frequent case."""
    poses = np.empty((*yaw.shape, 3))
    poses[..., 0], poses[..., 1], poses[..., 2] = x, y, yaw
    return poses


def transform_planar_points(pose_a_b: FloatArray, points_in_b_m: FloatArray) -> FloatArray:
    """(n, 2) points in a of (n, 2) points in b."""
    c, s = np.cos(pose_a_b[2]), np.sin(pose_a_b[2])
    moved: FloatArray = points_in_b_m @ np.array([[c, s], [-s, c]]) + pose_a_b[:2]
    return moved


def pose_after(velocity: FloatArray, seconds: FloatArray | float) -> FloatArray:
    """(..., 3) pose, in the frame at the start, of what moves at a constant velocity (..., 3) in
    its own frame: forward and left in m/s, counter-clockwise in rad/s. The exponential map of
    SE(2)."""
    moved = velocity * np.asarray(seconds)[..., np.newaxis]
    turned = moved[..., 2]
    along = np.sinc(turned / np.pi)
    # (1 - cos) / turned, which is turned / 2 near 0.
    across = 0.5 * turned * np.sinc(0.5 * turned / np.pi) ** 2
    x, y = moved[..., 0], moved[..., 1]
    return _stack_poses(along * x - across * y, across * x + along * y, wrap_angle(turned))


def velocity_between(pose: FloatArray, seconds: float) -> FloatArray:
    """(..., 3) the constant velocity that leads to a pose (..., 3), by less than half a turn: the
    inverse of ``pose_after``."""
    half = 0.5 * pose[..., 2]
    # half / tan(half), which is 1 at 0.
    along = np.cos(half) / np.sinc(half / np.pi)
    x, y = pose[..., 0], pose[..., 1]
    moved = [along * x + half * y, along * y - half * x, 2.0 * half]
    velocity: FloatArray = np.stack(moved, axis=-1) / seconds
    return velocity
