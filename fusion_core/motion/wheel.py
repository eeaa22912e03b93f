"""Wheel odometry at the scans' stamps, with covariances from an odometry noise model.

The standard deviations grow in proportion to the motion, as in the odometry motion model of Thrun,
Burgard, Fox 2005, §5.4, but are split into forward, lateral and rotation errors.
"""

from collections.abc import Callable

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray
from fusion_core.motion.odometry_trajectory import OdometryTrajectory, mask_unmeasured
from fusion_core.motion.steps import steps_between
from fusion_core.settings import StageSettings, setting


class WheelSettings(StageSettings):
    """Noise model of wheel odometry; the defaults suit a small robot on a hard floor."""

    forward_sigma_per_m: float = setting(
        0.03,
        "Standard deviation along the direction of motion, per distance travelled",
        unit="m/m",
        ge=1e-6,
        le=1.0,
        formerly="way_share",
    )
    lateral_sigma_per_m: float = setting(
        0.01,
        "Standard deviation across the direction of motion, per distance travelled",
        unit="m/m",
        ge=1e-6,
        le=1.0,
        formerly="aside_share",
    )
    rotation_sigma_per_rad: float = setting(
        0.05,
        "Standard deviation of a rotation, per radian turned",
        unit="rad/rad",
        ge=1e-6,
        le=1.0,
        formerly="turn_share",
    )
    heading_sigma_per_m: float = setting(
        0.02,
        "Standard deviation of the heading, per distance travelled",
        unit="rad/m",
        ge=1e-6,
        le=1.0,
        formerly="turn_per_m",
    )
    standstill_sigma_m: float = setting(
        1e-4,
        "Least standard deviation of a step, x and y",
        unit="m",
        ge=1e-6,
        le=0.1,
        formerly="rest_sigma_m",
    )
    standstill_sigma_rad: float = setting(
        1e-4,
        "Least standard deviation of a step, heading",
        unit="rad",
        ge=1e-6,
        le=0.1,
        formerly="rest_sigma_rad",
    )
    gap_max_s: float = setting(
        0.25,
        "Longest time between two odometry samples that is interpolated",
        unit="s",
        ge=1e-6,
        le=60.0,
        formerly="gap_s",
    )


# Set by hand: wheel errors are taken as fully correlated over a metre or a radian and independent
# beyond, so that drift is a random walk with steps of this length.
_CORRELATION_M = 1.0
_CORRELATION_RAD = 1.0


def wheel_odometry(
    stamps_ns: IntArray,
    pose_at: Callable[[int], FloatArray | None],
    sampled_ns: IntArray,
    settings: WheelSettings | None = None,
) -> OdometryTrajectory:
    """Wheel odometry at ``stamps_ns``, (N,) the scans'.

    ``pose_at``: recorded odometry as the LiDAR's (x, y, yaw), None outside the recording.
    ``sampled_ns``: (K,) stamps of its samples, to find gaps. Where there is no pose, the last one
    is kept.
    """
    settings = settings or WheelSettings()
    poses = np.zeros((stamps_ns.size, 3))
    reached = np.zeros(stamps_ns.size, dtype=np.bool_)
    in_gap = _in_gap(stamps_ns, sampled_ns, settings.gap_max_s)
    for k, stamp_ns in enumerate(stamps_ns.tolist()):
        pose = pose_at(stamp_ns)
        reached[k] = pose is not None
        if pose is not None and not in_gap[k]:
            poses[k] = pose
        elif k:
            poses[k] = poses[k - 1]
    known = reached & ~in_gap
    if known.any():
        # Before the first known pose: that pose.
        first = int(np.argmax(known))
        poses[:first] = poses[first]
    measured: BoolArray = known[:-1] & known[1:]
    single, drift = _covariances(steps_between(poses), settings)
    return OdometryTrajectory(
        name="wheel",
        stamps_ns=stamps_ns.copy(),
        poses_odom_lidar=poses,
        step_covariance=mask_unmeasured(single, measured),
        drift_covariance=mask_unmeasured(drift, measured),
        measured=measured,
        notes=_notes(reached, in_gap, settings.gap_max_s),
    )


def _notes(reached: BoolArray, in_gap: BoolArray, gap_s: float) -> tuple[str, ...]:
    reasons = []
    if outside := int(np.count_nonzero(~reached)):
        reasons.append(f"{outside} outside the recorded odometry")
    if gaps := int(np.count_nonzero(reached & in_gap)):
        reasons.append(f"{gaps} in its gaps of more than {gap_s:g} s")
    return (f"wheel: scans without a pose: {', '.join(reasons)}.",) if reasons else ()


def _in_gap(stamps_ns: IntArray, sampled_ns: IntArray, gap_s: float) -> BoolArray:
    """(N,) whether a stamp lies strictly between two samples that are too far apart.

    Encoders keep counting between samples, so a step from sample to sample is known across a gap.
    """
    sampled_ns = np.unique(sampled_ns)
    after = np.searchsorted(sampled_ns, stamps_ns)
    inside = (after > 0) & (after < sampled_ns.size)
    end = np.minimum(after, sampled_ns.size - 1)
    on_sample = sampled_ns[end] == stamps_ns
    long = sampled_ns[end] - sampled_ns[np.maximum(end - 1, 0)] > gap_s * NS_PER_S
    between: BoolArray = inside & ~on_sample & long
    return between


def _covariances(steps: FloatArray, settings: WheelSettings) -> tuple[FloatArray, FloatArray]:
    """(N - 1, 3, 3) twice: covariance of each step alone, and its contribution to drift."""
    distance_m, rotation_rad = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    single, drift = np.zeros((2, len(steps), 3, 3))
    sigmas = [settings.standstill_sigma_m] * 2 + [settings.standstill_sigma_rad]
    floor = np.diag(np.square(sigmas))
    for covariance, squared_m2, squared_rad2 in (
        (single, distance_m**2, rotation_rad**2),
        (drift, _CORRELATION_M * distance_m, _CORRELATION_RAD * rotation_rad),
    ):
        along = settings.forward_sigma_per_m**2 * squared_m2
        heading = (
            settings.rotation_sigma_per_rad**2 * squared_rad2
            + settings.heading_sigma_per_m**2 * squared_m2
        )
        across = settings.lateral_sigma_per_m**2 * squared_m2
        direction = steps[:, :2] / np.maximum(distance_m, 1e-12)[:, np.newaxis]
        normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        covariance[:, :2, :2] = along[:, None, None] * _outer(direction)
        covariance[:, :2, :2] += across[:, None, None] * _outer(normal)
        covariance[:, 2, 2] = heading
        covariance += floor
    return single, drift


def _outer(vectors: FloatArray) -> FloatArray:
    """(N, 2, 2) of (N, 2)."""
    return vectors[:, :, np.newaxis] * vectors[:, np.newaxis, :]
