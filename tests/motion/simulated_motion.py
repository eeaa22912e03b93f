"""True motion and sources that err by a known law, without sensors."""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, wrap_angle
from fusion_core.motion.odometry_trajectory import OdometryTrajectory, mask_unmeasured
from fusion_core.motion.steps import integrate_steps

STEP_NS = 100_000_000


def stamps(count: int) -> IntArray:
    """(count,) ten a second."""
    return np.arange(count, dtype=np.int64) * STEP_NS + 1_700_000_000_000_000_000


def weaving(count: int, speed_m_s: float = 0.4) -> FloatArray:
    """(count - 1, 3) true steps ahead, turning to and fro."""
    phase = np.linspace(0.0, 4.0 * np.pi, count - 1)
    step = 1e-9 * STEP_NS * speed_m_s
    return np.stack([np.full(count - 1, step), np.zeros(count - 1), 0.02 * np.cos(phase)], axis=1)


def track_of(
    name: str,
    steps: FloatArray,
    sigma: Sequence[float],
    *,
    seed: int | None = None,
    unmeasured: slice | None = None,
    covariance: FloatArray | None = None,
) -> OdometryTrajectory:
    """A source whose steps err independently by ``sigma`` (x, y, yaw) and say so; with a seed they
    really err. ``covariance``: (3, 3) or (N - 1, 3, 3), what it says instead."""
    count = len(steps)
    noisy = steps.copy()
    if seed is not None:
        noisy += np.random.default_rng(seed).normal(0.0, sigma, steps.shape)
        noisy[:, 2] = wrap_angle(noisy[:, 2])
    measured = np.ones(count, dtype=np.bool_)
    if unmeasured is not None:
        measured[unmeasured] = False
        noisy[unmeasured] = 0.0
    said = np.diag(np.square(sigma)) if covariance is None else covariance
    said = mask_unmeasured(np.broadcast_to(said, (count, 3, 3)), measured)
    return OdometryTrajectory(
        name=name,
        stamps_ns=stamps(count + 1),
        poses_odom_lidar=integrate_steps(noisy),
        step_covariance=said.copy(),
        drift_covariance=said.copy(),
        measured=measured,
    )


def step_errors(trajectory: OdometryTrajectory, truth: FloatArray) -> FloatArray:
    """(N - 1, 3) of a trajectory's steps."""
    away = trajectory.steps - truth
    away[:, 2] = wrap_angle(away[:, 2])
    return away
