"""Point-to-line correspondences between a moving sweep and the local lines of a reference."""

from typing import NamedTuple

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.robust import MAD_TO_SIGMA
from fusion_core.registration.local_lines import (
    INCIDENCE_COS_MIN,
    LocalLines,
    incidence_cos,
)
from fusion_core.registration.polar_correspondence import PolarScan, find_nearest

# Set by hand: at this ratio of densities the sparser sweep causes over 90 % of the variance.
_DENSITY_RATIO_MAX = 10.0

# Set by hand: the largest factor by which the trimming limit shrinks in one iteration, so that a
# poor start does not lose its good pairs.
_LIMIT_DECREASE_MAX = 4.0


class LinePairs(NamedTuple):
    """One entry for each of the M valid beams of the moving sweep.

    ``partner``: (M,) index of the reference's valid beam whose line it is paired with, or -1.
    ``residual_m``: (M,) signed distance from that line. ``variance_m2``: (M,) of this distance,
    from the range noise of the point and of the line. ``weight_per_m2``: (M,) its weight in the
    sum of squares. The last three are undefined without a partner.
    """

    partner: IntArray
    residual_m: FloatArray
    variance_m2: FloatArray
    weight_per_m2: FloatArray


@compiled()
def make_empty_pairs(count: int) -> LinePairs:
    """Pairs of ``count`` beams, all without a partner."""
    return LinePairs(np.full(count, -1), np.zeros(count), np.ones(count), np.ones(count))


@compiled(error_model="numpy")
def find_pairs(
    pairs: LinePairs,
    reference: PolarScan,
    lines: LocalLines,
    moving: PolarScan,
    pose: FloatArray,
    sigmas_m: tuple[float, float],
    distance_max_m: float,
    stride: int,
) -> None:
    """Pair every ``stride``-th beam of the moving sweep, seen from ``pose`` in the reference.

    The partner is the line at the nearest point of the reference (Censi 2008, step 3). A point
    stays unpaired where that point has no line or is too far, or where its projection lies beyond
    the ends of the line: it is then seen past an edge. ``sigmas_m``: of the reference and the
    moving ranges.
    """
    c, s = np.cos(pose[2]), np.sin(pose[2])
    step_ratio = reference.step_rad / moving.step_rad
    for i in range(0, moving.range_m.size, stride):
        pairs.partner[i] = -1
        direction_x = c * moving.cos[i] - s * moving.sin[i]
        direction_y = s * moving.cos[i] + c * moving.sin[i]
        range_m = moving.range_m[i]
        x, y = pose[0] + range_m * direction_x, pose[1] + range_m * direction_y
        j, _ = find_nearest(reference, x, y, distance_max_m * distance_max_m)
        if j < 0 or np.isnan(lines.offset_m[j]):
            continue
        normal_x, normal_y = lines.normal_x[j], lines.normal_y[j]
        along = normal_x * y - normal_y * x
        low, high = lines.low_m[j], lines.high_m[j]
        spare = 0.5 * (high - low) / (lines.beams[j] - 1)
        if along < low - spare or along > high + spare:
            continue
        # Range noise acts along the beam; its component across the line is cos(incidence) of it.
        here = abs(normal_x * direction_x + normal_y * direction_y)
        here = max(here, INCIDENCE_COS_MIN)
        there = incidence_cos(reference, lines, j, j)
        point_variance = (sigmas_m[1] * here) ** 2
        beam_variance = (sigmas_m[0] * there) ** 2
        off_centre = along - lines.centre_m[j]
        line_variance_ratio = 1.0 / lines.beams[j] + off_centre * off_centre / lines.spread_m2[j]
        # Pairs on one surface have the reference's noise in common. With N moving and K reference
        # points the two estimates of the surface differ by point_variance / N + beam_variance / K;
        # a weight of 1 / (point_variance + N/K beam_variance) for each pair is equivalent.
        density = step_ratio * reference.range_m[j] * here / (there * range_m)
        density = min(max(density, 1.0 / _DENSITY_RATIO_MAX), _DENSITY_RATIO_MAX)
        pairs.partner[i] = j
        pairs.residual_m[i] = normal_x * x + normal_y * y - lines.offset_m[j]
        pairs.variance_m2[i] = point_variance + line_variance_ratio * beam_variance
        pairs.weight_per_m2[i] = 1.0 / (point_variance + density * beam_variance)


@compiled()
def drop_duplicates(pairs: LinePairs, reference_count: int, stride: int) -> None:
    """Of the points that share a partner, keep the one nearest to its line (Censi 2008)."""
    owner = np.full(reference_count, -1)
    for i in range(0, pairs.partner.size, stride):
        j = pairs.partner[i]
        if j < 0:
            continue
        other = owner[j]
        if other >= 0 and abs(pairs.residual_m[other]) <= abs(pairs.residual_m[i]):
            pairs.partner[i] = -1
            continue
        if other >= 0:
            pairs.partner[other] = -1
        owner[j] = i


@compiled(error_model="numpy")
def trim_pairs(
    pairs: LinePairs, sigmas: float, last_limit: float, stride: int
) -> tuple[int, float, float]:
    """Drop pairs whose residual exceeds a limit, in units of their standard deviation.

    The limit is ``sigmas``, times the robust deviation of the pairs themselves where that exceeds
    what range noise explains. It falls slowly from ``last_limit``: once two walls fit, the median
    is small, and a third wall would be trimmed before it could converge. Returns the number of
    pairs left, the limit, and the ratio of the robust deviation to that of range noise.
    """
    size = np.empty(pairs.partner.size)
    count = 0
    for i in range(0, pairs.partner.size, stride):
        if pairs.partner[i] >= 0:
            size[count] = abs(pairs.residual_m[i]) / np.sqrt(pairs.variance_m2[i])
            count += 1
    if count == 0:
        return 0, last_limit, np.inf
    scale = MAD_TO_SIGMA * np.median(size[:count])
    limit = max(sigmas * max(scale, 1.0), min(last_limit / _LIMIT_DECREASE_MAX, size[:count].max()))
    left = 0
    for i in range(0, pairs.partner.size, stride):
        if pairs.partner[i] >= 0:
            if abs(pairs.residual_m[i]) > limit * np.sqrt(pairs.variance_m2[i]):
                pairs.partner[i] = -1
            else:
                left += 1
    return left, limit, scale
