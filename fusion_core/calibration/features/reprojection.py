"""Estimation of the pose with reprojection filtering (Song 2022 §2.2.2, eq. 18; Fig. 11), and what
pairs that were held out say about it."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.calibration.features.dlt import DLT_PAIRS_MIN, solve_pose
from fusion_core.calibration.features.pose_fit import (
    PoseFit,
    fit_pose,
    pose_jacobian,
    pose_without_start,
    reprojection_residuals,
)
from fusion_core.calibration.pose_error import pose_error
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.seeds import SEED_MAX
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting

# The length of an isotropic error is Rayleigh distributed: its median over one axis's deviation.
_RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))
# Exact pairs leave rounding alone.
_SIGMA_FLOOR_PX = 0.02
_ROUNDS_MAX = 20
_CURVE_POINTS = 16
_BLOCKS = (6, 8)


class ReprojectionSettings(StageSettings):
    """Settings of ``estimate_pose`` and of its evidence."""

    solver: Literal["refined", "dlt"] = setting(
        "refined", "The pose by robust least squares on SE(3), or by DLT alone"
    )
    filter_by: Literal["sigma", "threshold"] = setting(
        "sigma", "Greatest residual of a used pair: in robust deviations, or in pixels"
    )
    filter_sigma: float = setting(
        4.0, "Pairs with a longer residual are not used", unit="robust deviations", ge=1.0, le=100.0
    )
    filter_px: float = setting(
        5.0, "Pairs with a longer residual are not used", unit="px", ge=0.1, le=1000.0
    )
    pairs_min: int = setting(12, "Fewest pairs that are left", ge=6, le=10_000)
    rms_max_px: float = setting(
        50.0, "Greatest reprojection error of held-out pairs", unit="px", ge=0.1, le=10_000.0
    )
    folds: int = setting(5, "Parts that are held out in turn", ge=2, le=20)
    seed: int = setting(0, "Seed of the order in Fig. 11's curve", ge=0, le=SEED_MAX)


PUBLISHED = ReprojectionSettings(solver="dlt", filter_by="threshold", pairs_min=DLT_PAIRS_MIN)
"""The paper names no threshold: 5 px, about twice its result, is ours."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FilteredPose:
    """``fit`` of the ``used`` (N,) pairs, which are those whose residual passes ``threshold_px``;
    the used pairs' order is that of the given ones."""

    fit: PoseFit
    used: BoolArray
    threshold_px: float

    def __post_init__(self) -> None:
        read_only(self.used)


def estimate_pose(
    points_m: FloatArray,
    pixels: FloatArray,
    intrinsics: CameraIntrinsics,
    T_start: FloatArray | None,
    settings: ReprojectionSettings,
) -> FilteredPose:
    """Estimate, drop the pairs with a long residual, and repeat until no pair changes sides.

    ``T_start`` need not be given. Raises CalibrationFailed where too few pairs are left, and of DLT
    where they lie in one plane.
    """
    used = np.ones(len(points_m), dtype=np.bool_)
    fit, threshold_px = None, np.inf
    for _ in range(_ROUNDS_MAX):
        _require_enough(points_m[used], len(points_m), settings)
        T = T_start if fit is None else fit.T_camera_lidar
        fit = _fit(points_m[used], pixels[used], intrinsics, T, settings, is_first=bool(used.all()))
        length = np.linalg.norm(
            reprojection_residuals(fit.T_projection, points_m, pixels, intrinsics), axis=1
        )
        threshold_px = settings.filter_px
        if settings.filter_by == "sigma":
            sigma_px = max(float(np.median(length[used])) / _RAYLEIGH_MEDIAN, _SIGMA_FLOOR_PX)
            threshold_px = settings.filter_sigma * sigma_px
        elif np.count_nonzero(length <= threshold_px) < settings.pairs_min:
            # The first estimate, with mismatches in it, may leave no pair below the threshold:
            # the better half is kept until one does.
            threshold_px = float(np.median(length[used]))
        now = length <= threshold_px
        if np.array_equal(now, used):
            break
        used = now
    _require_enough(points_m[used], len(points_m), settings)
    assert fit is not None, "there is at least one round"
    fit = _fit(
        points_m[used], pixels[used], intrinsics, fit.T_camera_lidar, settings, is_first=False
    )
    return FilteredPose(fit=fit, used=used, threshold_px=float(threshold_px))


