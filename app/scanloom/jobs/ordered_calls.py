"""Calls that are made one after the other, in the order in which they were asked for."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any


class OrderedCalls:
    """Runs calls in other threads, never two at a time. Thread-safe.

    ``submit`` runs a function in some thread soon. A call that raises does so in there, and the
    calls after it are made all the same.
    """

    def __init__(self, submit: Callable[[Callable[[], None]], Any]) -> None:
        self._submit = submit
        self._lock = threading.Lock()
        self._waiting: deque[Callable[[], None]] = deque()
        self._is_running = False

    def add(self, call: Callable[[], None]) -> None:
        """Make a call after those before it. Returns at once."""
        with self._lock:
            self._waiting.append(call)
            if self._is_running:
                return
            self._is_running = True
        self._submit(self._run)

    def _run(self) -> None:
        try:
            with self._lock:
                call = self._waiting.popleft()
            call()
        finally:
            with self._lock:
                self._is_running = bool(self._waiting)
                goes_on = self._is_running
            if goes_on:
                self._submit(self._run)
