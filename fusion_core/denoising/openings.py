"""Openings between the walls that the LiDAR measures in scan after scan: what may stand in them.

A pane, a dark and a sunlit surface lose most beams, and few scans tell them apart about one beam.
Over the whole opening they do: what returns from the straight line between the walls, oftener than
a pane lets a beam pass to something behind it, is a surface in that line.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.denoising.nearby_returns import NearbyReturns
from fusion_core.denoising.neighbourhood import FrameWindow, scans_about
from fusion_core.denoising.surfaces import interpolate_gaps
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only

# The outermost beams of an opening may have met what is beside it: the motion between scans is
# known to a fraction of a beam, and a mixed pixel covers two.
_BEAMS_OF_SIDE = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Openings:
    """Of each of a scan's N beams, what stands about the opening that it goes through.

    ``across_m``: (N,) range of the straight line between the walls on either side, NaN where these
    are no straight surface, and outside of any opening. ``wall_m``: the same, or the farther of the
    two sides where there is no line; NaN where a side is missing.
    """

    across_m: FloatArray
    wall_m: FloatArray

    def __post_init__(self) -> None:
        read_only(self.across_m)
        read_only(self.wall_m)


def find_openings(
    window: FrameWindow, nearby: NearbyReturns, tolerance_m: FloatArray, least: float, edge_m: float
) -> Openings:
    """The openings between beams that last: those whose ranges, to within (N,) tolerances, at least
    the fraction ``least`` of the beams about them in the scans before and after returned.

    ``nearby``: of every beam of the scan.
    """
    scan = window.scan
    lasts = nearby.returned_fraction >= least
    lasts &= nearby.confirmed_fraction(scan.ranges_m, tolerance_m) >= least
    sides_m = np.where(lasts, scan.ranges_m, np.nan)
    across_m, _ = interpolate_gaps(scan.angles_rad, sides_m, np.isfinite(sides_m), edge_m)
    return Openings(
        across_m=across_m,
        wall_m=np.where(np.isfinite(across_m), across_m, _farther_side_m(sides_m)),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ReturnsInOpening:
    """(N, 3) counts about each of a scan's beams, in the scan before, the scan and the one after:
    beams that looked through an opening, those that returned, and those that did from the line
    across it."""

    looked: IntArray
    returned: IntArray
    on_line: IntArray

    def __post_init__(self) -> None:
        for array in (self.looked, self.returned, self.on_line):
            read_only(array)

    def about(self, beam: IntArray) -> "ReturnsInOpening":
        """Those of some of the beams."""
        return ReturnsInOpening(
            looked=self.looked[beam], returned=self.returned[beam], on_line=self.on_line[beam]
        )

    def is_surface(self, passed: float, doubt: float, least: float) -> BoolArray:
        """(N,): whether a surface stands in the line across the opening.

        So many returns would come through a pane before that surface with a probability of at most
        ``doubt`` (the tail of the binomial distribution), if it lets a beam pass with probability
        ``passed``. At least the fraction ``least`` of all returns are of the line, and some in each
        of the scans before and after: where the robot moves, the wall beside the opening enters it
        in one of them.
        """
        from scipy.special import bdtrc

        looked, returned = self.looked.sum(axis=1), self.returned.sum(axis=1)
        on_line = self.on_line.sum(axis=1)
        surface: BoolArray = bdtrc(on_line - 1.0, looked, passed) <= doubt
        surface &= on_line >= least * returned
        surface &= (self.on_line[:, 0] > 0) & (self.on_line[:, 2] > 0)
        return surface


def returns_in_openings(
    window: FrameWindow, across_m: FloatArray, tolerance_m: FloatArray, reach_rad: float
) -> ReturnsInOpening:
    """Count the returns in openings about each beam, up to ``reach_rad`` to either side.

    ``across_m``, ``tolerance_m``: (N,), as in Openings.
    """
    of_beam = _returns_of_beams(*scans_about(window), across_m, tolerance_m)
    # One more beam at the front, so that a difference of two sums is the number between them.
    upto = np.zeros((3, across_m.size + 1, 3), dtype=np.int64)
    np.cumsum(of_beam, axis=1, out=upto[:, 1:])
    reach = int(reach_rad / abs(window.scan.angle_increment_rad))
    beam = np.arange(across_m.size)
    first, last = np.maximum(beam - reach, 0), np.minimum(beam + reach + 1, beam.size)
    looked, returned, on_line = upto[:, last] - upto[:, first]
    return ReturnsInOpening(looked=looked, returned=returned, on_line=on_line)


@compiled()
def _returns_of_beams(
    ranges_m: FloatArray,
    looks: BoolArray,
    across_m: FloatArray,
    tolerance_m: FloatArray,
) -> IntArray:
    """(3, N, 3) what each beam adds to the counts of ReturnsInOpening, 0 or 1: whether it looked,
    returned and did so from the line. ``ranges_m``, ``looks``: (3, N)."""
    count = across_m.size
    of_beam = np.zeros((3, count, 3), dtype=np.int64)
    for beam in range(count):
        within = _BEAMS_OF_SIDE <= beam < count - _BEAMS_OF_SIDE
        for other in range(beam - _BEAMS_OF_SIDE, beam + _BEAMS_OF_SIDE + 1):
            within = within and np.isfinite(across_m[other])
        if not within:
            continue
        for place in range(3):
            if not looks[place, beam]:
                continue
            range_m = ranges_m[place, beam]
            of_beam[0, beam, place] = 1
            of_beam[1, beam, place] = np.isfinite(range_m)
            of_beam[2, beam, place] = abs(range_m - across_m[beam]) <= tolerance_m[beam]
    return of_beam


def _farther_side_m(range_m: FloatArray) -> FloatArray:
    """(N,) the farther of the nearest ranges on either side of each beam, NaN at an open end."""
    index = np.arange(range_m.size)
    known = np.isfinite(range_m)
    before = np.maximum.accumulate(np.where(known, index, -1))
    after = np.minimum.accumulate(np.where(known, index, range_m.size)[::-1])[::-1]
    ends_m = np.append(range_m, np.nan)
    # Beyond either end of the scan, both numbers stand for the value that was appended.
    farther: FloatArray = np.maximum(ends_m[before], ends_m[after])
    return farther
