"""The line through each beam's neighbourhood of a sweep, and the noise of the ranges.

Two neighbouring points give a poor normal: 1 cm of noise at a spacing of 3 cm rotates it by a third
of a radian. So each beam gets the line fitted to the longest run of neighbours that is straight
within the noise: up to ``2 HALF_WINDOW + 1`` beams around it or to one side of it.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.registration.polar_correspondence import PolarScan

# Set by hand: 17 beams of a common LiDAR (0.5 degrees) span 8 degrees, about 30 cm of wall at 2 m.
HALF_WINDOW = 8
# Three beams: the fewest with a residual.
_HALF_WINDOW_MIN = 1

# 84 degrees, set by hand: beyond it the noise across the surface comes from the beam's angle, not
# its range.
INCIDENCE_COS_MIN = 0.1

# Ranges without noise, as in a simulation: weights divide by it.
RANGE_SIGMA_MIN_M = 1e-5

# Set by hand, above the noise of common 2D LiDARs; a larger spread is clutter: leaves, legs, edges.
RANGE_SIGMA_MAX_M = 0.05

# A run is straight if its reduced chi-square is below this. Set by hand: noise alone rarely exceeds
# it, except in the shortest runs.
_CHI_SQUARE_MAX = 3.0


class LocalLines(NamedTuple):
    """A line for each of the M valid beams: ``normal · p = offset``, the normal pointing away from
    it.

    ``normal_x``, ``normal_y``, ``offset_m``: (M,), NaN where no run of beams is straight.
    ``centre_m``, ``low_m``, ``high_m``: (M,) coordinates along the line, on (-normal_y, normal_x),
    of the run's centroid and of its two ends.
    ``spread_m2``: (M,) sum over the run of the squared distance from the centroid along the line.
    ``first``, ``beams``: (M,) the run, which may go on from the last beam to the first.
    """

    normal_x: FloatArray
    normal_y: FloatArray
    offset_m: FloatArray
    centre_m: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    spread_m2: FloatArray
    first: IntArray
    beams: IntArray


def estimate_range_sigma_m(scan: PolarScan) -> float:
    """Standard deviation of a sweep's ranges, from neighbouring beams on one flat surface.

    On a plane 1/r is a cosine of the angle, so 1/r₋ + 1/r₊ - 2 cos(dθ)/r vanishes. Its lower
    tercile gives the noise; the rest may be edges.
    """
    bends: FloatArray = _second_differences_m(scan)
    if bends.size == 0:
        return RANGE_SIGMA_MIN_M
    third = float(np.partition(bends, bends.size // 3)[bends.size // 3])
    # A third of N(0, 1) lies within ± 0.4307; the weights 1, -2, 1 have squares that sum to 6.
    return min(max(third / (0.4307 * sqrt(6.0)), RANGE_SIGMA_MIN_M), RANGE_SIGMA_MAX_M)


@compiled()
def _second_differences_m(scan: PolarScan) -> FloatArray:
    """Size of r² (1/r₋ + 1/r₊ - 2 cos(dθ)/r) at each beam between two valid neighbours."""
    count = scan.range_m.size
    bends = np.empty(count)
    found = 0
    for i in range(1, count - 1):
        if abs(scan.beam[i + 1] - scan.beam[i - 1]) == 2:
            two_cos = 2.0 * np.cos(scan.step_rad)
            here = scan.range_m[i]
            bend = here / scan.range_m[i - 1] + here / scan.range_m[i + 1] - two_cos
            bends[found] = abs(bend) * here
            found += 1
    return bends[:found].copy()


@compiled()
def incidence_cos(scan: PolarScan, lines: LocalLines, line: int, beam: int) -> float:
    """Cosine of the angle between a beam and a line's normal, not below INCIDENCE_COS_MIN."""
    cosine = lines.normal_x[line] * scan.cos[beam] + lines.normal_y[line] * scan.sin[beam]
    bounded: float = max(abs(cosine), INCIDENCE_COS_MIN)
    return bounded


@compiled(error_model="numpy")
def fit_local_lines(scan: PolarScan, sigma_m: float) -> LocalLines:
    """Lines of a sweep whose ranges have the standard deviation ``sigma_m``."""
    count = scan.range_m.size
    widest = min(HALF_WINDOW, (count - 1) // 2)
    sums = _running_sums(scan, 2 * widest)
    lines = LocalLines(
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.full(count, np.nan),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count, dtype=np.int64),
        np.zeros(count, dtype=np.int64),
    )
    for k in range(count):
        half = widest
        while half >= _HALF_WINDOW_MIN:
            first = _find_straight_run(sums, scan, k, half, 2 * widest, sigma_m)
            if first > k:
                half //= 2
                continue
            _store_line(lines, sums, scan, k, first, 2 * half + 1, 2 * widest)
            break
    return lines


