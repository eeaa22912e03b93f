"""A scan as the LiDAR would have taken it from another place nearby."""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray, read_only, wrap_angle
from fusion_core.model.planar_poses import invert_pose, transform_planar_points
from fusion_core.model.polar import points_from_polar
from fusion_core.model.sensors import LaserScan


@dataclass(frozen=True, slots=True, kw_only=True)
class MovedScan:
    """What a scan tells of the directions of its N beams, seen from another place.

    ``ranges_m``: (N,) from there, NaN where nothing returned. ``looked``: (N,) whether a beam went
    there at all, with a return or without: not beyond the ends of the scan, nor beside a return
    that hid what is now in sight.
    """

    ranges_m: FloatArray
    looked: BoolArray

    def __post_init__(self) -> None:
        read_only(self.ranges_m)
        read_only(self.looked)


def move_scan(scan: LaserScan, pose: FloatArray, same_surface_m: float) -> MovedScan:
    """See what ``scan`` returned from ``pose``, (3,) in the frame of the scan.

    Between returns of neighbouring beams that differ by at most ``same_surface_m`` lies a surface;
    any other is a point, and lies in the beam nearest to its direction. Where two are in one
    direction, the nearer is seen.
    """
    azimuth_rad, beam = scan.angles_rad, np.arange(scan.ranges_m.size)
    points_m = points_from_polar(scan.ranges_m, azimuth_rad)
    seen_m = transform_planar_points(invert_pose(pose), points_m)
    ranges_m = np.hypot(seen_m[:, 0], seen_m[:, 1])
    returned = np.isfinite(ranges_m)
    if not returned.any():
        return MovedScan(ranges_m=ranges_m, looked=returned)
    away_rad = wrap_angle(np.arctan2(seen_m[:, 1], seen_m[:, 0]) - azimuth_rad)
    # A lost beam goes where those beside it go.
    circle = beam.size if scan.is_full_circle else None
    away_rad = np.interp(beam, beam[returned], away_rad[returned], period=circle)
    in_beams, looked = _lay_into_beams(
        beam + away_rad / scan.angle_increment_rad, ranges_m, scan.is_full_circle, same_surface_m
    )
    return MovedScan(ranges_m=in_beams, looked=looked)


@compiled()
def _lay_into_beams(
    places: FloatArray, ranges: FloatArray, is_full_circle: bool, same_surface: float
) -> tuple[FloatArray, BoolArray]:
    """(N,) and (N,), as in MovedScan, of N beams that now look at ``places``, counted in beams, and
    meet something at ``ranges``, NaN where lost."""
    beams = places.size
    in_beams = np.full(beams, np.nan)
    looked = np.zeros(beams, dtype=np.bool_)
    joined = np.zeros(beams, dtype=np.bool_)
    for beam in range(beams if is_full_circle else beams - 1):
        after = (beam + 1) % beams
        place, place_after = places[beam], places[after] + (beams if after == 0 else 0)
        own, own_after = ranges[beam], ranges[after]
        lost = np.isnan(own) or np.isnan(own_after)
        joined[beam] = abs(own_after - own) <= same_surface and place_after > place
        if not (lost or joined[beam]):
            continue
        for between in range(int(np.ceil(place)), int(np.floor(place_after)) + 1):
            target = between % beams if is_full_circle else between
            if not 0 <= target < beams:
                continue
            looked[target] = True
            if joined[beam]:
                fraction = (between - place) / (place_after - place)
                _keep_nearer(in_beams, target, own + fraction * (own_after - own))
    for beam in range(beams):
        nearest = int(np.rint(places[beam]))
        target = nearest % beams if is_full_circle else nearest
        if not 0 <= target < beams:
            continue
        looked[target] = True
        # Of the last beam of a scan with ends, which joined none, the first one's is asked.
        if not joined[beam - 1 if nearest < places[beam] else beam]:
            _keep_nearer(in_beams, target, ranges[beam])
    return in_beams, looked


@compiled()
def _keep_nearer(values: FloatArray, place: int, value: float) -> None:
    if value < values[place] or np.isnan(values[place]):
        values[place] = value
