"""Flat surfaces through the good samples around a sample, from which repairs are made.

A straight wall's inverse range is linear in the angle, and a plane's inverse depth is linear in
the pixel, so each fit is linear.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray

# A wall is fitted over at most this many beams to either side of one.
_MAX_BEAMS_BESIDE = 5
# A beam farther than this many standard deviations off the wall is of another one.
_SAME_WALL_SIGMA = 2.5


@dataclass(frozen=True, slots=True, kw_only=True)
class SmoothRanges:
    """(B,) ranges of the walls through beams and their neighbours, and their expected errors.

    A beam without a fitted wall keeps its range and its noise; NaN where it has none.
    """

    range_m: FloatArray
    error_m: FloatArray


def smooth_ranges(
    azimuth_rad: FloatArray, range_m: FloatArray, sigma_m: FloatArray
) -> SmoothRanges:
    """Fit a straight wall around each beam, over as many beams as one wall explains.

    ``azimuth_rad``, ``range_m`` (NaN where missing), ``sigma_m`` (one beam's noise): (B,).
    """
    smooth, error = _smooth(azimuth_rad, range_m, sigma_m)
    return SmoothRanges(range_m=smooth, error_m=error)


@compiled()
def _smooth(
    azimuth_rad: FloatArray, range_m: FloatArray, sigma_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    smooth, error = range_m.copy(), sigma_m.copy()
    for index in range(range_m.size):
        own = range_m[index]
        if np.isnan(own):
            continue
        for reach in range(_MAX_BEAMS_BESIDE, 1, -1):
            first, last = max(0, index - reach), min(range_m.size, index + reach + 1)
            # Moments of (angle, inverse range): equal weights, since one wall is of one range.
            n = 0
            t1 = t2 = q0 = q1 = 0.0
            for k in range(first, last):
                if np.isnan(range_m[k]):
                    continue
                t = azimuth_rad[k] - azimuth_rad[index]
                inverse = 1.0 / range_m[k]
                n += 1
                t1 += t
                t2 += t * t
                q0 += inverse
                q1 += t * inverse
            spread = n * t2 - t1 * t1
            if n < 3 or spread <= 0.0:
                continue
            slope = (n * q1 - t1 * q0) / spread
            middle = (q0 - slope * t1) / n
            one_wall = middle > 0.0
            for k in range(first, last):
                if np.isnan(range_m[k]):
                    continue
                inverse = middle + slope * (azimuth_rad[k] - azimuth_rad[index])
                off_m = abs(range_m[k] * (1.0 - range_m[k] * inverse))
                one_wall = one_wall and off_m <= _SAME_WALL_SIGMA * sigma_m[k]
            if one_wall:
                smooth[index] = 1.0 / middle
                error[index] = sigma_m[index] * np.sqrt(t2 / spread)
                break
    return smooth, error


def interpolate_gaps(
    azimuth_rad: FloatArray,
    range_m: FloatArray,
    support: BoolArray,
    edge_m: float,
) -> tuple[FloatArray, FloatArray]:
    """(B,) range on the straight line between the ends of the gap around each beam, and the gap's
    width. An end is the mean point of up to three supporting beams of one surface. NaN where an
    end is missing, the ends lie on different surfaces, or a return within the gap is nearer: it
    may be all that is seen of a dark table leg."""
    direction = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], axis=1)
    filled, width = _interpolate(azimuth_rad, direction, range_m, support, edge_m)
    return filled, width


@compiled()
def _interpolate(
    azimuth_rad: FloatArray,
    direction: FloatArray,
    range_m: FloatArray,
    support: BoolArray,
    edge_m: float,
) -> tuple[FloatArray, FloatArray]:
    filled, width = np.full(range_m.size, np.nan), np.full(range_m.size, np.inf)
    good = np.flatnonzero(support)
    for order in range(1, good.size):
        left, right = good[order - 1], good[order]
        if right == left + 1:
            continue
        left_x, left_y = _end_point(direction, range_m, good, order - 1, -1, edge_m)
        right_x, right_y = _end_point(direction, range_m, good, order, 1, edge_m)
        chord_x, chord_y = right_x - left_x, right_y - left_y
        gap = abs(azimuth_rad[right] - azimuth_rad[left])
        near = min(range_m[right], range_m[left])
        far = max(range_m[right], range_m[left])
        # A slanted wall changes its range across a wide gap; an edge jumps.
        one_surface = far - near <= edge_m + gap * near
        nearest = np.inf
        for beam in range(left + 1, right):
            if np.isfinite(range_m[beam]):
                nearest = min(nearest, range_m[beam])
        for beam in range(left + 1, right):
            width[beam] = gap
            turn = direction[beam, 0] * chord_y - direction[beam, 1] * chord_x
            if not one_surface or abs(turn) <= 1e-6:
                continue
            crossing = (left_x * chord_y - left_y * chord_x) / turn
            hides = nearest < crossing - edge_m
            if near - edge_m < crossing < far + edge_m and not hides:
                filled[beam] = crossing
    return filled, width


@compiled()
def _end_point(
    direction: FloatArray,
    range_m: FloatArray,
    good: IntArray,
    order: int,
    step: int,
    edge_m: float,
) -> tuple[float, float]:
    """Mean of the good beam ``order`` and up to two more away from the gap."""
    nearest = good[order]
    x, y = range_m[nearest] * direction[nearest, 0], range_m[nearest] * direction[nearest, 1]
    count = 1.0
    for away in (1, 2):
        other = order + step * away
        if not 0 <= other < good.size:
            continue
        beam = good[other]
        if abs(range_m[beam] - range_m[nearest]) < 0.5 * edge_m:
            x += range_m[beam] * direction[beam, 0]
            y += range_m[beam] * direction[beam, 1]
            count += 1.0
    return x / count, y / count


@compiled()
def fit_image_planes(
    depth: Float32Array,
    rows: IntArray,
    columns: IntArray,
    expected_m: FloatArray,
    max_radius_px: int,
    edge_m: float,
) -> FloatArray:
    """(N, 2) depth and its expected error, from the plane through the good pixels around a pixel.

    A plane's inverse depth is linear in the pixel, so three parameters are fitted to it over the
    smallest window that has enough pixels of one surface on both sides of the row or column.
    """
    height, width = depth.shape
    out = np.full((rows.size, 2), np.nan)
    for index in range(rows.size):
        row, column = rows[index], columns[index]
        if row < 0:
            continue
        size = 2
        while size <= max_radius_px:
            low_r, high_r = max(0, row - size), min(height, row + size + 1)
            low_c, high_c = max(0, column - size), min(width, column + size + 1)
            step = max(1, size // 6)
            values = np.empty(((high_r - low_r), (high_c - low_c))).ravel()
            du = np.empty(values.size)
            dv = np.empty(values.size)
            count = 0
            for r in range(low_r, high_r, step):
                for c in range(low_c, high_c, step):
                    if r == row and c == column:
                        continue
                    value = depth[r, c]
                    if np.isnan(value):
                        continue
                    values[count] = value
                    du[count] = c - column
                    dv[count] = r - row
                    count += 1
            if count >= 8:
                middle = expected_m[index]
                if np.isnan(middle):
                    middle = np.median(values[:count])
                result = _fit_inverse_plane(values[:count], du[:count], dv[:count], middle, edge_m)
                if not np.isnan(result[0]):
                    out[index, 0] = result[0]
                    out[index, 1] = result[1]
                    break
            size = size * 2 if size < 16 else size + 8
    return out


@compiled()
def _fit_inverse_plane(
    values: FloatArray, du: FloatArray, dv: FloatArray, middle: float, edge_m: float
) -> tuple[float, float]:
    """Depth at (0, 0) and its expected error; NaN where the pixels are one-sided or no plane."""
    normal = np.zeros((3, 3))
    target = np.zeros(3)
    count = 0
    left = right = up = down = 0
    for k in range(values.size):
        if abs(values[k] - middle) > edge_m:
            continue
        weight = values[k] ** 2
        a = np.array([1.0, du[k], dv[k]])
        for i in range(3):
            target[i] += weight * a[i] / values[k]
            for j in range(3):
                normal[i, j] += weight * a[i] * a[j]
        count += 1
        # Opposite sectors, not half planes: pixels on one side alone have some above and below.
        beside = abs(du[k]) >= abs(dv[k])
        left += beside and du[k] < 0
        right += beside and du[k] > 0
        up += not beside and dv[k] < 0
        down += not beside and dv[k] > 0
    both_sides = (left >= 2 and right >= 2) or (up >= 2 and down >= 2)
    if count < 8 or not both_sides or 2 * count < values.size:
        return np.nan, np.nan
    for i in range(3):
        normal[i, i] += 1e-9
    solution = np.linalg.solve(normal, target)
    if solution[0] <= 0.0 or abs(1.0 / solution[0] - middle) > edge_m:
        return np.nan, np.nan
    square = 0.0
    for k in range(values.size):
        if abs(values[k] - middle) > edge_m:
            continue
        inverse = solution[0] + solution[1] * du[k] + solution[2] * dv[k]
        square += (values[k] * (1.0 - values[k] * inverse)) ** 2
    rms = np.sqrt(square / count)
    covariance = np.linalg.inv(normal)
    spread = rms * np.sqrt(covariance[0, 0]) / solution[0]
    # What the plane leaves unexplained is structure as much as noise.
    return 1.0 / solution[0], spread + 0.3 * rms
