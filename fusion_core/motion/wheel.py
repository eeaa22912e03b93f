"""Wheel odometry at the scans' stamps, with the doubt that a simple model of motion gives it."""

from collections.abc import Callable

import numpy as np

from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray, IntArray
from fusion_core.motion.odometry_trajectory import OdometryTrajectory, mask_unmeasured
from fusion_core.motion.steps import steps_between
from fusion_core.settings import StageSettings, setting


class WheelSettings(StageSettings):
    """How wheel odometry errs; the defaults are those of a small robot on a hard floor."""

    forward_sigma_per_m: float = setting(
        0.03,
        "Standard deviation of a way, in metres per metre",
        unit="m/m",
        ge=1e-6,
        le=1.0,
        formerly="way_share",
    )
    lateral_sigma_per_m: float = setting(
        0.01,
        "The same, across the way: wheels slip aside less",
        unit="m/m",
        ge=1e-6,
        le=1.0,
        formerly="aside_share",
    )
    rotation_sigma_per_rad: float = setting(
        0.05,
        "Standard deviation of a turn, in radians per radian",
        unit="rad/rad",
        ge=1e-6,
        le=1.0,
        formerly="turn_share",
    )
    heading_sigma_per_m: float = setting(
        0.02,
        "Standard deviation of the heading, per metre of way",
        unit="rad/m",
        ge=1e-6,
        le=1.0,
        formerly="turn_per_m",
    )
    standstill_sigma_m: float = setting(
        1e-4,
        "Standard deviation of a step at rest",
        unit="m",
        ge=1e-6,
        le=0.1,
        formerly="rest_sigma_m",
    )
    standstill_sigma_rad: float = setting(
        1e-4,
        "Standard deviation of a turn at rest",
        unit="rad",
        ge=1e-6,
        le=0.1,
        formerly="rest_sigma_rad",
    )
    gap_max_s: float = setting(
        0.25,
        "Between two samples farther apart no pose is known",
        unit="s",
        ge=1e-6,
        le=60.0,
        formerly="gap_s",
    )


# Over this way and this turn the errors of wheels are alike, so that their shares add up.
_CORRELATION_M = 1.0
_CORRELATION_RAD = 1.0


def wheel_odometry(
    stamps_ns: IntArray,
    pose_at: Callable[[int], FloatArray | None],
    sampled_ns: IntArray,
    settings: WheelSettings | None = None,
) -> OdometryTrajectory:
    """Wheel odometry at ``stamps_ns``, (N,) the scans'.

    ``at``: recorded odometry of the LiDAR, x, y, yaw, None where it does not reach. ``sampled_ns``:
    (K,) the stamps of its samples, by which its gaps are told. Where there is no pose, the last
    one stays.
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
        # Before the first pose it stood where that one is.
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
    """(N,) whether a stamp lies between two samples that are too far apart, and on neither.

    Wheels count on while nobody asks them, so a gap between two stamps that were sampled is none.
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
    """(N - 1, 3, 3) twice: of each step alone, and what it adds to a longer way."""
    way_m, turn_rad = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    single, drift = np.zeros((2, len(steps), 3, 3))
    rest = (
        np.array(
            [
                settings.standstill_sigma_m,
                settings.standstill_sigma_m,
                settings.standstill_sigma_rad,
            ]
        )
        ** 2
    )
    for covariance, way_2, turn_2 in (
        (single, way_m**2, turn_rad**2),
        (drift, _CORRELATION_M * way_m, _CORRELATION_RAD * turn_rad),
    ):
        along = settings.forward_sigma_per_m**2 * way_2
        heading = (
            settings.rotation_sigma_per_rad**2 * turn_2 + settings.heading_sigma_per_m**2 * way_2
        )
        across = settings.lateral_sigma_per_m**2 * way_2
        direction = steps[:, :2] / np.maximum(way_m, 1e-12)[:, np.newaxis]
        normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
        covariance[:, :2, :2] = along[:, None, None] * _outer(direction)
        covariance[:, :2, :2] += across[:, None, None] * _outer(normal)
        covariance[:, 2, 2] = heading
        covariance += np.diag(rest)
    return single, drift


def _outer(vectors: FloatArray) -> FloatArray:
    """(N, 2, 2) of (N, 2)."""
    return vectors[:, :, np.newaxis] * vectors[:, np.newaxis, :]
