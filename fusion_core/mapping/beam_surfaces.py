"""The surfaces that a cloud shows in the angle of each beam: the nearest, and those behind it.

A cloud is (N, 3): x and y in the scan's frame, height above the floor.
"""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray
from fusion_core.model.sensors import LaserScan

# Surfaces in one direction behind the nearest: under a seat the far edge, then the wall.
_SURFACES_BEHIND = 2
# Two cells of the usual map: in a narrower gap it shows no free cell.
_GAP_M = 0.1


def nearest_surfaces(
    points_m: FloatArray,
    angle_min_rad: float,
    angle_increment_rad: float,
    beams: int,
    *,
    half_width_m: float = 0.0,
    thickness_m: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """(beams,) distance of the nearest of (N, 3) points in each beam's angle, and (beams, 2) the
    lowest and the highest point of its surface; NaN without any.

    A point counts for the beam nearest to its azimuth and, being ``half_width_m`` wide to either
    side, for those within. ``thickness_m``: (N,) how far behind the nearest a point may lie to be
    of the same surface, whose mean distance is then taken.
    """
    ranges_m = np.hypot(points_m[:, 0], points_m[:, 1])
    after_first_rad = _angles_after_first(points_m, angle_min_rad, angle_increment_rad)
    sums_m, counts, lowest_m, highest_m = _nearest_per_angle(
        ranges_m,
        np.ascontiguousarray(points_m[:, 2]),
        after_first_rad,
        abs(angle_increment_rad),
        beams,
        half_width_m,
        np.zeros(ranges_m.size) if thickness_m is None else thickness_m,
    )
    return _means_m(sums_m, counts), np.stack([lowest_m, highest_m], axis=1)


@compiled(error_model="numpy")
def _nearest_per_angle(
    ranges_m: FloatArray,
    heights_m: FloatArray,
    after_first_rad: FloatArray,
    step_rad: float,
    beams: int,
    half_width_m: float,
    thickness_m: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Sum and number of the ranges of each beam's surface, and its lowest and highest point."""
    nearest_m = np.full(beams, np.inf)
    lowest_m = np.full(beams, np.nan)
    highest_m = np.full(beams, np.nan)
    sums_m = np.zeros(beams)
    counts = np.zeros(beams)
    turn = 2.0 * np.pi / step_rad
    # First the nearest of each beam, then the mean of what lies just behind it.
    for averaging in (False, True):
        for i in range(ranges_m.size):
            if not ranges_m[i] > 0.0:
                continue
            half = np.arctan(half_width_m / ranges_m[i]) / step_rad
            # Angles repeat after a full turn: past the last beam lies the first.
            for turns in (-1.0, 0.0, 1.0):
                middle = after_first_rad[i] / step_rad + turns * turn
                own = np.rint(middle)
                first = max(min(np.ceil(middle - half), own), 0.0)
                last = min(max(np.floor(middle + half), own), beams - 1.0)
                for beam in range(int(first), int(last) + 1):
                    if not averaging:
                        nearest_m[beam] = min(nearest_m[beam], ranges_m[i])
                    elif ranges_m[i] <= nearest_m[beam] + thickness_m[i]:
                        sums_m[beam] += ranges_m[i]
                        counts[beam] += 1.0
                        # A NaN compares false both ways.
                        if not lowest_m[beam] <= heights_m[i]:
                            lowest_m[beam] = heights_m[i]
                        if not highest_m[beam] >= heights_m[i]:
                            highest_m[beam] = heights_m[i]
    return sums_m, counts, lowest_m, highest_m


def surfaces_behind(
    cloud_m: FloatArray, scan: LaserScan, thickness_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(K, N) ranges and (K, N, 2) heights of the next surfaces behind those that end the beams.

    ``thickness_m``: (N,) as in ``nearest_surfaces``. A camera looks over a low box, and below a
    seat: one range for an angle would lose what it sees there. What follows without a gap of
    ``_GAP_M`` belongs to the surface before: the top of a box.
    """
    reached_m = np.hypot(cloud_m[:, 0], cloud_m[:, 1])
    after_first_rad = _angles_after_first(cloud_m, scan.angle_min_rad, scan.angle_increment_rad)
    order = np.argsort(reached_m, kind="stable")
    sums_m, counts, lowest_m, highest_m = _find_behind(
        reached_m[order],
        np.ascontiguousarray(cloud_m[order, 2]),
        after_first_rad[order],
        abs(scan.angle_increment_rad),
        scan.ranges_m,
        thickness_m[order],
        scan.range_max_m,
    )
    return _means_m(sums_m, counts), np.stack([lowest_m, highest_m], axis=2)


def _means_m(sums_m: FloatArray, counts: FloatArray) -> FloatArray:
    """NaN where nothing was counted."""
    return np.divide(sums_m, counts, out=np.full_like(sums_m, np.nan), where=counts > 0.0)


def _angles_after_first(
    points_m: FloatArray, angle_min_rad: float, angle_increment_rad: float
) -> FloatArray:
    """(N,) azimuths from the first beam on, in the direction of increasing beam index."""
    azimuths_rad = np.arctan2(points_m[:, 1], points_m[:, 0])
    direction = 1.0 if angle_increment_rad > 0.0 else -1.0
    after_first_rad: FloatArray = np.mod(direction * (azimuths_rad - angle_min_rad), 2.0 * np.pi)
    return after_first_rad


@compiled(error_model="numpy")
def _find_behind(
    ranges_m: FloatArray,
    heights_m: FloatArray,
    after_first_rad: FloatArray,
    step_rad: float,
    ends_m: FloatArray,
    thickness_m: FloatArray,
    range_max_m: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """``surfaces_behind`` of points in the order of their ranges, each of the nearest beam: sums
    and numbers of the ranges, lowest and highest points."""
    beams = ends_m.size
    shape = (_SURFACES_BEHIND, beams)
    nearest_m = np.full(shape, np.nan)
    lowest_m = np.full(shape, np.nan)
    highest_m = np.full(shape, np.nan)
    sums_m = np.zeros(shape)
    counts = np.zeros(shape)
    number = np.full(beams, -1)
    last_m = ends_m.copy()
    turn = 2.0 * np.pi / step_rad
    for i in range(ranges_m.size):
        beam = int(np.rint(np.mod(after_first_rad[i] / step_rad, turn)))
        if beam >= beams:
            # Angles repeat after a full turn: past the last beam lies the first.
            beam = 0 if beam - turn > -0.5 else beams
        if beam >= beams or ranges_m[i] > range_max_m:
            continue
        # A beam that nothing has ended begins with its first surface. A NaN compares false.
        if not ranges_m[i] <= last_m[beam] + _GAP_M:
            number[beam] += 1
            if number[beam] < _SURFACES_BEHIND:
                nearest_m[number[beam], beam] = ranges_m[i]
        last_m[beam] = np.fmax(last_m[beam], ranges_m[i])
        own = number[beam]
        if own < 0 or own >= _SURFACES_BEHIND:
            continue
        if ranges_m[i] <= nearest_m[own, beam] + thickness_m[i]:
            sums_m[own, beam] += ranges_m[i]
            counts[own, beam] += 1.0
            if not lowest_m[own, beam] <= heights_m[i]:
                lowest_m[own, beam] = heights_m[i]
            if not highest_m[own, beam] >= heights_m[i]:
                highest_m[own, beam] = heights_m[i]
    return sums_m, counts, lowest_m, highest_m
