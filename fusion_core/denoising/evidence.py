"""How likely a beam's value is to lie on a surface: the evidence of five witnesses.

The witnesses are the nearest beam with a value on either side, the scans before and after, and the
pixels about the beam's own. Each compares two hypotheses: the value is that of a surface, which the
witness has probably met too, or it is a burr, anywhere between the surfaces around (a mixed pixel)
or anywhere at all (a spurious return). Its evidence is the logarithm of the likelihood ratio; as
the witnesses err for reasons of their own, the evidence adds up.

So a match counts for little where the surfaces around are close together and a burr would match by
chance, and for much where they are far apart, or where the value lies in front of them all.
"""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.denoising.support import spread_over_scan
from fusion_core.model.conventions import Float32Array, FloatArray, IntArray

WITNESSES = ("beam before", "beam after", "scan before", "scan after", "pixels around")
"""The columns of the evidence."""

# Pixels within so many rows and columns of a beam's own may show its surface: a mount that is off
# by a degree, and an edge that the camera sees from another place.
ROWS_AROUND = 6
COLUMNS_AROUND = 4
# Next to a disagreement, edges are common. Set by hand: how often a neighbour of a beam on a
# surface meets the same surface, how often the other scan does, and how often the camera does
# where nothing hides the surface from it, and where something may.
_SAME_SURFACE = 0.7
_SAME_IN_TIME = 0.6
_SAME_SEEN = 0.9
_SAME_HIDDEN = 0.3
# Of the burrs, the fraction that no edge causes; set by hand.
_SPURIOUS_FRACTION = 0.1
# A mixed pixel has a sensor's noise and that of the surfaces that it mixes; in standard deviations.
_SMEAR_SIGMA = 6.0
# The surfaces that a beam may mix lie within so many beams of it.
_BEAMS_MIXED = 2
# A neighbour is the nearest beam with a value, at most so many beams away.
_BEAMS_BESIDE = 3
# The motion between scans is known to a fraction of a beam and a return's place to half of one, and
# a mixed pixel covers two.
_BEAMS_IN_TIME = 2
# Seen by the camera, a surface that changes its range faster from beam to beam is an edge: 80
# degrees off the beam at a quarter of a degree a beam.
_EDGE_SLOPE = 0.03
# A camera's noise adds to a beam's; in variances of a good pair.
_PIXEL_VARIANCE = 1.5


@compiled()
def ranges_around(
    depth_m: Float32Array, rows: IntArray, columns: IntArray, as_range_m: FloatArray
) -> FloatArray:
    """(B, K) ranges, from the LiDAR's origin, that the camera sees about each of B pixels.

    ``depth_m``: (H, W), NaN where missing. ``rows``: (B,), below 0 where there is no pixel.
    ``as_range_m``: (B,) the pixels' own depths as ranges. About a pixel, range and depth change in
    proportion. The pixel itself is left out; NaN where missing.
    """
    height, width = depth_m.shape
    size = (2 * ROWS_AROUND + 1) * (2 * COLUMNS_AROUND + 1) - 1
    seen = np.full((rows.size, size), np.nan)
    for index in range(rows.size):
        row, column = rows[index], columns[index]
        if row < 0 or np.isnan(as_range_m[index]):
            continue
        own = depth_m[row, column]
        place = 0
        for step_r in range(-ROWS_AROUND, ROWS_AROUND + 1):
            for step_c in range(-COLUMNS_AROUND, COLUMNS_AROUND + 1):
                if step_r == 0 and step_c == 0:
                    continue
                r, c = row + step_r, column + step_c
                if 0 <= r < height and 0 <= c < width:
                    farther = (depth_m[r, c] - own) / own
                    seen[index, place] = as_range_m[index] * (1.0 + farther)
                place += 1
    return seen


