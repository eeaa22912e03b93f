"""Covariance of a PL-ICP match, propagated from the noise of every range.

After Censi 2007 ("An accurate observable-form estimate of ICP's covariance"): at the optimum the
gradient g(x, z) of the cost vanishes, so an error dz of the ranges moves the pose by
-(dg/dx)⁻¹ (dg/dz) dz, and

    cov(x) = (dg/dx)⁻¹ (dg/dz) cov(z) (dg/dz)ᵀ (dg/dx)⁻¹        (Censi 2007, eq. 4)

z are the ranges of *both* sweeps. A reference range takes part in the lines of all of its
neighbours, so their residuals are correlated: dg/dz is summed by range before it is squared.
"""

from math import erf, exp, pi, sqrt

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray
from fusion_core.registration.line_icp import add_spurious_information, find_unobservable_directions
from fusion_core.registration.line_pairs import LinePairs
from fusion_core.registration.local_lines import LocalLines, incidence_cos
from fusion_core.registration.polar_correspondence import PolarScan

# Standard deviation along an unobservable direction: finite, and larger than any room.
UNOBSERVABLE_SIGMA_M = 100.0

# Least factor on the covariance, set by hand. Residuals far below range noise mean correlated
# errors (quantised or filtered ranges at standstill), not a better match.
_NOISE_FACTOR_MIN = 0.5


def trimmed_gaussian_variance(sigmas: float) -> float:
    """Variance of a unit Gaussian that is cut off at ± ``sigmas``."""
    density = exp(-0.5 * sigmas**2) / sqrt(2.0 * pi)
    return 1.0 - 2.0 * sigmas * density / erf(sigmas / sqrt(2.0))


def match_covariance(
    pairs: LinePairs,
    reference: PolarScan,
    lines: LocalLines,
    moving: PolarScan,
    pose: FloatArray,
    sigmas_m: tuple[float, float],
    kept_variance: float,
) -> tuple[FloatArray, FloatArray, float]:
    """Covariance (3, 3) of the pose (x, y, yaw) in the reference's frame; unobservable directions;
    lever.

    ``sigmas_m``: of the ranges of the reference and of the moving sweep. The pairs' residuals scale
    the result where they disagree with these; ``kept_variance`` is the variance of a unit Gaussian
    that trimming leaves. The unobservable directions are (k, 3) in (x, y, yaw); with the yaw
    multiplied by the lever, in metres, they are orthonormal.
    """
    information, spurious, gradient_covariance, lever_m, misfit = _sum_over_pairs(
        pairs, reference, lines, moving, pose, sigmas_m
    )
    _, directions, is_unobservable = find_unobservable_directions(information, spurious, lever_m)
    observable, unobservable = directions[:, ~is_unobservable], directions[:, is_unobservable]
    # (x, y, yaw · lever): all in metres.
    scale = np.array([1.0, 1.0, 1.0 / lever_m])
    to_metres = np.outer(scale, scale)
    # Noise of the normals adds spurious information, and noise to the gradient: w var(e) = 1.
    true_information = (information - spurious) * to_metres
    noise = (gradient_covariance + spurious) * to_metres
    covariance = unobservable @ unobservable.T * UNOBSERVABLE_SIGMA_M**2
    if observable.shape[1] > 0:
        inverse = (
            observable @ np.linalg.inv(observable.T @ true_information @ observable) @ observable.T
        )
        factor = misfit / kept_variance
        covariance += inverse @ noise @ inverse * max(factor, _NOISE_FACTOR_MIN)
    return covariance * to_metres, unobservable.T * scale, lever_m


@compiled(error_model="numpy")
def _sum_over_pairs(
    pairs: LinePairs,
    reference: PolarScan,
    lines: LocalLines,
    moving: PolarScan,
    pose: FloatArray,
    sigmas_m: tuple[float, float],
) -> tuple[FloatArray, FloatArray, FloatArray, float, float]:
    """dg/dx, the spurious part of it, and (dg/dz) cov(z) (dg/dz)ᵀ, all (3, 3); the root mean square
    distance of the points; and the squares of the residuals, over what they are expected to be."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    count = reference.range_m.size
    information, spurious, gradient_covariance = (
        np.zeros((3, 3)),
        np.zeros((3, 3)),
        np.zeros((3, 3)),
    )
    by_reference_range = np.zeros((count, 3))
    squares, weights, levers, used = 0.0, 0.0, 0.0, 0
    row = np.empty(3)
    for i in range(pairs.partner.size):
        j = pairs.partner[i]
        if j < 0:
            continue
        used += 1
        squares += pairs.residual_m[i] ** 2 / pairs.variance_m2[i]
        weight = pairs.weight_per_m2[i]
        direction_x = c * moving.cos[i] - s * moving.sin[i]
        direction_y = s * moving.cos[i] + c * moving.sin[i]
        range_m = moving.range_m[i]
        x, y = range_m * direction_x, range_m * direction_y
        normal_x, normal_y = lines.normal_x[j], lines.normal_y[j]
        row[0], row[1], row[2] = normal_x, normal_y, normal_y * x - normal_x * y
        weights += weight
        levers += weight * range_m * range_m

        across = sigmas_m[1] * (normal_x * direction_x + normal_y * direction_y)
        _add_square(information, row, weight)
        _add_square(gradient_covariance, row, (weight * across) ** 2)

        # The line at the foot is Σ (1/K + s s_l / Σ s²) of the run's points, as in any regression.
        foot = normal_x * (y + pose[1]) - normal_y * (x + pose[0]) - lines.centre_m[j]
        beam = lines.first[j]
        for _ in range(lines.beams[j]):
            along = reference.range_m[beam] * (
                normal_x * reference.sin[beam] - normal_y * reference.cos[beam]
            )
            influence = 1.0 / lines.beams[j]
            influence += foot * (along - lines.centre_m[j]) / lines.spread_m2[j]
            # Signs as in the residual do not matter: all beams of a run cross it in the same
            # direction.
            influence *= weight * sigmas_m[0] * incidence_cos(reference, lines, j, beam)
            for a in range(3):
                by_reference_range[beam, a] += influence * row[a]
            beam = beam + 1 if beam + 1 < count else 0
        variance = (sigmas_m[0] * incidence_cos(reference, lines, j, j)) ** 2 / lines.spread_m2[j]
        add_spurious_information(spurious, x, y, normal_x, normal_y, weight * variance)
    for beam in range(count):
        _add_square(gradient_covariance, by_reference_range[beam], 1.0)

    lever_m = max(np.sqrt(levers / weights), 1e-6)
    return information, spurious, gradient_covariance, lever_m, squares / max(used - 3, 1)


@compiled()
def _add_square(matrix: FloatArray, row: FloatArray, weight: float) -> None:
    """Add weight · row rowᵀ to (3, 3)."""
    for a in range(3):
        for b in range(3):
            matrix[a, b] += weight * row[a] * row[b]
