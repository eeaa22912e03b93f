"""Stamps of streams: outliers by the order and times of the log, and those around an instant."""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fusion_core.model.conventions import BoolArray, IntArray

NO_STAMP = int(np.iinfo(np.int64).min)
"""Placeholder for the stamp of a message that cannot be read."""


def plausible_stamps(
    stamps_ns: IntArray, received_ns: IntArray, *, strictly: bool = True
) -> BoolArray:
    """(N,) which messages to keep: those that are in order, and stamped within the recording.

    ``stamps_ns``, ``received_ns``: (N,) in the order of the log. ``strictly``: of equal stamps only
    the first is kept. A message with NO_STAMP is always kept.
    """
    kept = np.ones(stamps_ns.size, dtype=np.bool_)
    known = np.flatnonzero(stamps_ns != NO_STAMP)
    kept[known] = within_recording(stamps_ns[known], received_ns[known])
    # First outliers, then order: else an outlier near the end could be kept in place of its
    # successor.
    near = known[kept[known]]
    kept[near] = longest_ascending(stamps_ns[near], strictly=strictly)
    return kept


def longest_ascending(stamps_ns: IntArray, *, strictly: bool = True) -> BoolArray:
    """(N,) the longest subsequence of (N,) stamps that ascends; of several the one whose members
    come first.

    An outlier removes only itself: a stamp far ahead does not make those after it late. O(N log N),
    by patience sorting (Schensted 1961).
    """
    steps = np.diff(stamps_ns)
    if np.all(steps > 0) or (not strictly and np.all(steps >= 0)):
        return np.ones(stamps_ns.size, dtype=np.bool_)
    place = bisect_left if strictly else bisect_right
    values = stamps_ns.tolist()
    # From the end, negated: the longest subsequence that begins with each stamp.
    tails: list[int] = []
    lengths = []
    for value in reversed(values):
        length = place(tails, -value)
        tails[length : length + 1] = [-value]
        lengths.append(length + 1)
    kept = np.zeros(stamps_ns.size, dtype=np.bool_)
    left, last = len(tails), None
    for index, (value, length) in enumerate(zip(values, reversed(lengths), strict=True)):
        follows = last is None or value > last or (not strictly and value == last)
        if length == left and follows:
            kept[index] = True
            left, last = left - 1, value
    return kept


def within_recording(stamps_ns: IntArray, received_ns: IntArray) -> BoolArray:
    """(N,) whether a stamp is connected with the middle half of (N,) stamps, given in any order.

    Sorted neighbours are not connected where their stamps differ by more than the duration of the
    recording (twice that of the middle half), beyond the time between them in the log
    (``received_ns``: a recording may pause). A log with one time for all messages is not used.
    """
    kept = np.ones(stamps_ns.size, dtype=np.bool_)
    if stamps_ns.size == 0 or np.ptp(received_ns) == 0:
        return kept
    order = np.argsort(stamps_ns, kind="stable")
    sorted_ns = stamps_ns[order]
    first, last = stamps_ns.size // 4, stamps_ns.size - 1 - stamps_ns.size // 4
    duration_ns = 2 * int(sorted_ns[last] - sorted_ns[first])
    if duration_ns == 0:
        return kept
    logged_ns = np.maximum(np.diff(received_ns[order]), 0)
    split = np.flatnonzero(np.diff(sorted_ns) - logged_ns > duration_ns)
    before, after = split[split < first], split[split >= last]
    if before.size:
        kept[order[: before[-1] + 1]] = False
    if after.size:
        kept[order[after[0] + 1 :]] = False
    return kept


def nearest_stamp(stamps_ns: Sequence[int], stamp_ns: int, max_gap_ns: float) -> int | None:
    """Index of the stamp nearest to an instant, of two equally near ones the earlier.

    ``stamps_ns`` ascend. None where there is none within ``max_gap_ns``.
    """
    after = bisect_left(stamps_ns, stamp_ns)
    nearest = None
    for index in (after - 1, after):
        if 0 <= index < len(stamps_ns):
            gap_ns = abs(stamps_ns[index] - stamp_ns)
            if gap_ns <= max_gap_ns and (nearest is None or gap_ns < nearest[0]):
                nearest = gap_ns, index
    return None if nearest is None else nearest[1]


def nearest_stamps(stamps_ns: IntArray, at_ns: IntArray) -> IntArray:
    """(M,) for each of (M,) instants the index of the nearest of (N,) stamps, N >= 1.

    As ``nearest_stamp``: ``stamps_ns`` ascend, and of two equally near ones it is the earlier.
    """
    after = np.clip(np.searchsorted(stamps_ns, at_ns), 1, max(stamps_ns.size - 1, 1))
    before = after - 1
    after = np.minimum(after, stamps_ns.size - 1)
    is_before = np.abs(at_ns - stamps_ns[before]) <= np.abs(at_ns - stamps_ns[after])
    return np.where(is_before, before, after)


class StampNeighbours(NamedTuple):
    """Indices of the stamps before and after an instant; at a stamp both are its own.

    ``fraction``: of the gap between the two that lies before the instant, in [0, 1).
    """

    before: int
    after: int
    gap_ns: int
    fraction: float


def find_neighbours(stamps_ns: IntArray, stamp_ns: int) -> StampNeighbours | None:
    """The neighbours of an instant among (N,) strictly increasing stamps; None outside of them."""
    after = int(np.searchsorted(stamps_ns, stamp_ns))
    if after == stamps_ns.size:
        return None
    after_ns = int(stamps_ns[after])
    if after_ns == stamp_ns:
        return StampNeighbours(after, after, 0, 0.0)
    if after == 0:
        return None
    before_ns = int(stamps_ns[after - 1])
    gap_ns = after_ns - before_ns
    return StampNeighbours(after - 1, after, gap_ns, (stamp_ns - before_ns) / gap_ns)
