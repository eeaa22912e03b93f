"""How fast a person answers."""

import time
from collections import deque

# The rate is that of the last answers within this time; whoever pauses longer has begun anew.
_RATE_OVER_S = 300.0
_RATE_ANSWERS = 200
_LEAST_ANSWERS = 3


class AnswerRate:
    """The times of the last answers."""

    def __init__(self) -> None:
        self._answered_s: deque[float] = deque(maxlen=_RATE_ANSWERS)

    def count(self) -> None:
        """An answer was given now."""
        self._answered_s.append(time.monotonic())

    def a_minute(self) -> float | None:
        """Answers a minute; None before there are enough."""
        now_s = time.monotonic()
        recent = [at_s for at_s in self._answered_s if now_s - at_s < _RATE_OVER_S]
        if len(recent) < _LEAST_ANSWERS or recent[-1] <= recent[0]:
            return None
        return 60.0 * (len(recent) - 1) / (recent[-1] - recent[0])
