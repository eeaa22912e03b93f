"""Rigid transforms as plain arrays: (4, 4) in space, (x, y, yaw) in the plane."""

import numpy as np

from fusion_core.model.conventions import FloatArray

POSITION_MAX_M = 1e8
"""Greatest plausible distance of a recorded position from its origin: twice round the Earth."""


# Entries of R Rᵀ - 1: rotations printed with four digits pass, scaled or sheared matrices do not.
_RIGID_TOLERANCE = 1e-3
# Rounding of a float32 quaternion's entries is 1e-7; below this a direction is meaningless.
_QUATERNION_NORM_MIN = 1e-12


def make_transform(rotation: FloatArray, translation_m: FloatArray) -> FloatArray:
    """(4, 4) from a (3, 3) rotation and a (3,) translation."""
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = translation_m
    return result


def invert_transform(T_a_b: FloatArray) -> FloatArray:
    """T_b_a of a rigid (4, 4) T_a_b."""
    rotation = T_a_b[:3, :3].T
    return make_transform(rotation, -rotation @ T_a_b[:3, 3])


def rigid_fault(T: FloatArray) -> str:
    """Why a matrix is no rigid (4, 4) transform, as the rest of a sentence after a colon; empty for
    one that is."""
    if T.shape != (4, 4) or not np.isfinite(T).all():
        return f"it must be (4, 4) and finite, got {T.shape}"
    rotation = T[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        determinant = float(np.linalg.det(rotation))
    off = max(off, float(np.abs(T[3] - (0.0, 0.0, 0.0, 1.0)).max()))
    # What overflows is NaN, and no less than anything.
    if off <= _RIGID_TOLERANCE and determinant > 0.0:
        return ""
    return f"it is off by {off:.2g}, its determinant is {determinant:.3g}"


def transform_points(T_a_b: FloatArray, points_in_b: FloatArray) -> FloatArray:
    """(..., 3) points in b to (..., 3) points in a."""
    moved: FloatArray = points_in_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]
    return moved


def rotation_from_yaw_pitch_roll(yaw_rad: float, pitch_rad: float, roll_rad: float) -> FloatArray:
    """R = Rz(yaw) Ry(pitch) Rx(roll); positive pitch turns x towards -z (looks down)."""
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rotation_from_quaternion(x: float, y: float, z: float, w: float) -> FloatArray:
    """(3, 3) from a quaternion of any positive length.

    Raises ValueError for a quaternion that is not finite or has no length.
    """
    q = np.array([x, y, z, w], dtype=np.float64)
    length = float(np.linalg.norm(q))
    if not np.isfinite(length) or length < _QUATERNION_NORM_MIN:
        raise ValueError(f"a quaternion must be finite and not zero, got {q}")
    x, y, z, w = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def planar_from_transform(T_a_b: FloatArray) -> FloatArray:
    """(..., 3) x, y, yaw of (..., 4, 4), dropping height, pitch and roll."""
    yaw_rad = np.arctan2(T_a_b[..., 1, 0], T_a_b[..., 0, 0])
    return np.stack([T_a_b[..., 0, 3], T_a_b[..., 1, 3], yaw_rad], axis=-1)


def transform_from_planar(pose: FloatArray) -> FloatArray:
    """(..., 4, 4) of (..., 3) x, y, yaw."""
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    transform = np.zeros((*pose.shape[:-1], 4, 4))
    transform[..., 0, 0] = transform[..., 1, 1] = c
    transform[..., 1, 0], transform[..., 0, 1] = s, -s
    transform[..., 2, 2] = transform[..., 3, 3] = 1.0
    transform[..., :2, 3] = pose[..., :2]
    return transform
