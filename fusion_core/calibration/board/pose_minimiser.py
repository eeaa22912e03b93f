"""Levenberg-Marquardt on SE(3), with some of the pose's parameters held where they were."""

from collections.abc import Callable

import numpy as np

from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.model.conventions import BoolArray, FloatArray

Evaluate = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""A pose (4, 4) to residuals (n,) and their derivatives (n, 6) by an error of it."""

_STEPS_MAX = 60
_DAMPING, _DAMPING_MAX = 1e-4, 1e10
_STEP_MIN = 1e-10


def minimise_pose(
    evaluate: Evaluate, T_start: FloatArray, T: FloatArray, free: BoolArray
) -> FloatArray:
    """(4, 4) of the least sum of squares near ``T``.

    Parameters (POSE_PARAMETERS) that are not ``free`` keep the value of ``T_start``.
    """
    x = np.where(free, pose_error(T, T_start), 0.0)
    T = apply_pose_error(T_start, x)
    residuals, jacobian = evaluate(T)
    cost, damping = float(residuals @ residuals), _DAMPING
    for _ in range(_STEPS_MAX):
        by_x = jacobian.copy()
        by_x[:, :3] = jacobian[:, :3] @ _left_jacobian(x[:3])
        by_x = by_x[:, free]
        normal = by_x.T @ by_x
        scale = np.maximum(np.diag(normal), 1e-12 * max(float(normal.max()), 1e-300))
        gradient = by_x.T @ residuals
        while damping < _DAMPING_MAX:
            step: FloatArray = np.zeros(6)
            step[free] = -np.linalg.solve(normal + damping * np.diag(scale), gradient)
            T_next = apply_pose_error(T_start, x + step)
            residuals_next, jacobian_next = evaluate(T_next)
            cost_next = float(residuals_next @ residuals_next)
            if cost_next <= cost:
                break
            damping *= 10.0
        else:
            return T
        x, T, residuals, jacobian = x + step, T_next, residuals_next, jacobian_next
        cost, damping = cost_next, max(0.1 * damping, 1e-12)
        if float(np.abs(step).max()) < _STEP_MIN:
            break
    return T


def _left_jacobian(rotation_vector: FloatArray) -> FloatArray:
    """(3, 3) with Exp(w + d) = Exp(J d) Exp(w) to first order."""
    angle = float(np.linalg.norm(rotation_vector))
    x, y, z = rotation_vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-4:
        first, second = 0.5, 1.0 / 6.0
    else:
        first = (1.0 - np.cos(angle)) / angle**2
        second = (angle - np.sin(angle)) / angle**3
    jacobian: FloatArray = np.eye(3) + first * cross + second * cross @ cross
    return jacobian
