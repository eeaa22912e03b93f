"""Where frames lie along a time axis: each has a cell of its own, also where stamps are equal."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fusion_core.model.conventions import NS_PER_S, FloatArray, IntArray

# Images are missing where the time between two is so many times the usual one: one or two lost
# images are nobody's concern.
_GAP_PERIODS = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameTimes:
    """The frames' cells. ``left_s``, ``right_s``: (F,) their ends, increasing, in seconds after the
    first frame; between two cells lies a gap without images. ``times_s``: (F,) of the frames."""

    times_s: FloatArray
    left_s: FloatArray
    right_s: FloatArray

    @classmethod
    def of(cls, times_ns: IntArray) -> "FrameTimes":
        """The cells of frames by their times, (F,) in nanoseconds, in order; F >= 1."""
        times_s = (times_ns - times_ns[0]) / NS_PER_S
        distinct_s, first, count = np.unique(times_s, return_index=True, return_counts=True)
        steps_s = np.diff(distinct_s)
        period_s = float(np.median(steps_s)) if steps_s.size else 1.0
        half_s = np.minimum(0.5 * steps_s, 0.5 * _GAP_PERIODS * period_s)
        is_gap = steps_s > _GAP_PERIODS * period_s
        half_s[is_gap] = 0.5 * period_s
        left_s = distinct_s - np.concatenate([[0.5 * period_s], half_s])
        right_s = distinct_s + np.concatenate([half_s, [0.5 * period_s]])
        # Frames of one time share its cell.
        width_s = np.repeat((right_s - left_s) / count, count)
        place = np.arange(times_s.size) - np.repeat(first, count)
        own_left_s = np.repeat(left_s, count) + place * width_s
        return cls(times_s=times_s, left_s=own_left_s, right_s=own_left_s + width_s)

    @cached_property
    def middle_s(self) -> FloatArray:
        """(F,) the middles of the cells."""
        return 0.5 * (self.left_s + self.right_s)

    @property
    def limits_s(self) -> tuple[float, float]:
        """The first cell's left end, and the last one's right end."""
        return float(self.left_s[0]), float(self.right_s[-1])

    def frame_at(self, time_s: float) -> int:
        """The frame whose cell is nearest to a time."""
        index = int(np.searchsorted(self.left_s, time_s, side="right")) - 1
        index = min(max(index, 0), self.left_s.size - 1)
        if index + 1 < self.left_s.size:
            behind_s, before_s = time_s - self.right_s[index], self.left_s[index + 1] - time_s
            if behind_s > max(before_s, 0.0):
                return index + 1
        return index

    def is_gap(self, time_s: float) -> bool:
        """Whether a time lies between two cells, where images are missing."""
        index = int(np.searchsorted(self.left_s, time_s, side="right")) - 1
        return bool(
            0 <= index < self.left_s.size - 1
            and self.right_s[index] < time_s < self.left_s[index + 1]
            and self.left_s[index + 1] - self.right_s[index] > 0.5 * self._cell_s
        )

    @cached_property
    def _cell_s(self) -> float:
        return float(np.median(self.right_s - self.left_s))
