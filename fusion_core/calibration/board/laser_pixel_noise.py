"""Pairs of a laser point and its pixel under a pose, and the noise that explains their residuals.

A residual has the covariance σ_px² I + σ_m² G Gᵀ, G the derivative of the pixel by the laser point:
a near point that is wrong by a centimetre moves its pixel farther than a distant one.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.board.board_pose import pose_jacobian
from fusion_core.calibration.board.pose_minimiser import minimise_pose
from fusion_core.calibration.pose_error import pose_error
from fusion_core.lens.projection import project_with_jacobian
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.geometry import transform_points
from fusion_core.model.sensors import CameraIntrinsics

# A point closer to the camera is projected as if it were there.
_NEAR_M = 1e-3
# σ_m / σ_px in metres per pixel: from pixels alone to laser points alone.
_RATIOS = np.concatenate([[0.0], np.geomspace(1e-4, 1.0, 25)])
_ROUNDS = 8


@dataclass(frozen=True, slots=True)
class Pairs:
    """``points_m``: (N, 3) with z = 0. ``pixels``: (N, 2)."""

    points_m: FloatArray
    pixels: FloatArray
    intrinsics: CameraIntrinsics

    def subset(self, chosen: IntArray | BoolArray) -> "Pairs":
        """The chosen pairs."""
        return Pairs(self.points_m[chosen], self.pixels[chosen], self.intrinsics)

    def residuals_px(self, T_camera_lidar: FloatArray) -> FloatArray:
        """(N, 2) measured - projected."""
        projected, _ = project_with_jacobian(self._seen(T_camera_lidar), self.intrinsics)
        return self.pixels - projected

    def jacobians(self, T_camera_lidar: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2, 6) of the pixel by the pose's error, (N, 2, 2) by the laser point's x and y."""
        seen = self._seen(T_camera_lidar)
        _, by_point = project_with_jacobian(seen, self.intrinsics)
        by_pose = np.einsum("nij,njk->nik", by_point, pose_jacobian(T_camera_lidar, seen))
        return by_pose, by_point @ T_camera_lidar[:3, :2]

    def are_ahead(self, T_camera_lidar: FloatArray) -> bool:
        """Whether most points lie before the camera."""
        ahead = transform_points(T_camera_lidar, self.points_m)[:, 2] > _NEAR_M
        return bool(ahead.mean() > 0.5)

    def _seen(self, T_camera_lidar: FloatArray) -> FloatArray:
        seen = transform_points(T_camera_lidar, self.points_m)
        # Behind the camera is as wrong as just before it, and must be as large an error.
        seen[:, 2] = np.maximum(seen[:, 2], _NEAR_M)
        return seen


@dataclass(frozen=True, slots=True)
class PairNoise:
    """Standard deviations of a pixel and of a laser point's coordinates."""

    pixel_px: float
    laser_m: float

    def whitening(self, pairs: Pairs, T_camera_lidar: FloatArray) -> FloatArray:
        """(N, 2, 2) that makes residuals of unit variance."""
        _, by_laser = pairs.jacobians(T_camera_lidar)
        return _whitening(by_laser, self.pixel_px, self.laser_m)


@dataclass(frozen=True, slots=True)
class PairFit:
    """A pose with the noise of its pairs. ``information``: (6, 6) of POSE_PARAMETERS."""

    T_camera_lidar: FloatArray
    residuals_px: FloatArray
    noise: PairNoise
    whitening: FloatArray
    information: FloatArray
    huber: float

    @property
    def median_px(self) -> float:
        """Median distance between a pixel and its projection."""
        return float(np.median(np.linalg.norm(self.residuals_px, axis=1)))

    def distances(self, residuals_px: FloatArray) -> FloatArray:
        """(N,) sizes of residuals of the same pairs, in standard deviations."""
        return _sizes(self.whitening, residuals_px)

    def cost(self, residuals_px: FloatArray) -> float:
        """Huber's cost of residuals of the same pairs."""
        return _huber_cost(self.distances(residuals_px), self.huber)


