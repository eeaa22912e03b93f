"""Small changes of a pose, in the order and the axes of ``POSE_PARAMETERS``."""

import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import make_transform


def apply_pose_error(T_a_b: FloatArray, error: FloatArray) -> FloatArray:
    """(4, 4) with R = Exp(ω) R̂ and t = t̂ + τ for a (6,) error (ω, τ), both along a's axes."""
    rotation = Rotation.from_rotvec(error[:3]).as_matrix() @ T_a_b[:3, :3]
    return make_transform(rotation, T_a_b[:3, 3] + error[3:])


def pose_error(T_true: FloatArray, T_estimate: FloatArray) -> FloatArray:
    """(6,) the error that leads from the estimate to the truth: the inverse of
    ``apply_pose_error``."""
    rotation = T_true[:3, :3] @ T_estimate[:3, :3].T
    return np.concatenate(
        [Rotation.from_matrix(rotation).as_rotvec(), T_true[:3, 3] - T_estimate[:3, 3]]
    )


def rotation_angle_rad(T_a: FloatArray, T_b: FloatArray) -> float:
    """The angle between two rotations."""
    return float(np.linalg.norm(pose_error(T_a, T_b)[:3]))
