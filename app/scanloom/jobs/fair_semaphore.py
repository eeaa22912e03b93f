"""Turns at heavy work: so many at once, and the others in the order of their coming."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# Who waits asks so often whether they still want their turn.
_ASK_S = 0.1


class FairSemaphore:
    """Lets ``at_once`` threads work at a time. Safe for threads."""

    def __init__(self, at_once: int) -> None:
        self._at_once = at_once
        # Those at work are the first of it.
        self._queue: list[object] = []
        self._changed = threading.Condition()

    @contextmanager
    def acquired(self, waiting: Callable[[], None]) -> Iterator[None]:
        """Wait for a turn, and have it as long as the block lasts.

        ``waiting`` is called again and again meanwhile; what it raises gives the place away.
        """
        place = object()
        with self._changed:
            self._queue.append(place)
        try:
            while not self._has_turn(place):
                waiting()
            yield
        finally:
            with self._changed:
                self._queue.remove(place)
                self._changed.notify_all()

    def _has_turn(self, place: object) -> bool:
        """Whether the turn has come within ``_ASK_S``."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._queue.index(place) < self._at_once, timeout=_ASK_S
            )
