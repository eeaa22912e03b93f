"""What the LiDAR saw about a beam's direction: adjacent beams, and the scans before and after.

A value that fills a beam is a claim that all before it is free. It is refused where any of these
returns is nearer. A line across a gap is believed where the scans before and after mostly returned
it in that direction: beams that are lost by chance come back in the next scan.

Those on glass, on a dark or a sunlit surface do not, and then nothing is known of what the gap
hides, unless more of them return the line than a pane would let pass (``openings``).
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.denoising.neighbourhood import FrameWindow, scans_about
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only

# The motion between scans is known to a fraction of a beam, and a mixed pixel covers two.
_BEAMS_BESIDE = 1
# As far as beams support each other when they are classified.
_BEAMS_ABOUT = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class NearbyReturns:
    """Ranges (m) about the directions of B beams, NaN where nothing returned.

    ``beside_m``: (B, 2), the adjacent beams of the scan. ``in_time_m``: (B, 2, 3), the beam and
    those adjacent to it in the scans before and after, as seen from the scan's place.
    ``looked``: (B,) how many of those six beams there are, with a return or without.
    ``returned_fraction``: (B,) of the beams up to three away in the scans before and after, those
    with any return: few on glass, whatever they return from behind it.
    """

    beside_m: FloatArray
    in_time_m: FloatArray
    looked: IntArray
    returned_fraction: FloatArray

    def __post_init__(self) -> None:
        for array in (self.beside_m, self.in_time_m, self.looked, self.returned_fraction):
            read_only(array)

    def about(self, beam: IntArray) -> "NearbyReturns":
        """Those of some of the beams."""
        return NearbyReturns(
            beside_m=self.beside_m[beam],
            in_time_m=self.in_time_m[beam],
            looked=self.looked[beam],
            returned_fraction=self.returned_fraction[beam],
        )

    def any_before(self, range_m: FloatArray) -> BoolArray:
        """(B,): whether any return is nearer than (B,) ranges."""
        seen_m = np.hstack([self.beside_m, self.in_time_m[:, 0], self.in_time_m[:, 1]])
        before: BoolArray = np.any(seen_m < range_m[:, np.newaxis], axis=1)
        return before

    def any_beside_behind(self, range_m: FloatArray) -> BoolArray:
        """(B,): whether an adjacent beam of the scan itself returned from beyond (B,) ranges."""
        behind: BoolArray = np.any(self.beside_m > range_m[:, np.newaxis], axis=1)
        return behind

    def confirmed_fraction(self, range_m: FloatArray, tolerance_m: FloatArray) -> FloatArray:
        """(B,): the fraction of the beams looked at, in the scans before and after, that returned
        (B,) ranges to within (B,) tolerances; 0 where there is no such scan."""
        off_m = np.abs(self.in_time_m - range_m[:, np.newaxis, np.newaxis])
        agreeing = (off_m <= tolerance_m[:, np.newaxis, np.newaxis]).sum(axis=(1, 2))
        fraction: FloatArray = agreeing / np.maximum(self.looked, 1)
        return fraction

    def between_scans_m(self) -> FloatArray:
        """(B,): the mean of the ranges before and after, which takes out a steady approach; NaN
        where either scan has none."""
        before_m, after_m = _median_of_three(self.in_time_m).T
        mean: FloatArray = 0.5 * (before_m + after_m)
        return mean


def nearby_returns(window: FrameWindow) -> NearbyReturns:
    """Collect the returns about every beam of the window's scan."""
    beside_m, in_time_m, looked, looked_about, returned = _collect_returns(*scans_about(window))
    return NearbyReturns(
        beside_m=beside_m,
        in_time_m=in_time_m,
        looked=looked,
        returned_fraction=returned / np.maximum(looked_about, 1),
    )


@compiled()
def _collect_returns(
    ranges_m: FloatArray, looks: BoolArray
) -> tuple[FloatArray, FloatArray, IntArray, IntArray, IntArray]:
    """(N, 2) beside, (N, 2, 3) in time, and (N,) how many beams looked, how many of those up to
    three away, and how many of these returned. ``ranges_m``, ``looks``: (3, N)."""
    count = ranges_m.shape[1]
    beside_m, in_time_m = np.full((count, 2), np.nan), np.full((count, 2, 3), np.nan)
    looked = np.zeros(count, dtype=np.int64)
    looked_about, returned = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    for beam in range(count):
        if beam > 0:
            beside_m[beam, 0] = ranges_m[1, beam - 1]
        if beam < count - 1:
            beside_m[beam, 1] = ranges_m[1, beam + 1]
        for side in range(2):
            place = 2 * side
            for step in range(-_BEAMS_ABOUT, _BEAMS_ABOUT + 1):
                other = beam + step
                if not 0 <= other < count or not looks[place, other]:
                    continue
                looked_about[beam] += 1
                returned[beam] += np.isfinite(ranges_m[place, other])
                if abs(step) <= _BEAMS_BESIDE:
                    looked[beam] += 1
                    in_time_m[beam, side, step + _BEAMS_BESIDE] = ranges_m[place, other]
    return beside_m, in_time_m, looked, looked_about, returned


def _median_of_three(values: FloatArray) -> FloatArray:
    """(..., 3) to (...): the median of those that are not NaN, NaN where all are."""
    ordered = np.sort(values, axis=-1)  # NaN comes last.
    count = np.isfinite(values).sum(axis=-1)
    middle: FloatArray = np.where(
        count == 2, 0.5 * (ordered[..., 0] + ordered[..., 1]), ordered[..., 1]
    )
    return np.where(count <= 1, ordered[..., 0], middle)
