"""Steps fused by their covariances: Li 2022 (6), (7) and (9) as the Kalman filter has them.

With covariances instead of (8)'s deviations, (6), (7) and (9) are all the information-weighted
mean: one rule for any number of sources, in any order. The weights are matrices, so that along a
corridor the wheels dominate and across it the laser.
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, wrap_angle
from fusion_core.motion.fusion_weights import FusionWeights
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.motion.steps import integrate_steps, subtract_poses
from fusion_core.settings import StageSettings, setting


class CovarianceFusionSettings(StageSettings):
    """Settings of the default fusion."""

    gate: float = setting(
        16.27,
        "Greatest squared Mahalanobis distance of a step from the others (χ², 3 dof, 99.9 %)",
        ge=1e-6,
        le=1e9,
    )
    window: int = setting(
        20,
        "Steps over which the disagreement between sources is averaged",
        unit="steps",
        ge=2,
        le=10_000,
    )
    sigma_min_m: float = setting(
        1e-4, "Least standard deviation of a step, x and y", unit="m", ge=1e-9, le=0.1
    )
    sigma_min_rad: float = setting(
        2e-5, "Least standard deviation of a step, heading", unit="rad", ge=1e-9, le=0.1
    )


# Cap on a squared distance, so that one outlier does not dominate the window; set by hand.
_SQUARE_MAX = 100.0
# Of a planar step; the mean of a chi-square distributed squared distance.
_DEGREES_OF_FREEDOM = 3.0


def fuse_by_covariance(
    trajectories: Sequence[OdometryTrajectory], settings: CovarianceFusionSettings
) -> tuple[OdometryTrajectory, FusionWeights]:
    """The fused trajectory and its weights; ``trajectories`` have the same stamps.

    Consistency is tested with ``step_covariance``; the weights come from ``drift_covariance``, the
    errors that accumulate. Where a source's squared distances from the others exceed what its
    covariance explains, averaged over a window of steps, its covariance is inflated by the ratio.
    Where two sources disagree and there is no third, the one with the smaller covariance along the
    disagreement is kept: mostly the laser, since wheels do not observe their own slip.
    """
    count, sources = trajectories[0].measured.size, len(trajectories)
    steps = np.stack([trajectory.steps for trajectory in trajectories], axis=1)
    floor = np.diag(np.square([settings.sigma_min_m] * 2 + [settings.sigma_min_rad]))
    singles = np.stack([trajectory.step_covariance for trajectory in trajectories], axis=1) + floor
    drifts = np.stack([trajectory.drift_covariance for trajectory in trajectories], axis=1) + floor
    measured = np.stack([trajectory.measured for trajectory in trajectories], axis=1)

    fused = np.zeros((count, 3))
    covariance, drift = np.full((2, count, 3, 3), np.nan)
    translation, rotation = np.zeros((2, count, sources))
    rejected = np.zeros((count, sources), dtype=np.bool_)
    history = [_CovarianceInflation(settings.window) for _ in trajectories]
    seconds = np.diff(trajectories[0].stamps_ns) / 1e9
    for k in range(count):
        available = [s for s in range(sources) if measured[k, s]]
        if not available:
            # The last fused velocity is repeated.
            fused[k] = fused[k - 1] * (seconds[k] / seconds[k - 1]) if k else 0.0
            continue
        consistent = _select_consistent(available, steps[k], singles[k], drifts[k], settings.gate)
        rejected[k, [s for s in available if s not in consistent]] = True
        factors = [history[s].factor for s in consistent]
        informations = np.stack(
            [np.linalg.inv(drifts[k, s]) / f for s, f in zip(consistent, factors, strict=True)]
        )
        drift[k] = np.linalg.inv(informations.sum(axis=0))
        fused[k] = _weighted_mean(steps[k, consistent], informations, drift[k])
        gains = drift[k] @ informations
        spread = np.stack([f * singles[k, s] for s, f in zip(consistent, factors, strict=True)])
        covariance[k] = (gains @ spread @ np.swapaxes(gains, 1, 2)).sum(axis=0)
        translation[k, consistent], rotation[k, consistent] = _information_fractions(informations)
        if len(available) > 1:
            for s in available:
                others = [o for o in consistent if o != s]
                if others:
                    history[s].add(_squared_mahalanobis(s, others, steps[k], singles[k]))
    away = subtract_poses(steps, fused[:, np.newaxis])
    is_measured: BoolArray = np.any(measured, axis=1)
    trajectory = OdometryTrajectory(
        name="fused",
        stamps_ns=trajectories[0].stamps_ns.copy(),
        poses_odom_lidar=integrate_steps(fused),
        step_covariance=covariance,
        drift_covariance=drift,
        measured=is_measured,
        notes=_notes(trajectories, rejected, is_measured.sum()),
    )
    weights = FusionWeights(
        sources=tuple(trajectory.name for trajectory in trajectories),
        stamps_ns=trajectories[0].stamps_ns.copy(),
        translation=translation,
        rotation=rotation,
        rejected=rejected,
        residual_m=np.where(measured, np.hypot(away[..., 0], away[..., 1]), np.nan),
        residual_rad=np.where(measured, np.abs(away[..., 2]), np.nan),
    )
    return trajectory, weights


class _CovarianceInflation:
    """Factor on a source's covariance, from its squared distances over the last steps."""

    def __init__(self, window: int) -> None:
        self._squares = np.full(window, _DEGREES_OF_FREEDOM)
        self._next = 0

    def add(self, square: float) -> None:
        self._squares[self._next] = min(square, _SQUARE_MAX)
        self._next = (self._next + 1) % self._squares.size

    @property
    def factor(self) -> float:
        """At least 1."""
        return max(1.0, float(self._squares.mean()) / _DEGREES_OF_FREEDOM)


