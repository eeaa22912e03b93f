"""Xu 2024 §2.3.1: the transform A between a LiDAR curve and a depth row, by random sample
consensus.

The paper's symbols, and what they are here:

====  ==============================================================================
L̂     ``lidar_points_m``: W points (x, z) of the LiDAR curve behind the offset u
D     ``depth_points_m``: W points (x, z) of the depth row v
A     ``Registration.A``: (3, 3), row vectors, ``L̂ A = D`` (5); ``A_inverse`` is for (7)
n     ``sample_size``: pairs in a draw
α, β  numbers of good pairs and of noise pairs, W = α + β: ``inliers`` separates them
c     inlier ratio, α / (α + β)
E     ``mean_error_m``: mean ``||L̂ A - D||`` over the pairs valid on both sides (§3.2.2)
ε     the threshold of (6) on ``residual_m``: denoising applies it, after the fact.
      ``inlier_threshold_m`` is another one, needed to find A at all; the paper does not name it
====  ==============================================================================

A draw of n pairs is clean with the probability cⁿ, so N = ln(1 - p) / ln(1 - cⁿ) draws hold a
clean one with the confidence p. The paper's 4 / cⁿ is the rule for p = 1 - e⁻⁴ = 98.2 %, not for
its 97.5 %: with c = 0.6 and n = 6 that is 84 to 86 draws, and 97.5 % needs 78.

Eq. (5) as printed is affine. On a plain wall or in a corridor an affine transform is nearly
undetermined and its inverse sends repairs metres away, so the default takes the simplest of four
models that explains the pairs and rejects a transform that stretches or mirrors. ``PUBLISHED`` is
the paper: affine, 84 draws of 6, rejected only where A has no inverse.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import model_validator

from fusion_core.model.conventions import BoolArray, FloatArray, read_only
from fusion_core.model.errors import RegistrationFailed
from fusion_core.model.seeds import SEED_MAX
from fusion_core.registration.draws import (
    Draws,
    count_draws_needed,
    draw_samples,
    evaluate_samples,
    find_valid_pairs,
)
from fusion_core.registration.models import (
    MINIMAL_PAIRS,
    MODELS,
    PARAMETERS,
    SINGULAR_CONDITION,
    TransformFit,
    TransformModel,
    apply_transform,
    fit_transform,
    point_covariance,
    point_jacobian,
    residuals,
)
from fusion_core.settings import StageSettings, setting

# The length of an isotropic planar error is Rayleigh distributed: its median over the standard
# deviation of one axis.
_RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))

# 1 µm: residuals of exact pairs are rounding and cannot distinguish models.
_SIGMA_FLOOR_M = 1e-6

# Kass and Raftery 1995: above it the evidence for the richer model is very strong.
_GRIC_MARGIN = 10.0


class RegistrationSettings(StageSettings):
    """Settings of ``register``."""

    model: Literal["auto", "rigid", "similarity", "affine", "homography"] = setting(
        "auto", "Model of the transform A; auto: the simplest that explains the pairs"
    )
    sample_size: int = setting(6, "Pairs in a draw (n)", unit="pairs", ge=2, le=50)
    stopping: Literal["fixed", "adaptive"] = setting(
        "adaptive", "Stop after a fixed number of draws, or at the confidence of a clean one"
    )
    draws: int = setting(84, "Draws, or the size of a block where adaptive", ge=1, le=10_000)
    confidence: float = setting(
        0.99, "Probability of a clean draw at which adaptive drawing stops", ge=0.5, le=0.9999
    )
    # Each takes some 10 µs, and a frame that is shown must not take much more than a second.
    draws_max: int = setting(1_000, "Draws at which adaptive drawing gives up", ge=1, le=20_000)
    inlier_threshold_m: float = setting(
        0.10, "Greatest residual of a pair that supports A", unit="m", ge=1e-6, le=2.0
    )
    refits_max: int = setting(
        10, "Most least-squares refits until the inliers no longer change", ge=1, le=100
    )
    seed: int = setting(0, "Seed of the draws", ge=0, le=SEED_MAX)
    guards: bool = setting(True, "Reject transforms that are ill-conditioned, mirror or stretch")
    inliers_min: int = setting(12, "Guard: fewest inliers", unit="pairs", ge=2, le=10_000)
    condition_max: float = setting(
        30.0, "Guard: greatest condition number of the normalised design matrix", gt=1.0, le=1e6
    )
    scale_min: float = setting(0.8, "Guard: least local scale of the transform", ge=1e-6, le=1.0)
    scale_max: float = setting(
        1.25, "Guard: greatest local scale of the transform", ge=1.0, le=100.0
    )
    anisotropy_max: float = setting(
        1.25, "Guard: greatest ratio of the two local scales", ge=1.0, le=100.0
    )

    @model_validator(mode="after")
    def _sample_determines_model(self) -> "RegistrationSettings":
        models = MODELS if self.model == "auto" else (self.model,)
        needed = max(MINIMAL_PAIRS[model] for model in models)
        if self.sample_size < needed:
            raise ValueError(f"sample_size must be at least {needed} for the model {self.model}")
        return self


PUBLISHED = RegistrationSettings(
    model="affine", sample_size=6, stopping="fixed", draws=84, guards=False
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RejectedModel:
    """A model that was rejected, and why."""

    model: TransformModel
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Registration:
    """The transform A of one frame's pairs and its quality.

    ``A``, ``A_inverse``: (3, 3), row vectors, metres. ``inliers``: (m,), the pairs that A was
    fitted to. ``residual_m``: (m,) ``||L̂ A - D||``, NaN where either side is missing.
    ``mean_error_m``: E over all valid pairs, infinite where one of them has no image. ``sigma_m``:
    robust standard deviation of one axis: the median residual of the inliers over 1.1774, as the
    length of an isotropic planar error is Rayleigh distributed. ``covariance``: (9, 9) of A's
    entries row by row, for pairs with independent isotropic errors of ``sigma_m``; neighbouring
    samples that share an error make it too small. ``condition``: of the normalised design matrix.
    ``valid``: pairs valid on both sides. ``best_draw``: index of the draw whose inliers were first
    refitted; ``has_converged``: the last of the ``refits`` changed no inlier. ``rejected``: models
    that were tried and rejected.
    """

    model: TransformModel
    A: FloatArray
    A_inverse: FloatArray
    inliers: BoolArray
    residual_m: FloatArray
    mean_error_m: float
    sigma_m: float
    covariance: FloatArray
    condition: float
    valid: int
    draws: Draws
    best_draw: int
    refits: int
    has_converged: bool
    seed: int
    rejected: tuple[RejectedModel, ...]

    def __post_init__(self) -> None:
        for array in (self.A, self.A_inverse, self.inliers, self.residual_m, self.covariance):
            read_only(array)

    def predict(self, lidar_points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Eq. (8), ``D = L̂ A``: (k, 2) images and (k,) root mean square length of their error.

        The error is that of the fit alone, without the point's own noise. NaN for a missing point
        and for one beyond the horizon of a homography.
        """
        spread = point_covariance(self.A, self.covariance, lidar_points_m)
        return apply_transform(self.A, lidar_points_m), np.sqrt(np.trace(spread, axis1=1, axis2=2))

    def predict_inverse(self, depth_points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Eq. (7), ``L̂ = D A⁻¹``: as ``predict``, in the other direction."""
        points_m = apply_transform(self.A_inverse, depth_points_m)
        spread = point_covariance(self.A, self.covariance, points_m)
        back = point_jacobian(self.A_inverse, depth_points_m)
        spread = back.swapaxes(1, 2) @ spread @ back
        return points_m, np.sqrt(np.trace(spread, axis1=1, axis2=2))


def register(
    lidar_points_m: FloatArray, depth_points_m: FloatArray, settings: RegistrationSettings
) -> Registration:
    """Find A with ``L̂ A = D`` (eq. 5) from paired points, (m, 2) twice, NaN where missing.

    Raises RegistrationFailed where too few pairs are valid or every model is rejected.
    """
    lidar_points_m = np.array(lidar_points_m, dtype=np.float64)
    depth_points_m = np.array(depth_points_m, dtype=np.float64)
    if lidar_points_m.shape != depth_points_m.shape or lidar_points_m.shape[1:] != (2,):
        raise ValueError(f"pairs must be (m, 2), got {lidar_points_m.shape, depth_points_m.shape}")
    valid = find_valid_pairs(lidar_points_m, depth_points_m)
    count = int(valid.sum())
    needed = max(settings.sample_size, settings.inliers_min if settings.guards else 0)
    if count < needed:
        raise RegistrationFailed(
            f"{count} of {valid.size} pairs are valid on both sides; {needed} are needed.",
            advice="Widen the overlap of curve and row, or lower inliers_min or sample_size.",
        )

    lidar, depth = lidar_points_m[valid], depth_points_m[valid]
    models = MODELS if settings.model == "auto" else (settings.model,)
    candidates: list[_Candidate] = []
    rejected: list[RejectedModel] = []
    for model in models:
        found = _fit_candidate(model, lidar, depth, settings)
        if isinstance(found, RejectedModel):
            rejected.append(found)
        else:
            candidates.append(found)
    if not candidates:
        reasons = "; ".join(f"{refusal.model}: {refusal.reason}" for refusal in rejected)
        raise RegistrationFailed(
            f"no transform fits the {count} valid of {valid.size} pairs ({reasons}).",
            advice="Check (u, v) of the alignment, or try another model or inlier_threshold_m.",
        )
    best = candidates[_select_by_gric(candidates, settings.inlier_threshold_m)]

    inliers = np.zeros(valid.size, dtype=np.bool_)
    inliers[valid] = best.inliers
    residual_m = np.full(valid.size, np.nan)
    residual_m[valid] = best.residual_m
    has_image = np.isfinite(best.residual_m).all()
    return Registration(
        model=best.model,
        A=best.fit.A,
        A_inverse=np.linalg.inv(best.fit.A).astype(np.float64, copy=False),
        inliers=inliers,
        residual_m=residual_m,
        mean_error_m=float(best.residual_m.mean()) if has_image else np.inf,
        sigma_m=best.sigma_m,
        covariance=best.fit.unit_covariance * best.sigma_m**2,
        condition=best.fit.condition,
        valid=count,
        draws=Draws(
            model=best.model,
            count=best.draws,
            block_size=settings.draws,
            sample_size=settings.sample_size,
            inlier_threshold_m=settings.inlier_threshold_m,
            seed=settings.seed,
            lidar_points_m=lidar_points_m,
            depth_points_m=depth_points_m,
        ),
        best_draw=best.best_draw,
        refits=best.refits,
        has_converged=best.has_converged,
        seed=settings.seed,
        rejected=tuple(rejected),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Candidate:
    """One model's transform over the valid pairs alone."""

    model: TransformModel
    fit: TransformFit
    inliers: BoolArray
    residual_m: FloatArray
    sigma_m: float
    draws: int
    best_draw: int
    refits: int
    has_converged: bool


def _fit_candidate(
    model: TransformModel, lidar_m: FloatArray, depth_m: FloatArray, settings: RegistrationSettings
) -> _Candidate | RejectedModel:
    """The best draw of one model, refitted until its inliers converge, unless a guard rejects
    it."""
    inliers, best_draw, draws = _find_consensus(model, lidar_m, depth_m, settings)
    # One pair more than the model needs, or no residual is left to judge it by.
    needed = max(settings.sample_size, MINIMAL_PAIRS[model] + 1)
    if settings.guards:
        needed = max(needed, settings.inliers_min)
    refits = 0
    has_converged = False
    while True:
        count = int(inliers.sum())
        if count < needed:
            reason = f"{count} of {inliers.size} valid pairs agree, {needed} are needed"
            if fit_transform(model, lidar_m, depth_m).condition >= SINGULAR_CONDITION:
                reason = f"all {inliers.size} valid pairs lie on a line or a point"
            return RejectedModel(model=model, reason=reason)
        fitted = fit_transform(model, lidar_m[inliers], depth_m[inliers])
        residual_m = residuals(fitted.A, lidar_m, depth_m)
        agree = residual_m <= settings.inlier_threshold_m
        refits += 1
        has_converged = bool((agree == inliers).all())
        if has_converged or refits == settings.refits_max or fitted.condition >= SINGULAR_CONDITION:
            break
        inliers = agree

    rejection = _rejection_reason(fitted, lidar_m, inliers, settings)
    if rejection:
        return RejectedModel(model=model, reason=rejection)
    free = 2 * count
    median_m = float(np.median(residual_m[inliers]))
    sigma_m = median_m / _RAYLEIGH_MEDIAN * np.sqrt(free / (free - PARAMETERS[model]))
    return _Candidate(
        model=model,
        fit=fitted,
        inliers=inliers,
        residual_m=residual_m,
        sigma_m=float(sigma_m),
        draws=draws,
        best_draw=best_draw,
        refits=refits,
        has_converged=has_converged,
    )


def _find_consensus(
    model: TransformModel, lidar_m: FloatArray, depth_m: FloatArray, settings: RegistrationSettings
) -> tuple[BoolArray, int, int]:
    """The largest set of agreeing pairs, the index of its draw, and the number of draws made."""
    pairs = lidar_m.shape[0]
    limit = settings.draws if settings.stopping == "fixed" else settings.draws_max
    best = np.zeros(pairs, dtype=np.bool_)
    best_draw = done = block = 0
    enough = np.inf
    while done < min(limit, enough):
        size = min(settings.draws, limit - done)
        samples = draw_samples(pairs, settings.sample_size, size, (settings.seed, block))
        _, agree = evaluate_samples(model, lidar_m, depth_m, samples, settings.inlier_threshold_m)
        counts = agree.sum(axis=1)
        top = int(counts.argmax())
        if counts[top] > best.sum():
            best, best_draw = agree[top], done + top
        done += size
        block += 1
        if settings.stopping == "adaptive":
            inlier_ratio = float(best.mean())
            enough = count_draws_needed(inlier_ratio, settings.sample_size, settings.confidence)
    return best, best_draw, done


def _rejection_reason(
    fitted: TransformFit, lidar_m: FloatArray, inliers: BoolArray, settings: RegistrationSettings
) -> str:
    """Why a fit is rejected; empty where it is not."""
    count = f"its {inliers.sum()} inliers of {inliers.size} valid pairs"
    limit = settings.condition_max if settings.guards else SINGULAR_CONDITION
    if not fitted.condition <= limit or fitted.condition >= SINGULAR_CONDITION:
        return (
            f"{count} lie too nearly on a line "
            f"(condition {fitted.condition:.3g}, at most {limit:g})"
        )
    derivative = point_jacobian(fitted.A, lidar_m[inliers])
    determinant = np.linalg.det(derivative)
    # The two scales a >= b of a plane map have a b = |det| and a² + b² = the sum of squares.
    squares = (derivative**2).sum(axis=(1, 2))
    area = np.abs(determinant)
    larger = (np.sqrt(squares + 2.0 * area) + np.sqrt(np.maximum(squares - 2.0 * area, 0.0))) / 2.0
    with np.errstate(divide="ignore"):
        anisotropy = float((larger**2 / area).max())
    if anisotropy >= SINGULAR_CONDITION:
        return f"it has no inverse: the images of {count} lie on a line"
    if not settings.guards:
        return ""
    if determinant.min() <= 0.0:
        return f"it mirrors {count}"
    least, greatest = float(np.sqrt(area.min())), float(np.sqrt(area.max()))
    if least < settings.scale_min or greatest > settings.scale_max:
        return (
            f"it scales {count} by {least:.3g} to {greatest:.3g} "
            f"(allowed {settings.scale_min:g} to {settings.scale_max:g})"
        )
    if anisotropy > settings.anisotropy_max:
        return f"it stretches {count} by {anisotropy:.3g} (at most {settings.anisotropy_max:g})"
    lost = int(np.isnan(apply_transform(fitted.A, lidar_m)[:, 0]).sum())
    if lost:
        return f"its horizon leaves {lost} of {inliers.size} valid pairs without an image"
    return ""


def _select_by_gric(candidates: list[_Candidate], threshold_m: float) -> int:
    """Index of the simplest candidate whose GRIC is at most 10 above the least.

    GRIC (Torr 1998): sum of min(r²/σ², 4) + k ln(4 m), with k the model's parameters and m valid
    pairs of four coordinates; the term of the dimension is the same for all four models. σ,
    common to all, is that of the candidate whose residuals, truncated at the threshold, are
    least. 10 is very strong evidence (Kass and Raftery 1995): neighbouring samples share errors,
    which a richer model overfits.
    """
    squares = np.array([candidate.residual_m**2 for candidate in candidates])
    # fmin: a pair without an image counts as one far off.
    explained = np.fmin(squares, threshold_m**2).sum(axis=1)
    sigma_m = max(candidates[int(explained.argmin())].sigma_m, _SIGMA_FLOOR_M)
    misfit = np.fmin(squares / sigma_m**2, 4.0).sum(axis=1)
    parameters = np.array([PARAMETERS[candidate.model] for candidate in candidates])
    gric = misfit + parameters * np.log(4 * squares.shape[1])
    return int(np.flatnonzero(gric <= gric.min() + _GRIC_MARGIN)[0])
