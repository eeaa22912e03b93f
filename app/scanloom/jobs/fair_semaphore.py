"""A semaphore that admits waiting threads in the order of their arrival."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

# A waiting thread can give up after at most this time.
_POLL_S = 0.1


class FairSemaphore:
    """Admits ``limit`` threads at a time, first come, first served. Thread-safe."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        # The first ``limit`` of it are admitted.
        self._queue: list[object] = []
        self._changed = threading.Condition()

    @contextmanager
    def acquired(self, on_wait: Callable[[], None]) -> Iterator[None]:
        """Wait to be admitted, and hold the semaphore within the block.

        ``on_wait`` is called repeatedly while waiting; an exception that it raises ends the wait.
        """
        ticket = object()
        with self._changed:
            self._queue.append(ticket)
        try:
            while not self._is_admitted(ticket):
                on_wait()
            yield
        finally:
            with self._changed:
                self._queue.remove(ticket)
                self._changed.notify_all()

    def _is_admitted(self, ticket: object) -> bool:
        """Whether the thread is admitted within ``_POLL_S``."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._queue.index(ticket) < self._limit, timeout=_POLL_S
            )
