"""Li 2022 (6) to (9) as printed, for each of x, y and yaw of a step in the last fused frame.

    K = σ_v² / (σ_v² + σ_s²)                                   (6)
    X_k = X_v + K (X_s - X_v)                                  (7)
    σ_v = X_v - X_k, σ_s = X_s - X_k                           (8)
    L = δ_d / (δ_d + δ_k) X_k + (1 - δ_d / (δ_d + δ_k)) p_d    (9)

With (7) in (8), σ_v = -K (X_s - X_v) and σ_s = (1 - K) (X_s - X_v): the next K is
K² / (K² + (1 - K)²) whatever the data, so one source takes all the weight within a few steps.
Where both deviations are zero, K keeps its value.

What the paper leaves open is read as follows. σ at k = 0 is the standard deviation of the steps
during a standstill, or of the sources' first steps where there is none. δ comes from residuals over
a window: δ_k is a quarter of the mean square of X_s - X_v (the variance of the mean of two equally
good sources), or a single source's own variance; δ_d is the mean square of p_d - X_k minus δ_k. A
source that did not measure a step has no weight in it.
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, wrap_angle
from fusion_core.motion.fusion_weights import FusionWeights
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.motion.steps import integrate_steps, subtract_poses
from fusion_core.settings import StageSettings, setting


class PublishedFusionSettings(StageSettings):
    """Settings of the fusion as printed."""

    standstill_min_s: float = setting(
        1.0,
        "Shortest standstill from which σ at k = 0 is estimated",
        unit="s",
        ge=1e-6,
        le=3_600.0,
        formerly="rest_s",
    )
    standstill_speed_m_s: float = setting(
        0.03,
        "Greatest speed of a standstill",
        unit="m/s",
        ge=1e-6,
        le=1.0,
        formerly="rest_m_per_s",
    )
    standstill_turn_rad_s: float = setting(
        0.05,
        "Greatest turn rate of a standstill",
        unit="rad/s",
        ge=1e-6,
        le=1.0,
        formerly="rest_rad_per_s",
    )
    window: int = setting(
        20,
        "Steps over which the disagreement between sources is averaged",
        unit="steps",
        ge=2,
        le=10_000,
    )


# (1 µm)²: two sources at standstill may agree to the last digit, and weights divide by this.
_VARIANCE_MIN = 1e-12
# Over a shorter interval the noise of one pose (about 1 cm) looks like speed.
_SPEED_INTERVAL_MIN_S = 0.5


def fuse_as_published(
    trajectories: Sequence[OdometryTrajectory], settings: PublishedFusionSettings
) -> tuple[OdometryTrajectory, FusionWeights]:
    """The fused trajectory and its weights; ``trajectories`` have the same stamps."""
    by_name = {trajectory.name: trajectory for trajectory in trajectories}
    wheel, laser, visual = (by_name.get(name) for name in ("wheel", "laser", "visual"))
    stamps_ns = trajectories[0].stamps_ns
    count = stamps_ns.size - 1
    K = _first_gain(laser, visual, settings)
    fused, gains = np.zeros((count, 3)), np.zeros((count, 3))
    weights_of_source = {trajectory.name: np.zeros((count, 3)) for trajectory in trajectories}
    pairs, wheels = _MeanSquare(settings.window), _MeanSquare(settings.window)
    seconds = np.diff(stamps_ns) / 1e9
    for k in range(count):
        gains[k] = K
        X_v, X_s, p_d = (_measured_step(trajectory, k) for trajectory in (visual, laser, wheel))
        X_k: FloatArray | None
        if X_v is not None and X_s is not None:
            X_k = X_v + K * subtract_poses(X_s, X_v)  # (7)
            weight_of = {"visual": 1.0 - K, "laser": K}
            pairs.add(subtract_poses(X_s, X_v))
            delta_k = 0.25 * pairs.mean
            sigma_v, sigma_s = subtract_poses(X_v, X_k), subtract_poses(X_s, X_k)  # (8)
            total = sigma_v**2 + sigma_s**2
            is_defined = total > 0.0
            K = np.where(is_defined, sigma_v**2 / np.where(is_defined, total, 1.0), K)  # (6)
        elif X_s is not None or X_v is not None:
            alone = laser if X_s is not None else visual
            assert alone is not None, "a step has a source"
            X_k = X_s if X_s is not None else X_v
            weight_of = {alone.name: np.ones(3)}
            delta_k = alone.step_covariance[k].diagonal()
        else:
            X_k, weight_of, delta_k = None, {}, np.zeros(3)
        if X_k is not None and p_d is not None:
            wheels.add(subtract_poses(p_d, X_k))
            delta_d = np.maximum(wheels.mean - delta_k, _VARIANCE_MIN)
            camera_laser_weight = delta_d / (delta_d + np.maximum(delta_k, _VARIANCE_MIN))
            fused[k] = p_d + camera_laser_weight * subtract_poses(X_k, p_d)  # (9)
            weight_of = {name: camera_laser_weight * weight for name, weight in weight_of.items()}
            weight_of["wheel"] = 1.0 - camera_laser_weight
        elif X_k is not None or p_d is not None:
            only = X_k if X_k is not None else p_d
            assert only is not None, "one of the two is there"
            fused[k] = only
            weight_of = weight_of or {"wheel": np.ones(3)}
        elif k:
            fused[k] = fused[k - 1] * (seconds[k] / seconds[k - 1])
        fused[k, 2] = wrap_angle(fused[k, 2])
        for name, weight in weight_of.items():
            weights_of_source[name][k] = weight
    return _make_results(trajectories, fused, gains, weights_of_source)


def next_gain(K: float) -> float:
    """The next K by (6) to (8), which does not depend on the data."""
    return K**2 / (K**2 + (1.0 - K) ** 2)


class _MeanSquare:
    """Mean square of the last residuals, for each of x, y and yaw."""

    def __init__(self, window: int) -> None:
        self._window, self._kept = window, np.empty((0, 3))

    def add(self, residual: FloatArray) -> None:
        self._kept = np.vstack([self._kept, residual**2])[-self._window :]

    @property
    def mean(self) -> FloatArray:
        mean: FloatArray = self._kept.mean(axis=0)
        return mean


def _measured_step(trajectory: OdometryTrajectory | None, k: int) -> FloatArray | None:
    if trajectory is None or not trajectory.measured[k]:
        return None
    step: FloatArray = trajectory.steps[k].copy()
    return step


def _first_gain(
    laser: OdometryTrajectory | None,
    visual: OdometryTrajectory | None,
    settings: PublishedFusionSettings,
) -> FloatArray:
    """(3,) K of (6) with the sources' noise at standstill."""
    if laser is None or visual is None:
        # A single source has all the weight.
        return np.full(3, 0.0 if laser is None else 1.0)
    both = laser.measured & visual.measured
    if not both.any():
        return np.full(3, 0.5)
    standstill = _find_standstill(laser, visual, settings)
    if standstill is None:
        first = int(np.argmax(both))
        variance_v, variance_s = (t.step_covariance[first].diagonal() for t in (visual, laser))
    else:
        variance_v, variance_s = (
            np.maximum(t.steps[standstill].var(axis=0), _VARIANCE_MIN) for t in (visual, laser)
        )
    gain: FloatArray = variance_v / (variance_v + variance_s)
    return gain