def _require_enough(points_m: FloatArray, given: int, settings: ReprojectionSettings) -> None:
    if len(points_m) < settings.pairs_min:
        raise CalibrationFailed(
            f"only {len(points_m)} of {given} pairs of a point and a pixel agree with one pose; "
            f"at least {settings.pairs_min} are needed.",
            advice="Use a scene with more texture, a denser cloud, or give --guess.",
        )


def _fit(
    points_m: FloatArray,
    pixels: FloatArray,
    intrinsics: CameraIntrinsics,
    T_start: FloatArray | None,
    settings: ReprojectionSettings,
    *,
    is_first: bool,
) -> PoseFit:
    if settings.solver == "dlt":
        T, T_projection = solve_pose(points_m, pixels, intrinsics)
        return PoseFit(
            T_camera_lidar=T,
            T_projection=T_projection,
            jacobian=pose_jacobian(T, points_m, pixels, intrinsics),
            residuals_px=reprojection_residuals(T_projection, points_m, pixels, intrinsics),
        )
    if T_start is None:
        T_start = pose_without_start(points_m, pixels, intrinsics)
    scale_px = None
    if is_first or settings.filter_by == "sigma":
        length = np.linalg.norm(
            reprojection_residuals(T_start, points_m, pixels, intrinsics), axis=1
        )
        scale_px = max(float(np.median(length)) / _RAYLEIGH_MEDIAN, _SIGMA_FLOOR_PX)
    return fit_pose(points_m, pixels, intrinsics, T_start, scale_px=scale_px)


def image_blocks(pixels: FloatArray, intrinsics: CameraIntrinsics) -> IntArray:
    """(N,) which of 6 x 8 parts of the image each pixel lies in: pairs of one part share their
    errors, since their patches overlap and their points lie on one surface."""
    rows, columns = _BLOCKS
    row = np.clip((pixels[:, 1] + 0.5) / intrinsics.height * rows, 0, rows - 1).astype(np.int64)
    column = np.clip((pixels[:, 0] + 0.5) / intrinsics.width * columns, 0, columns - 1)
    return row * columns + column.astype(np.int64)


def held_out_residuals(
    points_m: FloatArray,
    pixels: FloatArray,
    intrinsics: CameraIntrinsics,
    T_start: FloatArray,
    settings: ReprojectionSettings,
) -> FloatArray:
    """(N, 2) residuals (18) of each pair by the estimate of pairs in other parts of the image.

    All given pairs are judged, also those that the filter of the whole estimate leaves out. NaN
    where the other pairs do not determine a pose.
    """
    residuals = np.full((len(points_m), 2), np.nan)
    blocks = image_blocks(pixels, intrinsics)
    names = np.unique(blocks)
    # Every folds-th occupied part: the rest still covers the image.
    fold = np.arange(names.size) % settings.folds
    for k in range(settings.folds):
        out = np.isin(blocks, names[fold == k])
        if not out.any():
            continue
        try:
            kept = estimate_pose(points_m[~out], pixels[~out], intrinsics, T_start, settings)
        except CalibrationFailed:
            continue
        residuals[out] = reprojection_residuals(
            kept.fit.T_projection, points_m[out], pixels[out], intrinsics
        )
    return residuals


def _jackknife_covariance(
    points_m: FloatArray, pixels: FloatArray, blocks: IntArray, intrinsics: CameraIntrinsics
) -> FloatArray:
    """(6, 6) of a pose by DLT, from how it moves when one part of the image is left out."""
    names = np.unique(blocks)
    whole, _ = solve_pose(points_m, pixels, intrinsics)
    moved = []
    for name in names:
        rest = blocks != name
        T, _ = solve_pose(points_m[rest], pixels[rest], intrinsics)
        moved.append(pose_error(T, whole))
    away = np.array(moved) - np.mean(moved, axis=0)
    covariance: FloatArray = (names.size - 1) / names.size * away.T @ away
    return covariance