@compiled(error_model="numpy")
def _find_straight_run(
    sums: FloatArray, scan: PolarScan, k: int, half: int, margin: int, sigma_m: float
) -> int:
    """First beam of a straight run of 2 half + 1 beams with beam k in it; k + 1 where none is.

    The run about the beam is taken where it is straight, else the better one of those that end
    and begin with the beam.
    """
    size = 2 * half + 1
    if _reduced_chi_square(sums, scan, k, k - half, size, margin, sigma_m) < _CHI_SQUARE_MAX:
        return k - half
    left = _reduced_chi_square(sums, scan, k, k - 2 * half, size, margin, sigma_m)
    right = _reduced_chi_square(sums, scan, k, k, size, margin, sigma_m)
    if min(left, right) >= _CHI_SQUARE_MAX:
        return k + 1
    return k - 2 * half if left < right else k


@compiled()
def _running_sums(scan: PolarScan, margin: int) -> FloatArray:
    """(M + 2 margin + 1, 5) sums of x, y, xx, xy, yy, from ``margin`` beams before the first."""
    count = scan.range_m.size
    sums = np.zeros((count + 2 * margin + 1, 5))
    for place in range(count + 2 * margin):
        i = (place - margin) % count
        x, y = scan.range_m[i] * scan.cos[i], scan.range_m[i] * scan.sin[i]
        sums[place + 1, 0] = sums[place, 0] + x
        sums[place + 1, 1] = sums[place, 1] + y
        sums[place + 1, 2] = sums[place, 2] + x * x
        sums[place + 1, 3] = sums[place, 3] + x * y
        sums[place + 1, 4] = sums[place, 4] + y * y
    return sums


@compiled(error_model="numpy")
def _moments(
    sums: FloatArray, first: int, size: int, margin: int
) -> tuple[float, float, float, float, float]:
    """Centroid x, y and central sums of squares xx, xy, yy of a run."""
    low, high = first + margin, first + margin + size
    x = (sums[high, 0] - sums[low, 0]) / size
    y = (sums[high, 1] - sums[low, 1]) / size
    xx = sums[high, 2] - sums[low, 2] - size * x * x
    xy = sums[high, 3] - sums[low, 3] - size * x * y
    yy = sums[high, 4] - sums[low, 4] - size * y * y
    return x, y, xx, xy, yy


@compiled(error_model="numpy")
def _reduced_chi_square(
    sums: FloatArray, scan: PolarScan, k: int, first: int, size: int, margin: int, sigma_m: float
) -> float:
    """Mean square distance from the run's own line over what the noise explains.

    Infinite where the run would go on from the last beam to the first of less than a full turn.
    """
    count, slots = scan.range_m.size, scan.first_in_slot.size - 1
    open_rad = 2.0 * np.pi - slots * scan.step_rad
    if (first < 0 or first + size > count) and open_rad > 0.5 * scan.step_rad:
        return np.inf
    _, _, xx, xy, yy = _moments(sums, first, size, margin)
    half_difference = 0.5 * (xx - yy)
    root = np.sqrt(half_difference * half_difference + xy * xy)
    across = max(0.5 * (xx + yy) - root, 0.0)
    # The direction along the run at twice its angle, (cos 2a, sin 2a), and the beam's likewise.
    c, s = scan.cos[k], scan.sin[k]
    double = (half_difference * (c * c - s * s) + xy * 2.0 * c * s) / root if root > 0.0 else 0.0
    crossing = max(0.5 * (1.0 - double), INCIDENCE_COS_MIN * INCIDENCE_COS_MIN)
    misfit: float = across / ((size - 2) * sigma_m * sigma_m * crossing)
    return misfit


@compiled(error_model="numpy")
def _store_line(
    lines: LocalLines,
    sums: FloatArray,
    scan: PolarScan,
    k: int,
    first: int,
    size: int,
    margin: int,
) -> None:
    """Store the line of a run."""
    count = scan.range_m.size
    x, y, xx, xy, yy = _moments(sums, first, size, margin)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    # (c, s) along the line, (s, -c) across it.
    c, s = np.cos(angle), np.sin(angle)
    if s * scan.cos[k] - c * scan.sin[k] < 0.0:
        c, s = -c, -s
    centre = x * c + y * s
    low, high = np.inf, -np.inf
    for end in (first % count, (first + size - 1) % count):
        along = scan.range_m[end] * (c * scan.cos[end] + s * scan.sin[end])
        low, high = min(low, along), max(high, along)
    lines.normal_x[k], lines.normal_y[k] = s, -c
    lines.offset_m[k] = s * x - c * y
    lines.centre_m[k], lines.low_m[k], lines.high_m[k] = centre, low, high
    lines.spread_m2[k] = c * c * xx + 2.0 * c * s * xy + s * s * yy
    lines.first[k], lines.beams[k] = first % count, size
