"""One long job at a time: progress, cancel, and its end in the words of its result or failure."""

import threading
from collections.abc import Callable
from typing import Any

from fusion_core.model.progress import Progress


class Cancelled(Exception):
    """The job was asked to stop."""


class LongJob:
    """A function in a thread of its own that reports progress and can be stopped there.

    ``work`` gets a progress function, which raises Cancelled once ``cancel`` was called.
    Exactly one of the callbacks is called at the end, in the job's thread.
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
        """Stop at the next report of progress."""
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
        except Exception as error:  # noqa: BLE001  # any failure must reach the person who waits
            self._on_failed(error)
        else:
            self._on_done(result)
