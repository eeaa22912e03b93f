"""Planar motion from reprojection errors: x, y and yaw of the LiDAR, refined by Gauss-Newton.

A robot on a floor has three degrees of freedom and the camera's extrinsics are known, so these
three are estimated directly; height, roll and pitch cannot absorb errors of the image.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.robust import NORMAL_MEDIAN_ABS

# Gauss-Newton from a PnP start converges in three or four iterations; a safeguard.
_ITERATIONS_MAX = 10
# Metres and radians: far below a step's own uncertainty, about 1e-3.
_STEP_TOLERANCE = 1e-7
# Beyond this the normal equations keep fewer than four of a float64's sixteen digits.
_CONDITION_MAX = 1e12
# Huber 1981: 95 % efficiency on Gaussian errors.
_HUBER = 1.345
# No depth camera measures nearer; it keeps the division by z away from zero.
_DEPTH_MIN_M = 0.05
# The usual outlier bound, in standard deviations.
_INLIER_SIGMAS = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanarStepEstimate:
    """``step``: (3,) x, y, yaw of the LiDAR in its frame at the keyframe. ``covariance``: (3, 3).
    ``is_inlier``: (M,) points within three standard deviations. ``residual_px``: robust standard
    deviation of an image coordinate."""

    step: FloatArray
    covariance: FloatArray
    is_inlier: BoolArray
    residual_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FeatureNoise:
    """Noise of a feature with depth: ``sigma_px`` of its image coordinates at ``focal_px``, and
    ``depth_sigma_per_m2`` times the squared depth of its depth."""

    focal_px: float
    sigma_px: float
    depth_sigma_per_m2: float


def estimate_planar_step(
    points_in_lidar_m: FloatArray,
    observed: FloatArray,
    start: FloatArray,
    T_lidar_camera: FloatArray,
    noise: FeatureNoise,
) -> PlanarStepEstimate | None:
    """Gauss-Newton from ``start`` with Huber weights, errors in units of their standard deviation.

    ``points_in_lidar_m``: (M, 3) in the LiDAR's frame at the keyframe. ``observed``: (M, 2)
    normalised image coordinates (at 1 m along the optical axis) in the current image. None where
    the points do not determine the step.
    """
    focal_px, sigma_px = noise.focal_px, noise.sigma_px
    T_camera_lidar = invert_transform(T_lidar_camera)
    depth_m = transform_points(T_camera_lidar, points_in_lidar_m)[:, 2]
    rays = (points_in_lidar_m - T_lidar_camera[:3, 3]) / depth_m[:, np.newaxis]
    depth_sigma_m = noise.depth_sigma_per_m2 * depth_m**2
    displaced_m = points_in_lidar_m + depth_sigma_m[:, np.newaxis] * rays
    step = start.astype(np.float64).copy()
    for _ in range(_ITERATIONS_MAX):
        projected, jacobian, ahead = _project(points_in_lidar_m, step, T_camera_lidar)
        if np.count_nonzero(ahead) < 3:
            return None
        error_px = focal_px * (observed - projected)
        displaced, _, _ = _project(displaced_m, step, T_camera_lidar)
        sigma = focal_px * np.linalg.norm(displaced - projected, axis=1)
        sigma = np.sqrt(sigma**2 + sigma_px**2)
        size = np.linalg.norm(error_px, axis=1) / sigma
        weight = np.where(ahead, np.minimum(1.0, _HUBER / np.maximum(size, 1e-12)) / sigma**2, 0.0)
        J = focal_px * jacobian
        information = np.einsum("m,mia,mib->ab", weight, J, J)
        if not np.isfinite(information).all() or np.linalg.cond(information) > _CONDITION_MAX:
            return None
        change = np.linalg.solve(information, np.einsum("m,mia,mi->a", weight, J, error_px))
        step += change
        if np.abs(change).max() < _STEP_TOLERANCE:
            break
    error_size = np.where(ahead, size, np.inf)
    coordinates = np.abs(error_px / sigma[:, np.newaxis])[ahead]
    scale = float(np.median(coordinates)) / NORMAL_MEDIAN_ABS
    # Residuals below the noise model do not make the covariance smaller than the model's.
    return PlanarStepEstimate(
        step=step,
        covariance=np.linalg.inv(information) * max(scale, 1.0) ** 2,
        is_inlier=error_size < _INLIER_SIGMAS * max(scale, 1.0) * np.sqrt(2.0),
        residual_px=scale * sigma_px,
    )


def _project(
    points_m: FloatArray, step: FloatArray, T_camera_lidar: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(M, 2) normalised image coordinates after a step, (M, 2, 3) their Jacobian by the step, and
    (M,) which points lie in front of the camera."""
    c, s = np.cos(step[2]), np.sin(step[2])
    away = points_m - np.array([step[0], step[1], 0.0])
    now = np.stack([c * away[:, 0] + s * away[:, 1], c * away[:, 1] - s * away[:, 0]], axis=1)
    by_step = np.zeros((len(points_m), 3, 3))
    by_step[:, 0, 0], by_step[:, 0, 1], by_step[:, 0, 2] = -c, -s, now[:, 1]
    by_step[:, 1, 0], by_step[:, 1, 1], by_step[:, 1, 2] = s, -c, -now[:, 0]
    in_camera = transform_points(T_camera_lidar, np.column_stack([now, points_m[:, 2]]))
    ahead = in_camera[:, 2] > _DEPTH_MIN_M
    z = np.where(ahead, in_camera[:, 2], 1.0)
    projected = in_camera[:, :2] / z[:, np.newaxis]
    by_point = np.zeros((len(points_m), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1.0 / z
    by_point[:, :, 2] = -projected / z[:, np.newaxis]
    return projected, by_point @ T_camera_lidar[:3, :3] @ by_step, ahead
