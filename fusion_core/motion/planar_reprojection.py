"""The planar motion of a LiDAR that explains best where a camera beside it sees known points.

A robot on a floor moves in three of six ways, and the camera's place on it is known: so x, y and
yaw of the LiDAR are sought at once, and height, roll and pitch cannot take up errors of the image.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.geometry import invert_transform, transform_points

_ITERATIONS = 10
_STEP_TOLERANCE = 1e-7
# Huber's constant: 95 % as good as least squares on Gaussian errors.
_HUBER = 1.345
# Median of |x| of a unit Gaussian, of one of two coordinates.
_NORMAL_MEDIAN_ABS = 0.6745
_DEPTH_MIN_M = 0.05


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanarStepEstimate:
    """``step``: (3,) x, y, yaw of the LiDAR in the frame where it saw the points. ``covariance``:
    (3, 3) of it. ``fits``: (M,) the points within three standard deviations. ``residual_px``:
    robust standard deviation of a coordinate."""

    step: FloatArray
    covariance: FloatArray
    is_inlier: BoolArray
    residual_px: float


def estimate_planar_step(
    points_in_lidar_m: FloatArray,
    observed: FloatArray,
    start: FloatArray,
    T_lidar_camera: FloatArray,
    *,
    focal_px: float,
    sigma_px: float,
    depth_sigma_per_m2: float,
) -> PlanarStepEstimate | None:
    """Gauss-Newton from ``start``, each error over what pixel and depth noise make of it.

    ``points_in_lidar_m``: (M, 3) in the LiDAR's frame of the keyframe. ``seen``: (M, 2) now, at
    1 m along the optical axis. ``depth_sigma_per_m2``: noise of a depth over its square. None where
    the points do not determine the step.
    """
    T_camera_lidar = invert_transform(T_lidar_camera)
    depth_m = transform_points(T_camera_lidar, points_in_lidar_m)[:, 2]
    rays = (points_in_lidar_m - T_lidar_camera[:3, 3]) / depth_m[:, np.newaxis]
    depth_sigma_m = depth_sigma_per_m2 * depth_m**2
    step = start.astype(np.float64).copy()
    for _ in range(_ITERATIONS):
        projected, jacobian, ahead = _project(points_in_lidar_m, step, T_camera_lidar)
        if np.count_nonzero(ahead) < 3:
            return None
        error_px = focal_px * (observed - projected)
        sigma = _depth_noise_px(
            step, T_camera_lidar, projected, points_in_lidar_m, rays, depth_sigma_m, focal_px
        )
        sigma = np.sqrt(sigma**2 + sigma_px**2)
        size = np.linalg.norm(error_px, axis=1) / sigma
        weight = np.where(ahead, np.minimum(1.0, _HUBER / np.maximum(size, 1e-12)) / sigma**2, 0.0)
        J = focal_px * jacobian
        information = np.einsum("m,mia,mib->ab", weight, J, J)
        if not np.isfinite(information).all() or np.linalg.cond(information) > 1e12:
            return None
        change = np.linalg.solve(information, np.einsum("m,mia,mi->a", weight, J, error_px))
        step += change
        if np.abs(change).max() < _STEP_TOLERANCE:
            break
    error_size = np.where(ahead, size, np.inf)
    coordinates = np.abs(error_px / sigma[:, np.newaxis])[ahead]
    scale = float(np.median(coordinates)) / _NORMAL_MEDIAN_ABS
    # Fewer errors than the noise allows are luck, not knowledge.
    return PlanarStepEstimate(
        step=step,
        covariance=np.linalg.inv(information) * max(scale, 1.0) ** 2,
        is_inlier=error_size < 3.0 * max(scale, 1.0) * np.sqrt(2.0),
        residual_px=scale * sigma_px,
    )


def _project(
    points_m: FloatArray, step: FloatArray, T_camera_lidar: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """(M, 2) where the points are seen after a step, (M, 2, 3) how that depends on the step, and
    (M,) which lie ahead."""
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


def _depth_noise_px(
    step: FloatArray,
    T_camera_lidar: FloatArray,
    projected: FloatArray,
    points_m: FloatArray,
    rays: FloatArray,
    depth_sigma_m: FloatArray,
    focal_px: float,
) -> FloatArray:
    """(M,) how far in the image a standard deviation of a point's depth moves it."""
    moved, _, _ = _project(points_m + depth_sigma_m[:, np.newaxis] * rays, step, T_camera_lidar)
    shift: FloatArray = focal_px * np.linalg.norm(moved - projected, axis=1)
    return shift