def fit_pairs(
    pairs: Pairs, T_start: FloatArray, huber: float, free: BoolArray | None = None
) -> PairFit:
    """Levenberg-Marquardt on SE(3) from a start; the noise is estimated between its runs.

    Errors beyond ``huber`` standard deviations count linearly. Parameters that are not ``free``
    (6,) keep the value of ``T_start``.
    """
    free = np.ones(6, dtype=np.bool_) if free is None else free
    T = T_start
    # The first scale is the median's: outliers must not set it.
    scale_px = float(np.median(np.linalg.norm(pairs.residuals_px(T), axis=1)))
    noise = PairNoise(max(scale_px, 1e-3), 0.0)
    for _ in range(_ROUNDS):
        T_before = T
        whitening = noise.whitening(pairs, T)
        T = _minimise(pairs, T_start, T, whitening, huber, free)
        noise = _estimate_noise(pairs, T, huber, int(free.sum()))
        if np.abs(pose_error(T, T_before)).max() < 1e-9:
            break
    whitening = noise.whitening(pairs, T)
    residuals_px = pairs.residuals_px(T)
    J = whitening @ pairs.jacobians(T)[0]
    weights = _weights(_sizes(whitening, residuals_px), huber)
    information = np.einsum("n,nki,nkj->ij", weights, J, J)
    return PairFit(T, residuals_px, noise, whitening, information, huber)


def _minimise(
    pairs: Pairs,
    T_start: FloatArray,
    T: FloatArray,
    whitening: FloatArray,
    huber: float,
    free: BoolArray,
) -> FloatArray:
    root = np.sqrt(_weights(_sizes(whitening, pairs.residuals_px(T)), huber))
    weighted = root[:, np.newaxis, np.newaxis] * whitening

    def evaluate(T: FloatArray) -> tuple[FloatArray, FloatArray]:
        white: FloatArray = np.einsum("nij,nj->ni", weighted, pairs.residuals_px(T))
        # Measured - projected falls as the projection moves.
        return white.ravel(), -(weighted @ pairs.jacobians(T)[0]).reshape(-1, 6)

    return minimise_pose(evaluate, T_start, T, free)


def _estimate_noise(pairs: Pairs, T: FloatArray, huber: float, parameters: int) -> PairNoise:
    """Maximum likelihood over σ_m / σ_px. For each ratio the scale is Huber's second proposal:
    sizes beyond ``huber`` count as if they were there, and of a Rayleigh distribution the mean of
    min(r², k²) is 2 (1 - exp(-k²/2))."""
    residuals_px, (_, by_laser) = pairs.residuals_px(T), pairs.jacobians(T)
    count = len(residuals_px)
    best, best_cost = PairNoise(1.0, 0.0), np.inf
    for ratio in _RATIOS:
        whitening = _whitening(by_laser, 1.0, ratio)
        sizes = _sizes(whitening, residuals_px)
        scale = max(float(np.median(sizes)), 1e-6)
        for _ in range(20):
            clipped = np.minimum(sizes, huber * scale)
            mean = (clipped**2).mean() / (2.0 * (1.0 - np.exp(-0.5 * huber**2)))
            scale = max(float(np.sqrt(mean)), 1e-6)
        log_determinants = float(-np.log(np.linalg.det(whitening)).sum())
        cost = log_determinants + 2 * count * np.log(scale) + _huber_cost(sizes / scale, huber)
        if cost < best_cost:
            # The fit has taken up its parameters' part of the noise.
            scale *= np.sqrt(2 * count / max(2 * count - parameters, 1))
            best, best_cost = PairNoise(scale, scale * float(ratio)), cost
    return best


def _whitening(by_laser: FloatArray, pixel_px: float, laser_m: float) -> FloatArray:
    covariances = pixel_px**2 * np.eye(2) + laser_m**2 * by_laser @ by_laser.transpose(0, 2, 1)
    whitening: FloatArray = np.linalg.inv(np.linalg.cholesky(covariances))
    return whitening


def _sizes(whitening: FloatArray, residuals_px: FloatArray) -> FloatArray:
    sizes: FloatArray = np.linalg.norm(np.einsum("nij,nj->ni", whitening, residuals_px), axis=1)
    return sizes


def _weights(sizes: FloatArray, huber: float) -> FloatArray:
    weights: FloatArray = np.minimum(1.0, huber / np.maximum(sizes, 1e-12))
    return weights


def _huber_cost(sizes: FloatArray, huber: float) -> float:
    linear = huber * (sizes - 0.5 * huber)
    return float(np.where(sizes <= huber, 0.5 * sizes**2, linear).sum())
