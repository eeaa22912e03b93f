"""A scan's points, and points between neighbours on a wall."""

import numpy as np

from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.sensors import LaserScan

# Two neighbours are on one wall unless the beams would meet it at less than 20 degrees (1 / tan),
# or a beam or more is missing between them: the widest increment of common LiDARs is 1 degree.
_SLANT_MAX = 3.0
_BEAM_GAP_MAX_RAD = np.radians(2.5)


def scan_points(scan: LaserScan, max_range_m: float, beams_max: int) -> FloatArray:
    """(n, 2) points nearer than ``max_range_m``, of at most ``beams_max`` beams, evenly spread."""
    stride = -(-scan.ranges_m.size // beams_max)
    ranges_m, angles_rad = scan.ranges_m[::stride], scan.angles_rad[::stride]
    # NaN compares false.
    used = (ranges_m > 0.0) & (ranges_m < max_range_m)
    ranges_m, angles_rad = ranges_m[used], angles_rad[used]
    return np.stack([ranges_m * np.cos(angles_rad), ranges_m * np.sin(angles_rad)], axis=1)


def densified_points(points_m: FloatArray, resolution_m: float) -> FloatArray:
    """(n', 2) the points and, at most ``resolution_m`` apart, others between neighbours on a wall.

    Without them a wall is a row of dots, to which the next scan's points would be attracted.
    """
    if points_m.shape[0] < 2:
        return points_m
    step_m = np.diff(points_m, axis=0)
    gap_m = np.hypot(*step_m.T)
    range_m = np.hypot(*points_m.T)
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
    turn = np.abs(wrap_angle(np.diff(azimuth)))
    nearest_m = np.minimum(range_m[:-1], range_m[1:])
    is_wall = (gap_m < _SLANT_MAX * nearest_m * turn) & (turn < _BEAM_GAP_MAX_RAD)
    pieces = np.ceil(gap_m / resolution_m).astype(np.int64)
    pieces[~is_wall] = 1
    first = np.repeat(np.arange(pieces.size), pieces)
    part = np.arange(first.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    between = points_m[first] + (part / pieces[first])[:, np.newaxis] * step_m[first]
    return np.concatenate([between, points_m[-1:]])