@compiled()
def weigh_beams(
    ranges: FloatArray,
    in_time: FloatArray,
    beams: IntArray,
    camera: FloatArray,
    seen: FloatArray,
    hidden: FloatArray,
    noise: tuple[float, float, float],
) -> FloatArray:
    """(B, 5) evidence of each witness that the values of B ``beams`` are those of surfaces.

    ``ranges``: (N,) of the scan. ``in_time``: (2, N) of the scans before and after, as seen from
    its place. ``camera``: (B,) range at which the camera sees what a beam meets. ``seen``: (B, K)
    what it sees about the beams' pixels. ``hidden``: (B,) whether something may hide from it what
    the beam meets. Metres, NaN where missing. ``noise``: floor (m) and fraction of the standard
    deviation hypot(floor, fraction * range), and the change of range from beam to beam, as a
    fraction of it, that a slanted surface may cause. 0 where a witness has no value, and for beams
    without one.
    """
    floor_m, fraction, slope = noise
    farthest = 0.0
    for value in ranges:
        if value > farthest:
            farthest = value
    evidence = np.zeros((beams.size, 5))
    by_camera = spread_over_scan(camera, beams, ranges.size)
    for index in range(beams.size):
        beam = beams[index]
        own = ranges[beam]
        if np.isnan(own):
            continue
        variance = floor_m**2 + (fraction * own) ** 2
        burr = _burr_density(ranges, beam, seen[index], np.sqrt(variance), farthest)
        for side in range(2):
            density = _density_from_side(ranges, by_camera, beam, 2 * side - 1, variance, slope)
            if not np.isnan(density):
                evidence[index, side] = _log_ratio(_SAME_SURFACE, density, burr)
            total = 0.0
            count = 0
            for step in range(-_BEAMS_IN_TIME, _BEAMS_IN_TIME + 1):
                other = beam + step
                if 0 <= other < ranges.size and not np.isnan(in_time[side, other]):
                    total += _normal(own - in_time[side, other], 2.0 * variance)
                    count += 1
            if count > 0:
                evidence[index, 2 + side] = _log_ratio(_SAME_IN_TIME, total / count, burr)
        total = 0.0
        count = 0
        for value in seen[index]:
            if not np.isnan(value):
                total += _normal(own - value, _PIXEL_VARIANCE * variance)
                count += 1
        if count > 0:
            same = _SAME_HIDDEN if hidden[index] else _SAME_SEEN
            evidence[index, 4] = _log_ratio(same, total / count, burr)
            if hidden[index]:
                # What is hidden need not be seen.
                evidence[index, 4] = max(evidence[index, 4], 0.0)
    return evidence


@compiled()
def _log_ratio(same: float, density: float, burr: float) -> float:
    """Evidence of a witness that with probability ``same`` has met a beam's surface: the density
    of the beam's value is then ``density``, else, as that of a burr, ``burr``."""
    evidence: float = np.log(same * density / burr + 1.0 - same)
    return evidence


@compiled()
def _normal(difference: float, variance: float) -> float:
    """Density of a normal distribution of mean zero."""
    density: float = np.exp(-0.5 * difference**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    return density


@compiled()
def _burr_density(
    ranges: FloatArray, beam: int, seen: FloatArray, sigma: float, farthest: float
) -> float:
    """Density of a burr at a beam's value: uniform between the surfaces around, or anywhere."""
    low, high = np.inf, -np.inf
    first = max(0, beam - _BEAMS_MIXED)
    for other in range(first, min(ranges.size, beam + _BEAMS_MIXED + 1)):
        if other != beam and not np.isnan(ranges[other]):
            low, high = min(low, ranges[other]), max(high, ranges[other])
    for value in seen:
        if not np.isnan(value):
            low, high = min(low, value), max(high, value)
    density = _SPURIOUS_FRACTION / farthest
    low, high = low - _SMEAR_SIGMA * sigma, high + _SMEAR_SIGMA * sigma
    if low <= ranges[beam] <= high:
        density += (1.0 - _SPURIOUS_FRACTION) / (high - low)
    return density


@compiled()
def _density_from_side(
    ranges: FloatArray,
    by_camera: FloatArray,
    beam: int,
    direction: int,
    variance: float,
    slope: float,
) -> float:
    """Density of a beam's value if it lies on the surface of its neighbour; NaN without one.

    The surface goes on from the neighbour as the camera sees it, or as it came from the beam beyond
    the neighbour (a straight wall's inverse range is linear in the angle).
    """
    own = ranges[beam]
    near = far = 0
    for step in range(1, _BEAMS_BESIDE + 3):
        other = beam + direction * step
        if other < 0 or other >= ranges.size or np.isnan(ranges[other]):
            continue
        if near == 0 and step <= _BEAMS_BESIDE:
            near = step
        elif near > 0 and step <= near + 2:
            far = step
            break
    if near == 0:
        return np.nan
    neighbour = ranges[beam + direction * near]
    density: float = 0.0
    slant = by_camera[beam] - by_camera[beam + direction * near]
    if abs(slant) <= _EDGE_SLOPE * own * near:
        density = _normal(own - neighbour - slant, 2.0 * variance)
    else:
        # Not seen, or seen to end here.
        density = _normal(own - neighbour, 2.0 * variance + (slope * own * near) ** 2)
    if far == 0:
        return density
    inverse = 1.0 / neighbour
    inverse += (inverse - 1.0 / ranges[beam + direction * far]) * near / (far - near)
    if inverse <= 0.0:
        return density
    extrapolated: float = _normal(own - 1.0 / inverse, 2.0 * variance)
    return 0.5 * (density + extrapolated)
