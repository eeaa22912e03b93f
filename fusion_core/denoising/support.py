"""Support of a beam or a pixel: neighbours on the same surface, in space and in time."""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray

# Seen by the camera, a surface that changes its range faster from beam to beam is an edge: 80
# degrees off the beam at a quarter of a degree a beam.
_EDGE_SLOPE = 0.03

# Set by hand: a depth camera's noise at close range, with a margin.
_PIXEL_FLOOR_M = 0.03


@compiled()
def spread_over_scan(values: FloatArray, beams: IntArray, count: int) -> FloatArray:
    """(``count``,) the ``values`` of B ``beams`` at their places in the scan, NaN at the others."""
    spread = np.full(count, np.nan)
    # Each by itself: numba compiles the error message of an assignment to all for seconds.
    for index in range(beams.size):
        spread[beams[index]] = values[index]
    return spread


@compiled()
def count_beam_support(
    ranges: FloatArray,
    in_time: FloatArray,
    beams: IntArray,
    camera: FloatArray,
    floor_m: float,
    fraction: float,
    slope: float,
) -> tuple[IntArray, IntArray]:
    """(B, 3) supporters of each of B ``beams`` among adjacent beams, beams two and three away, and
    the scans before and after; (B, 2) how many neighbours in the scan and in time had a value.

    ``ranges``: (N,) of the scan. ``in_time``: (2, N) of the scans before and after, as seen from
    its place. ``camera``: (B,) range at which the camera sees what a beam meets. Metres, NaN where
    missing. Values differ by at most the tolerance hypot(``floor_m``, ``fraction`` * range), plus
    ``slope`` * range a beam where the camera sees nothing.
    """
    support = np.zeros((beams.size, 3), dtype=np.int64)
    neighbours = np.zeros((beams.size, 2), dtype=np.int64)
    count = ranges.size
    seen_by_camera = spread_over_scan(camera, beams, count)
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
        for scan in in_time:
            seen = False
            met = False
            for step in (-1, 0, 1):
                other = beam + step
                if 0 <= other < count and not np.isnan(scan[other]):
                    seen = True
                    met = met or abs(scan[other] - own) <= tolerance
            neighbours[index, 1] += seen
            support[index, 2] += met
    return support, neighbours


@compiled()
def find_measured_pixels(
    as_range: FloatArray,
    tolerance: FloatArray,
    beams: IntArray,
    ranges: FloatArray,
    in_time: FloatArray,
) -> BoolArray:
    """(B,) pixels whose surface a beam near B ``beams``, other than their own, has measured too.

    ``as_range``: (B,) the pixels' depths as ranges; beams of the scan up to three away, and of the
    scans before and after those adjacent to the same direction, agree within ``tolerance`` (B,).
    ``ranges``, ``in_time``: as for ``count_beam_support``.
    """
    measured = np.zeros(beams.size, dtype=np.bool_)
    for index in range(beams.size):
        for step in range(-3, 4):
            other = beams[index] + step
            if not 0 <= other < ranges.size:
                continue
            if step != 0:
                off = abs(ranges[other] - as_range[index])
                measured[index] |= off <= tolerance[index]
            if abs(step) <= 1:
                for scan in in_time:
                    off = abs(scan[other] - as_range[index])
                    measured[index] |= off <= tolerance[index]
    return measured


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
