"""Whether a person waits for an answer: work in the background gives way to that."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager


class Activity:
    """Counts the work that people wait for. Thread-safe."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._running = 0
        self._ended_s = -float("inf")

    @contextmanager
    def working(self) -> Iterator[None]:
        """Somebody waits for the work within the block."""
        with self._changed:
            self._running += 1
        try:
            yield
        finally:
            with self._changed:
                self._running -= 1
                self._ended_s = time.monotonic()
                self._changed.notify_all()

    def wait_until_quiet(self, quiet_s: float, timeout_s: float) -> bool:
        """Wait until nobody has waited for anything during ``quiet_s``; False if that is not so
        within ``timeout_s``."""
        deadline_s = time.monotonic() + timeout_s
        with self._changed:
            while True:
                now_s = time.monotonic()
                left_s = quiet_s - (now_s - self._ended_s)
                if not self._running and left_s <= 0.0:
                    return True
                if now_s >= deadline_s:
                    return False
                until_deadline_s = deadline_s - now_s
                self._changed.wait(
                    until_deadline_s if self._running else min(left_s, until_deadline_s)
                )
