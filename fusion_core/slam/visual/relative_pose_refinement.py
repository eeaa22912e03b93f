"""The pose between two views by features with depth, weighted by what each measurement is worth.

A feature measures u, v and, where its depth is known, 1/z: a structured-light camera's depth has a
standard deviation that grows with the square of the depth (Khoshelham & Elberink 2012), which is
one and the same for the inverse depth.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.geometry import invert_transform, make_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.slam.visual.observation_noise import CHI2_DEPTH, CHI2_PIXEL
from fusion_core.slam.visual.pinhole import camera_parameters, unproject

# Where a row of a match is not measured: it has no weight. Pixels squared and 1/m².
_UNMEASURED_VARIANCE = 1e12
# Huber's threshold in standard deviations; the usual 1.345 of one residual, for three.
_HUBER = 2.5
_ROUNDS = 3
_STEPS = 4
# A step below so many of the pose's standard deviations changes nothing.
_STEP_MIN = 1e-3
_DEPTH_MIN_M = 0.05
_INLIERS_MIN = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredFeatures:
    """Matched features of one view.

    ``pixels``: (M, 2). ``depths_m``: (M,), NaN where missing. ``sigmas_px``: (M,).
    ``inverse_depth_sigma``: in 1/m.
    """

    pixels: FloatArray
    depths_m: FloatArray
    sigmas_px: FloatArray
    inverse_depth_sigma: float

    def __post_init__(self) -> None:
        for array in (self.pixels, self.depths_m, self.sigmas_px):
            read_only(array)

    def points_m(self, intrinsics: CameraIntrinsics) -> FloatArray:
        """(M, 3) in the view's optical frame, NaN without depth."""
        return unproject(self.pixels, self.depths_m, camera_parameters(intrinsics))

    def point_covariances(self, intrinsics: CameraIntrinsics) -> FloatArray:
        """(M, 3, 3) of ``points_m``."""
        z = self.depths_m
        # Columns: by u, by v, by 1/z.
        jacobian = np.zeros((len(z), 3, 3))
        jacobian[:, 0, 0] = z / intrinsics.fx * self.sigmas_px
        jacobian[:, 1, 1] = z / intrinsics.fy * self.sigmas_px
        along = -self.points_m(intrinsics) * z[:, np.newaxis]
        jacobian[:, :, 2] = along * self.inverse_depth_sigma
        return jacobian @ jacobian.transpose(0, 2, 1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RefinedPose:
    """``T_first_second``: (4, 4). ``covariance``: (6, 6) of a small motion of the second view in
    its own frame, rotation first. ``is_inlier``: (M,). ``chi2_per_degree``: of the inliers."""

    T_first_second: FloatArray
    covariance: FloatArray
    is_inlier: BoolArray
    chi2_per_degree: float


def refine_relative_pose(
    first: MeasuredFeatures,
    second: MeasuredFeatures,
    intrinsics: CameraIntrinsics,
    T_first_second: FloatArray,
) -> RefinedPose | None:
    """Gauss-Newton on the Mahalanobis distances of (M,) matches, outliers left out.

    A match is measured from the view that knows its depth: by its point into the other. None where
    too few agree or they do not determine the pose.
    """
    T = T_first_second
    chi2, degrees = _mahalanobis(first, second, intrinsics, T)
    is_inlier = chi2 < 4.0 * _limits(degrees)
    for _ in range(_ROUNDS):
        for _ in range(_STEPS):
            step = _gauss_newton(first, second, intrinsics, T, is_inlier)
            if step is None:
                return None
            T = T @ small_motion(step[0])
            if step[0] @ step[1] @ step[0] < _STEP_MIN**2:
                break
        chi2, degrees = _mahalanobis(first, second, intrinsics, T)
        is_inlier = chi2 < _limits(degrees)
    step = _gauss_newton(first, second, intrinsics, T, is_inlier)
    if step is None:
        return None
    free = max(int(degrees[is_inlier].sum()) - 6, 1)
    per_degree = float(chi2[is_inlier].sum()) / free
    return RefinedPose(
        T_first_second=T,
        # A fit worse than the stated noise has a larger covariance, a better one no smaller.
        covariance=np.asarray(np.linalg.inv(step[1]) * max(per_degree, 1.0), np.float64),
        is_inlier=is_inlier,
        chi2_per_degree=per_degree,
    )


def small_motion(twist: FloatArray) -> FloatArray:
    """(4, 4) of (6,) rotation vector and translation."""
    from scipy.spatial.transform import Rotation

    return make_transform(Rotation.from_rotvec(twist[:3]).as_matrix(), twist[3:])


def _limits(degrees: FloatArray) -> FloatArray:
    # Without a degree of freedom a match is no inlier: its chi-square is infinite.
    return np.where(degrees >= 3, CHI2_DEPTH, CHI2_PIXEL)


def _mahalanobis(
    first: MeasuredFeatures,
    second: MeasuredFeatures,
    intrinsics: CameraIntrinsics,
    T_first_second: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """(M,) squared distances and (M,) degrees of freedom; infinite where no depth is known."""
    whitened, _, degrees = _whitened_rows(first, second, intrinsics, T_first_second)
    chi2 = np.einsum("mi,mi->m", whitened, whitened)
    return np.where(degrees > 0, chi2, np.inf), degrees


def _gauss_newton(
    first: MeasuredFeatures,
    second: MeasuredFeatures,
    intrinsics: CameraIntrinsics,
    T_first_second: FloatArray,
    is_inlier: BoolArray,
) -> tuple[FloatArray, FloatArray] | None:
    """The next step, (6,), and the information (6, 6) of the pose; None where singular."""
    if np.count_nonzero(is_inlier) < _INLIERS_MIN:
        return None
    whitened, jacobian, _ = _whitened_rows(first, second, intrinsics, T_first_second)
    size = np.linalg.norm(whitened, axis=1)
    # NaN never weighs: of what lies behind the camera.
    weight = np.where(is_inlier, _HUBER / np.maximum(size, _HUBER), 0.0)
    used = np.flatnonzero(weight > 0.0)
    J, r = jacobian[used].reshape(-1, 6), whitened[used].reshape(-1)
    weighted = J * np.repeat(weight[used], 3)[:, np.newaxis]
    information, gradient = weighted.T @ J, weighted.T @ r
    try:
        step = -np.linalg.solve(information, gradient)
    except np.linalg.LinAlgError:
        return None
    return (step, information) if np.isfinite(step).all() else None


def _whitened_rows(
    first: MeasuredFeatures,
    second: MeasuredFeatures,
    intrinsics: CameraIntrinsics,
    T_first_second: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(M, 3) residuals, (M, 3, 6) their derivatives by a motion of the second, (M,) degrees of
    freedom: three where both depths are known, two with one, none without."""
    count = len(first.pixels)
    residuals, jacobians, degrees = np.zeros((count, 3)), np.zeros((count, 3, 6)), np.zeros(count)
    R = T_first_second[:3, :3]
    has_first = np.isfinite(first.depths_m)
    has_second_alone = ~has_first & np.isfinite(second.depths_m)
    T_second_first = invert_transform(T_first_second)
    for rows, source, target, T_target_source in (
        (np.flatnonzero(has_first), first, second, T_second_first),
        (np.flatnonzero(has_second_alone), second, first, T_first_second),
    ):
        if rows.size == 0:
            continue
        points = transform_points(T_target_source, source.points_m(intrinsics)[rows])
        by_motion = np.zeros((rows.size, 3, 6))
        if source is first:
            # X = Exp(-ξ) T_second_first X_first: -ω × X - v.
            by_motion[:, :, :3] = _skew(points)
            by_motion[:, :, 3:] = -np.eye(3)
        else:
            # X = T_first_second Exp(ξ) X_second: R (ω × X_second + v).
            by_motion[:, :, :3] = -R @ _skew(source.points_m(intrinsics)[rows])
            by_motion[:, :, 3:] = R
        found = _residuals(
            points,
            T_target_source[:3, :3]
            @ source.point_covariances(intrinsics)[rows]
            @ T_target_source[:3, :3].T,
            target,
            rows,
            intrinsics,
        )
        residuals[rows], by_point, degrees[rows] = found
        jacobians[rows] = by_point @ by_motion
    return residuals, jacobians, degrees


def _residuals(
    points_m: FloatArray,
    covariances: FloatArray,
    target: MeasuredFeatures,
    rows: IntArray,
    intrinsics: CameraIntrinsics,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened (N, 3) residuals of u, v, 1/z, (N, 3, 3) derivatives by the point, (N,) degrees."""
    x, y, z = points_m.T
    is_ahead = z > _DEPTH_MIN_M
    z = np.where(is_ahead, z, 1.0)
    measured_depth_m = target.depths_m[rows]
    has_depth = np.isfinite(measured_depth_m)
    by_point = np.zeros((len(z), 3, 3))
    by_point[:, 0, 0] = intrinsics.fx / z
    by_point[:, 0, 2] = -intrinsics.fx * x / z**2
    by_point[:, 1, 1] = intrinsics.fy / z
    by_point[:, 1, 2] = -intrinsics.fy * y / z**2
    by_point[:, 2, 2] = -1.0 / z**2
    residual = np.column_stack(
        [
            intrinsics.fx * x / z + intrinsics.cx - target.pixels[rows, 0],
            intrinsics.fy * y / z + intrinsics.cy - target.pixels[rows, 1],
            np.where(has_depth, 1.0 / z - 1.0 / measured_depth_m, 0.0),
        ]
    )
    covariance = by_point @ covariances @ by_point.transpose(0, 2, 1)
    pixel_variance = target.sigmas_px[rows] ** 2
    covariance[:, 0, 0] += pixel_variance
    covariance[:, 1, 1] += pixel_variance
    covariance[:, 2, 2] += target.inverse_depth_sigma**2
    covariance[~has_depth, 2, :] = covariance[~has_depth, :, 2] = 0.0
    covariance[~has_depth, 2, 2] = _UNMEASURED_VARIANCE
    white = _whiten(covariance, np.concatenate([residual[:, :, np.newaxis], by_point], axis=2))
    whitened, by_point = white[:, :, 0], white[:, :, 1:]
    # What is behind the camera cannot be seen: no inlier, and without a derivative.
    whitened[~is_ahead] = np.inf
    return whitened, by_point, np.where(is_ahead, np.where(has_depth, 3.0, 2.0), 0.0)


def _whiten(covariances: FloatArray, columns: FloatArray) -> FloatArray:
    """(N, 3, C) columns, each divided by the Cholesky root of its covariance, (N, 3, 3).

    Written out, since numpy calls LAPACK for each small matrix.
    """
    c = covariances
    l00 = np.sqrt(c[:, 0, 0])
    l10, l20 = c[:, 1, 0] / l00, c[:, 2, 0] / l00
    l11 = np.sqrt(c[:, 1, 1] - l10 * l10)
    l21 = (c[:, 2, 1] - l20 * l10) / l11
    l22 = np.sqrt(c[:, 2, 2] - l20 * l20 - l21 * l21)
    white = np.empty_like(columns)
    white[:, 0] = columns[:, 0] / l00[:, np.newaxis]
    white[:, 1] = (columns[:, 1] - l10[:, np.newaxis] * white[:, 0]) / l11[:, np.newaxis]
    white[:, 2] = (
        columns[:, 2] - l20[:, np.newaxis] * white[:, 0] - l21[:, np.newaxis] * white[:, 1]
    ) / l22[:, np.newaxis]
    return white


def _skew(vectors: FloatArray) -> FloatArray:
    """(N, 3, 3) matrices of the cross product with (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros(len(x))
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