def _select_consistent(
    available: Sequence[int],
    steps: FloatArray,
    singles: FloatArray,
    drifts: FloatArray,
    gate: float,
) -> list[int]:
    """The sources that agree; the one farthest from the others is removed until all do."""
    consistent = list(available)
    while len(consistent) > 1:
        squares = [
            _squared_mahalanobis(s, [o for o in consistent if o != s], steps, singles)
            for s in consistent
        ]
        if max(squares) <= gate:
            break
        if len(consistent) > 2:
            consistent.pop(int(np.argmax(squares)))
            continue
        away = subtract_poses(steps[consistent[0]], steps[consistent[1]])
        # Their distance is the same for both: the one is kept for which it is the less likely
        # error, by its own drift covariance.
        costs = [float(away @ np.linalg.solve(drifts[s], away)) for s in consistent]
        consistent.pop(int(np.argmin(costs)))
    return consistent


def _squared_mahalanobis(
    source: int, others: Sequence[int], steps: FloatArray, singles: FloatArray
) -> float:
    """Squared Mahalanobis distance of a source's step from the mean of others."""
    informations: FloatArray = np.asarray(np.linalg.inv(singles[list(others)]), dtype=np.float64)
    covariance: FloatArray = np.asarray(np.linalg.inv(informations.sum(axis=0)), dtype=np.float64)
    away = subtract_poses(
        steps[source], _weighted_mean(steps[list(others)], informations, covariance)
    )
    return float(away @ np.linalg.solve(singles[source] + covariance, away))


def _weighted_mean(
    steps: FloatArray, informations: FloatArray, covariance: FloatArray
) -> FloatArray:
    """(3,) mean of (S, 3) steps by their (S, 3, 3) information, the yaws wrapped; ``covariance``
    is the inverse of its sum."""
    away = subtract_poses(steps, steps[0])
    mean: FloatArray = steps[0] + covariance @ np.einsum("sab,sb->a", informations, away)
    mean[2] = wrap_angle(mean[2])
    return mean


def _information_fractions(informations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(S,) fractions of the information on translation, averaged over directions, and on yaw.

    tr((Σ I)⁻¹ I_s) / 2 over the translation's block: never negative, and they sum to 1.
    """
    blocks = informations[:, :2, :2]
    inverse = np.linalg.inv(blocks.sum(axis=0))
    translation = np.maximum(0.5 * np.einsum("ab,sba->s", inverse, blocks), 0.0)
    rotation = informations[:, 2, 2]
    return translation / translation.sum(), rotation / rotation.sum()


def _notes(
    trajectories: Sequence[OdometryTrajectory], rejected: BoolArray, measured: int
) -> tuple[str, ...]:
    notes = []
    for source, trajectory in enumerate(trajectories):
        if left_out := int(np.count_nonzero(rejected[:, source])):
            notes.append(f"fused: {trajectory.name} not believed in {left_out} steps.")
    if missed := rejected.shape[0] - int(measured):
        notes.append(f"fused: {missed} steps that no source measured.")
    return tuple(notes)
