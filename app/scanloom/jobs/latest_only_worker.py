"""A worker thread that processes only the latest request.

A slider sends twenty values a second, and its callbacks run in parallel and in any order. So a
callback only submits a request; one thread takes the newest, and those in between are dropped.
"""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from scanloom.jobs.long_job import Cancelled

Request = TypeVar("Request")


class LatestOnlyWorker(Generic[Request]):
    """Calls ``work`` with the newest request, one at a time, in a thread of its own.

    ``work`` gets the request and a function that says whether it is still the newest, to be called
    before results are displayed. Exceptions of ``work`` go to ``on_error`` (Cancelled is ignored),
    and the worker continues.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[Request, Callable[[], bool]], None],
        on_error: Callable[[Exception], None],
    ) -> None:
        self._work = work
        self._on_error = on_error
        self._changed = threading.Condition()
        self._request: Request | None = None
        self._generation = 0
        self._done = 0
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def submit(self, request: Request) -> None:
        """Submit a request; an earlier one that has not started is dropped."""
        with self._changed:
            self._request = request
            self._generation += 1
            self._changed.notify_all()

    def wait(self, timeout_s: float) -> bool:
        """Whether all requests so far were processed or dropped within the time."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._done == self._generation or self._closed, timeout_s
            )

    def close(self) -> None:
        """End after the current request; its result counts as outdated, its errors are ignored."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def join(self, timeout_s: float) -> bool:
        """Whether the thread of a closed worker ended within the time."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._done < self._generation)
                if self._closed:
                    return
                request, generation = self._request, self._generation
            assert request is not None, "a generation begins with a request"
            try:
                self._work(request, lambda: self._is_newest(generation))  # noqa: B023  # called before the loop goes on
            except Cancelled:
                pass
            except Exception as error:  # noqa: BLE001  # the worker must survive any failure
                # Closing may itself cause a failure.
                if not self._closed:
                    self._on_error(error)
            with self._changed:
                self._done = generation
                self._changed.notify_all()

    def _is_newest(self, generation: int) -> bool:
        with self._changed:
            return generation == self._generation and not self._closed
