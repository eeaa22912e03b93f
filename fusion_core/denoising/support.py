"""Support of a beam or a pixel: neighbours on the same surface, in space and in time."""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import Float32Array, FloatArray, IntArray

# A beam can be a mixed pixel of an edge that the camera sees within this many beams.
_EDGE_BEAMS = 2
# How far a mixed pixel lies from both sides of such an edge, as a fraction of the tolerance of
# support: less than without a camera, since the edge is seen and not inferred. Set by hand.
_OFF_EDGE_FRACTION = 0.7
# Seen by the camera, a surface that changes its range faster from beam to beam is an edge: 80
# degrees off the beam at a quarter of a degree a beam.
_EDGE_SLOPE = 0.03
# A robot at 0.5 m/s comes this much nearer between two scans at 10 Hz.
_APPROACH_M = 0.05
# Set by hand: a depth camera's noise at close range, with a margin.
_PIXEL_FLOOR_M = 0.03


@compiled()
def count_beam_support(
    ranges: FloatArray,
    in_time: FloatArray,
    shifts: IntArray,
    beams: IntArray,
    camera: FloatArray,
    floor_m: float,
    fraction: float,
    slope: float,
) -> tuple[IntArray, IntArray]:
    """(B, 3) supporters of each of B ``beams`` among adjacent beams, beams two and three away, and
    the scans before and after; (B, 2) how many neighbours in the scan and in time had a value.

    ``ranges``: (N,) of the scan. ``in_time``: (2, N) of the scans before and after, in which what
    beam b meets is met by b + ``shifts``. ``camera``: (B,) range at which the camera sees what a
    beam meets. Metres, NaN where missing. Values differ by at most the tolerance
    hypot(``floor_m``, ``fraction`` * range), plus ``slope`` * range a beam where the camera sees
    nothing.
    """
    support = np.zeros((beams.size, 3), dtype=np.int64)
    neighbours = np.zeros((beams.size, 2), dtype=np.int64)
    count = ranges.size
    seen_by_camera = np.full(count, np.nan)
    seen_by_camera[beams] = camera
    for index in range(beams.size):
        beam = beams[index]
        own = ranges[beam]
        if np.isnan(own):
            continue
        tolerance = np.hypot(floor_m, fraction * own)
        for step in (-3, -2, -1, 1, 2, 3):
            other = beam + step
            if other < 0 or other >= count or np.isnan(ranges[other]):
                continue
            neighbours[index, 0] += 1
            slant = seen_by_camera[other] - seen_by_camera[beam]
            allowed = tolerance
            if np.isnan(slant):
                slant = 0.0
                allowed += slope * own * abs(step)
            elif abs(slant) > _EDGE_SLOPE * own * abs(step):
                # The camera sees an edge here: the beams are on one side of it or the other.
                slant = 0.0
            if abs(ranges[other] - own - slant) <= allowed:
                support[index, 0 if abs(step) == 1 else 1] += 1
        if _is_between_surfaces(ranges, beam, tolerance) or _is_between_seen_surfaces(
            seen_by_camera, beam, own, _OFF_EDGE_FRACTION * tolerance
        ):
            support[index, 0] = support[index, 1] = 0
        for neighbour in range(2):
            scan, shift = in_time[neighbour], shifts[neighbour]
            # The robot moves between scans: the surface may have come nearer by a little.
            allowed = tolerance + _APPROACH_M
            seen = False
            met = False
            for step in (-1, 0, 1):
                other = beam + shift + step
                if 0 <= other < count and not np.isnan(scan[other]):
                    seen = True
                    met = met or abs(scan[other] - own) <= allowed
            neighbours[index, 1] += seen
            support[index, 2] += met
    return support, neighbours


@compiled()
def _is_between_surfaces(ranges: FloatArray, beam: int, tolerance: float) -> bool:
    """Whether a beam, alone or with one like it beside it, steps from one surface to another.

    Mixed pixels do; a separate thin object is nearer than both surfaces.
    """
    for width in (1, 2):
        for first in range(beam - width + 1, beam + 1):
            left, right = first - 1, first + width
            if left < 0 or right >= ranges.size:
                continue
            low = min(ranges[left], ranges[right])
            high = max(ranges[left], ranges[right])
            inside = low == low and high == high
            for index in range(first, first + width):
                inside = inside and low + tolerance < ranges[index] < high - tolerance
            if inside:
                return True
    return False


@compiled()
def _is_between_seen_surfaces(seen: FloatArray, beam: int, own: float, tolerance: float) -> bool:
    """Whether the camera sees an edge at a beam whose range lies on neither of its sides."""
    low, high = np.inf, -np.inf
    for other in range(max(0, beam - _EDGE_BEAMS), min(seen.size, beam + _EDGE_BEAMS + 1)):
        if not np.isnan(seen[other]):
            if abs(seen[other] - own) <= tolerance:
                return False
            low = min(low, seen[other])
            high = max(high, seen[other])
    return low < own < high


@compiled()
def count_pixel_support(
    depth: Float32Array, rows: IntArray, columns: IntArray, fraction: float
) -> tuple[IntArray, IntArray]:
    """(B,) supporters among the 5 x 5 pixels around each of B, within 3 cm plus ``fraction`` of its
    depth; and (B,) how many of those pixels have a value.

    ``depth``: (H, W) metres, NaN where missing. ``rows``: (B,), below 0 where there is no pixel.
    """
    height, width = depth.shape
    support = np.zeros(rows.size, dtype=np.int64)
    neighbours = np.zeros(rows.size, dtype=np.int64)
    for index in range(rows.size):
        row, column = rows[index], columns[index]
        if row < 0 or np.isnan(depth[row, column]):
            continue
        own = depth[row, column]
        for other_row in range(max(0, row - 2), min(height, row + 3)):
            for other_column in range(max(0, column - 2), min(width, column + 3)):
                if other_row == row and other_column == column:
                    continue
                other = depth[other_row, other_column]
                if np.isnan(other):
                    continue
                neighbours[index] += 1
                if abs(other - own) <= _PIXEL_FLOOR_M + fraction * own:
                    support[index] += 1
    return support, neighbours
