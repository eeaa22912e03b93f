"""A scan's points, and points between neighbours on a wall."""

import numpy as np

from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.polar import points_from_polar
from fusion_core.model.sensors import LaserScan

# Two neighbours are taken as one wall if the beams meet it at more than 18 degrees (1 / tan) and
# the angle between them is small: at most one missing beam at an increment of 1 degree. Set by
# hand.
_SLANT_MAX = 3.0
_BEAM_GAP_MAX_RAD = np.radians(2.5)


def scan_points(scan: LaserScan, max_range_m: float, beams_max: int) -> FloatArray:
    """(n, 2) points nearer than ``max_range_m``, of at most ``beams_max`` beams, evenly spread."""
    stride = -(-scan.ranges_m.size // beams_max)
    ranges_m, angles_rad = scan.ranges_m[::stride], scan.angles_rad[::stride]
    # NaN compares false.
    used = (ranges_m > 0.0) & (ranges_m < max_range_m)
    ranges_m, angles_rad = ranges_m[used], angles_rad[used]
    return points_from_polar(ranges_m, angles_rad)


def densified_points(points_m: FloatArray, resolution_m: float) -> FloatArray:
    """(n', 2) the points and, at steps of at most ``resolution_m``, others between them on walls.

    Without them a wall is a row of dots that attracts the next scan's points.
    """
    if points_m.shape[0] < 2:
        return points_m
    step_m = np.diff(points_m, axis=0)
    gap_m = np.hypot(*step_m.T)
    range_m = np.hypot(*points_m.T)
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
    angle = np.abs(wrap_angle(np.diff(azimuth)))
    nearest_m = np.minimum(range_m[:-1], range_m[1:])
    is_wall = (gap_m < _SLANT_MAX * nearest_m * angle) & (angle < _BEAM_GAP_MAX_RAD)
    pieces = np.ceil(gap_m / resolution_m).astype(np.int64)
    pieces[~is_wall] = 1
    first = np.repeat(np.arange(pieces.size), pieces)
    number = np.arange(first.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    between = points_m[first] + (number / pieces[first])[:, np.newaxis] * step_m[first]
    return np.concatenate([between, points_m[-1:]])
