"""How sure a pose found from one image is, and how probably it is worse than the guess.

Points of one image are no independent draws: neighbours lie on one surface, and an edge that is no
edge of the surface misleads all of them. The covariance is therefore taken from how much the parts
of the image disagree (the sandwich of composite likelihoods, Varin et al. 2011).
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.stats import norm

from fusion_core.calibration.pose_error import apply_pose_error
from fusion_core.calibration.refinement.alignment_evidence import EvidenceLevel
from fusion_core.model.conventions import FloatArray, read_only

# Poses for 28 coefficients of a quadratic in six unknowns.
_POSES = 360
_SPREAD = 0.8
_WEIGHT_MIN, _WEIGHT_MAX = 1e-3, 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EvidenceShape:
    """The evidence near a pose. ``curvature``: (6, 6) of its nats, positive semidefinite.
    ``scatter``: (6, 6) the covariance of its gradient, from that of its blocks."""

    curvature: FloatArray
    scatter: FloatArray

    def __post_init__(self) -> None:
        read_only(self.curvature)
        read_only(self.scatter)

    @property
    def weight(self) -> float:
        """What the nats count so that curvature and scatter agree as those of a likelihood do."""
        values, vectors = np.linalg.eigh(self.curvature)
        known = values > 1e-9 * values.max(initial=0.0)
        if not known.any():
            return _WEIGHT_MIN
        basis = vectors[:, known]
        ratio = np.einsum("ij,ik,kj->j", basis, self.scatter, basis) / values[known]
        return float(np.clip(known.sum() / max(ratio.sum(), 1e-300), _WEIGHT_MIN, _WEIGHT_MAX))

    def posterior(
        self, precision: FloatArray, weight: float, bias: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(6, 6) G and C: with a prior of this ``precision``, and evidence that may be misled by an
        error of the covariance ``bias``, the mean is G e where the minimum without bias is e, and
        its covariance C.

        With the evidence's information L = ``weight`` ``curvature`` and W = (1 + L B)⁻¹ it is
        W L = (L⁻¹ + B)⁻¹ that the evidence tells.
        """
        L = weight * self.curvature
        W = np.linalg.inv(np.eye(6) + L @ bias)
        told: FloatArray = W @ L
        inverse = np.linalg.inv(0.5 * (told + told.T) + precision)
        scatter = weight**2 * W @ self.scatter @ W.T + told @ bias @ told.T + precision
        covariance = inverse @ scatter @ inverse
        return inverse @ W @ (L + precision), 0.5 * (covariance + covariance.T)


def evidence_shape(
    level: EvidenceLevel,
    T_guess: FloatArray,
    error: FloatArray,
    basis: FloatArray,
    blocks: int,
    seed: int,
) -> EvidenceShape:
    """The shape at an ``error`` from the guess, by quadratics through poses some steps of the
    ``basis`` around it: a derivative would see the image's noise alone."""
    steps = np.random.default_rng(seed).normal(scale=_SPREAD, size=(_POSES, 6))
    tables = level.tables(apply_pose_error(T_guess, error))
    nats = np.array(
        [
            level.block_information(
                apply_pose_error(T_guess, error + basis @ step), tables, blocks
            ).sum(axis=0)
            for step in steps
        ]
    )
    rows, columns = np.triu_indices(6)
    products = steps[:, rows] * steps[:, columns]
    design = np.concatenate([np.ones((_POSES, 1)), steps, products], axis=1)
    fitted = np.linalg.lstsq(design, nats, rcond=None)[0]
    gradients = fitted[1:7].T
    used = np.ptp(nats, axis=0) > 0.0
    count = int(used.sum())
    apart = gradients[used] - gradients[used].mean(axis=0) if count else gradients[:0]
    scatter = apart.T @ apart * (count / max(1, count - 1))
    hessian = np.zeros((6, 6))
    hessian[rows, columns] = fitted[7:].sum(axis=1)
    hessian = -(hessian + hessian.T)
    values, vectors = np.linalg.eigh(hessian)
    curvature = (vectors * np.maximum(values, 0.0)) @ vectors.T
    inverse = np.linalg.inv(basis)
    return EvidenceShape(
        curvature=inverse.T @ curvature @ inverse, scatter=inverse.T @ scatter @ inverse
    )


def bearing_bias(metric: FloatArray, sd_rad: float) -> FloatArray:
    """(6, 6) covariance of the pose by errors of bearings that all parts of a scene share.

    ``metric``: (6, 6) M, the mean square by which an error of the pose moves the image. Errors of
    the scanner's angles or the camera's model may look like any error of the pose; those move the
    image by ``sd_rad``.
    """
    return np.asarray(np.linalg.inv(metric) * sd_rad**2, dtype=np.float64)


def jackknife_covariance(left_out: FloatArray) -> FloatArray:
    """(6, 6) covariance of a result from those without a part each, (parts, 6) (Quenouille 1949,
    Tukey 1958)."""
    parts = len(left_out)
    apart = left_out - left_out.mean(axis=0)
    covariance: FloatArray = (parts - 1) / parts * (apart.T @ apart)
    return covariance


def risk_of_worse(
    moved: FloatArray, mean: FloatArray, covariance: FloatArray, metric: FloatArray
) -> float:
    """The probability that the truth y ~ N(mean, covariance), as an error from the guess, lies
    nearer to the guess than to the result ``moved``, by (y - moved)ᵀ M (y - moved) > yᵀ M y."""
    length = float(moved @ metric @ moved)
    if length <= 0.0:
        return 0.0
    ahead = 2.0 * float(mean @ metric @ moved) - length
    sd = 2.0 * sqrt(max(0.0, float(moved @ metric @ covariance @ metric @ moved)))
    return float(norm.cdf(-ahead / sd)) if sd > 0.0 else float(ahead < 0.0)