def _find_standstill(
    laser: OdometryTrajectory, visual: OdometryTrajectory, settings: PublishedFusionSettings
) -> slice | None:
    """The first ``standstill_min_s`` in which both report no motion above the limits of a
    standstill."""
    both = laser.measured & visual.measured
    elapsed_s = (laser.stamps_ns - laser.stamps_ns[0]) / 1e9
    ends = np.searchsorted(elapsed_s, elapsed_s + settings.standstill_min_s)
    paths = [np.vstack([np.zeros(3), np.cumsum(t.steps, axis=0)]) for t in (laser, visual)]
    for begin, end in enumerate(ends.tolist()):
        if end >= elapsed_s.size:
            return None
        window = slice(begin, end + 1)
        stood = all(_is_standstill(path[window], elapsed_s[window], settings) for path in paths)
        if stood and end - begin > 1 and both[begin:end].all():
            return slice(begin, end)
    return None


def _is_standstill(
    path: FloatArray, elapsed_s: FloatArray, settings: PublishedFusionSettings
) -> bool:
    """Whether (M, 3) summed steps stay near their first and their last value."""
    for at in (0, -1):
        since_s = np.maximum(np.abs(elapsed_s - elapsed_s[at]), _SPEED_INTERVAL_MIN_S)
        moved = np.abs(path - path[at])
        if np.any(np.hypot(moved[:, 0], moved[:, 1]) > settings.standstill_speed_m_s * since_s):
            return False
        if np.any(moved[:, 2] > settings.standstill_turn_rad_s * since_s):
            return False
    return True


def _make_results(
    trajectories: Sequence[OdometryTrajectory],
    fused: FloatArray,
    gains: FloatArray,
    weights_of_source: dict[str, FloatArray],
) -> tuple[OdometryTrajectory, FusionWeights]:
    stacked = np.stack([weights_of_source[trajectory.name] for trajectory in trajectories], axis=1)
    measured = np.stack([trajectory.measured for trajectory in trajectories], axis=1)
    is_measured: BoolArray = np.any(measured, axis=1)
    weights_squared = stacked[..., np.newaxis] * stacked[..., np.newaxis, :]
    covariance, drift = (
        np.where(
            is_measured[:, np.newaxis, np.newaxis],
            (weights_squared * np.nan_to_num(np.stack(of_source, axis=1))).sum(axis=1),
            np.nan,
        )
        for of_source in (
            [trajectory.step_covariance for trajectory in trajectories],
            [trajectory.drift_covariance for trajectory in trajectories],
        )
    )
    away = subtract_poses(
        np.stack([trajectory.steps for trajectory in trajectories], axis=1), fused[:, np.newaxis]
    )
    trajectory = OdometryTrajectory(
        name="fused",
        stamps_ns=trajectories[0].stamps_ns.copy(),
        poses_odom_lidar=integrate_steps(fused),
        step_covariance=covariance,
        drift_covariance=drift,
        measured=is_measured,
    )
    weights = FusionWeights(
        sources=tuple(trajectory.name for trajectory in trajectories),
        stamps_ns=trajectories[0].stamps_ns.copy(),
        translation=stacked[..., :2].mean(axis=2),
        rotation=stacked[..., 2],
        rejected=np.zeros(measured.shape, dtype=np.bool_),
        residual_m=np.where(measured, np.hypot(away[..., 0], away[..., 1]), np.nan),
        residual_rad=np.where(measured, np.abs(away[..., 2]), np.nan),
        gain=gains,
    )
    return trajectory, weights
