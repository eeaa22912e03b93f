"""Which returns of a scan other scans from known poses confirm.

A return through a pane, a second reflection or a flying pixel is not there in the next scan; as a
ray it would clear the cells of the surface before it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.model.polar import beams_towards, points_from_polar
from fusion_core.model.sensors import LaserScan

# Beams to either side of the one that points at a return, since its spot covers parts of them.
_BEAMS_BESIDE = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedScan:
    """A scan and the LiDAR's pose (x, y, yaw) in the map, (3,)."""

    pose: FloatArray
    scan: LaserScan


def confirmed_fraction(
    placed: PlacedScan, others: Sequence[PlacedScan], tolerance_m: FloatArray
) -> FloatArray:
    """(N,): of the beams of other scans that point at a return, those that returned it.

    Three beams of each other scan point at a return, and one that returned nothing counts, too.
    ``tolerance_m``: (N,) difference in range up to which it is the same return. 0 where no beam
    points at it, or there is no return.
    """
    scan = placed.scan
    ends_m = points_from_polar(scan.ranges_m, scan.angles_rad)
    in_map_m = transform_planar_points(placed.pose, ends_m)
    agreeing = np.zeros(scan.ranges_m.size, dtype=np.int64)
    looked = np.zeros(scan.ranges_m.size, dtype=np.int64)
    for other in others:
        x_m, y_m = (in_map_m - other.pose[:2]).T
        expected_m = np.hypot(x_m, y_m)
        seen = other.scan
        middle = beams_towards(
            np.arctan2(y_m, x_m) - other.pose[2],
            seen.angle_min_rad,
            seen.angle_increment_rad,
            seen.ranges_m.size,
        )
        for beside in range(-_BEAMS_BESIDE, _BEAMS_BESIDE + 1):
            beam = middle + beside
            exists = (middle >= 0) & (beam >= 0) & (beam < seen.ranges_m.size)
            range_m = np.where(exists, seen.ranges_m[np.where(exists, beam, 0)], np.nan)
            agreeing += np.abs(range_m - expected_m) <= tolerance_m
            looked += exists
    return agreeing / np.maximum(looked, 1)
