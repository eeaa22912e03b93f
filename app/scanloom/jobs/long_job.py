"""A long job in a thread of its own, with progress and cancellation."""

import threading
from collections.abc import Callable
from typing import Any

from fusion_core.model.progress import Progress


class Cancelled(Exception):
    """The job was cancelled."""


class LongJob:
    """Runs ``work`` in a thread of its own.

    ``work`` gets a progress function, which raises Cancelled once ``cancel`` was called. At the end
    exactly one of ``on_done``, ``on_failed`` and ``on_cancelled`` is called, in the job's thread.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[Progress], Any],
        *,
        on_progress: Progress,
        on_done: Callable[[Any], None],
        on_failed: Callable[[Exception], None],
        on_cancelled: Callable[[], None],
    ) -> None:
        self._work = work
        self._on_progress = on_progress
        self._on_done, self._on_failed, self._on_cancelled = on_done, on_failed, on_cancelled
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def cancel(self) -> None:
        """Have the job stop at its next report of progress."""
        self._stop.set()

    def wait(self, timeout_s: float | None = None) -> bool:
        """Whether the job ended within the time."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _progress(self, done: int, total: int | None, what: str) -> None:
        if self._stop.is_set():
            raise Cancelled
        self._on_progress(done, total, what)

    def _run(self) -> None:
        try:
            result = self._work(self._progress)
        except Cancelled:
            self._on_cancelled()
        except Exception as error:  # noqa: BLE001  # every failure must reach the user
            self._on_failed(error)
        else:
            self._on_done(result)