def covariance_of(
    filtered: FilteredPose,
    points_m: FloatArray,
    pixels: FloatArray,
    held_out_px: FloatArray,
    intrinsics: CameraIntrinsics,
    settings: ReprojectionSettings,
) -> tuple[FloatArray, str]:
    """(6, 6) covariance of POSE_PARAMETERS, and a sentence about it.

    ``points_m``, ``pixels``, ``held_out_px``: of all given pairs. Raises CalibrationFailed where
    DLT has no result without one part of the image.
    """
    used = filtered.used
    blocks = image_blocks(pixels[used], intrinsics)
    if settings.solver == "dlt":
        covariance = _jackknife_covariance(points_m[used], pixels[used], blocks, intrinsics)
        return (
            covariance,
            "The covariance is that of leaving out one part of the image after another.",
        )
    covariance, factor = pose_covariance(filtered.fit, held_out_px[used], blocks)
    return covariance, (
        f"Errors of neighbouring pairs are correlated: the covariance is {factor:.1f} times that "
        "of independent ones."
    )


def pose_covariance(
    fit: PoseFit, residuals_px: FloatArray, blocks: IntArray
) -> tuple[FloatArray, float]:
    """(6, 6) covariance of POSE_PARAMETERS, and the factor that correlation adds to it.

    ``residuals_px``: (n, 2) of the n used pairs, by estimates that have not seen them. With A the
    normal matrix of unit weights, σ² A⁻¹ would hold for independent errors. Those of one part of
    the image move together: the sums of their gradients over each part vary more than that says,
    on average over the six directions by the factor, which is at least 1. One number is well
    determined by some tens of parts; a whole matrix is not. The intrinsics are taken as exact.
    """
    J = fit.jacobian
    known = np.isfinite(residuals_px).all(axis=1)
    count = int(np.count_nonzero(known))
    A = np.einsum("nki,nkj->ij", J, J)
    sigma2 = float((residuals_px[known] ** 2).sum()) / max(1, 2 * count - 6)
    independent = sigma2 * np.linalg.inv(A)
    gradients = np.einsum("nki,nk->ni", J[known], residuals_px[known])
    names, inverse = np.unique(blocks[known], return_inverse=True)
    sums = np.zeros((names.size, 6))
    np.add.at(sums, inverse, gradients)
    B = sums.T @ sums * names.size / max(1, names.size - 1)
    factor = max(1.0, float(np.trace(np.linalg.solve(A, B))) / (6.0 * sigma2))
    return independent * factor, factor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReprojectionCurve:
    """Fig. 11: (m,) numbers of pairs that a pose is estimated from, and the reprojection error (18)
    of all pairs by it: ``unfiltered_px`` as the pairs come, ``filtered_px`` of the pairs that the
    filter keeps, NaN where it has no result."""

    pairs: IntArray
    unfiltered_px: FloatArray
    filtered_px: FloatArray

    def __post_init__(self) -> None:
        for array in (self.pairs, self.unfiltered_px, self.filtered_px):
            read_only(array)


def reprojection_curve(
    points_m: FloatArray,
    pixels: FloatArray,
    intrinsics: CameraIntrinsics,
    T_start: FloatArray,
    used: BoolArray,
    settings: ReprojectionSettings,
) -> ReprojectionCurve:
    """The first n of the pairs in a random order, then the first n of the ``used`` ones."""
    order = np.random.default_rng(settings.seed).permutation(len(points_m))
    kept = order[used[order]]
    least = DLT_PAIRS_MIN + 2
    counts = np.unique(np.geomspace(least, max(least, len(order)), _CURVE_POINTS).astype(np.int64))
    curves = []
    for pairs in (order, kept):
        curve = np.full(counts.size, np.nan)
        for i, count in enumerate(counts):
            if count > len(pairs):
                continue
            some = pairs[:count]
            try:
                if settings.solver == "dlt":
                    _, T = solve_pose(points_m[some], pixels[some], intrinsics)
                else:
                    T = fit_pose(
                        points_m[some], pixels[some], intrinsics, T_start, scale_px=None
                    ).T_camera_lidar
            except CalibrationFailed:
                continue
            curve[i] = reprojection_rms(
                reprojection_residuals(T, points_m[pairs], pixels[pairs], intrinsics)
            )
        curves.append(curve)
    return ReprojectionCurve(pairs=counts, unfiltered_px=curves[0], filtered_px=curves[1])
