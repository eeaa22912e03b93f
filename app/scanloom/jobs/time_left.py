"""How long a step of long work still takes.

The rule: the step goes on at the mean rate since its first counted part, which may have had to wait
for code to be compiled. It is told after a second of counting. From then on what is told runs down
with the clock, and each report moves it by a fifth towards the newest estimate, so that it does not
jump; and it is told no finer than in steps of 5 s.
"""

import time
from collections.abc import Callable

# An estimate from less than this jumps.
_MIN_COUNTED_S = 1.0
# Of the way to the newest estimate at each report: some five reports take in a change of pace.
_FOLLOWED = 0.2
# Less than this is not worth a number.
_MIN_NAMED_S = 5.0


class TimeLeft:
    """The estimate for the step at work. ``clock_s``: a monotonic clock."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._step = ""
        self._since_s: float | None = None
        self._first_done = 0
        # What was told last, and when.
        self._told: tuple[float, float] | None = None

    def after(self, done: int, total: int | None, what: str) -> float | None:
        """Seconds left after ``done`` of ``total`` parts of the step ``what``; None while unknown.

        Call it at each report of progress.
        """
        now_s = self._clock_s()
        if what != self._step or not total or done < 1:
            self._step, self._since_s, self._told = what, None, None
        if not total or done < 1:
            return None
        if self._since_s is None:
            self._since_s, self._first_done = now_s, done
        counted, elapsed_s = done - self._first_done, now_s - self._since_s
        if counted < 1 or elapsed_s < _MIN_COUNTED_S:
            return None
        estimate_s = elapsed_s * max(total - done, 0) / counted
        if self._told is None:
            left_s = estimate_s
        else:
            before_s, at_s = self._told
            run_down_s = max(before_s - (now_s - at_s), 0.0)
            left_s = run_down_s + _FOLLOWED * (estimate_s - run_down_s)
        self._told = left_s, now_s
        return left_s


def time_left_text(left_s: float) -> str:
    """How long something still takes, no finer than such an estimate is."""
    if left_s < _MIN_NAMED_S:
        return "A few seconds left."
    # 57.5 s would round to 60 s.
    if left_s < 57.5:
        return f"About {5 * round(left_s / 5)} s left."
    return f"About {max(round(left_s / 60), 1)} min left."
