"""Opens a recording in the background; what is displayed stays until it is open."""

import threading
from collections.abc import Callable

from scanloom.state.library import Library
from scanloom.state.view import View

# Opening cannot be interrupted. A second choice need not wait for the first; a browser that asks
# for hundreds does not get a thread for each.
_MAX_PARALLEL = 2


class RecordingOpener:
    """One person's openings: a later one supersedes those before. Thread-safe.

    ``on_opened(view)`` or ``on_failed(view, error)`` is called for each that is not superseded or
    cancelled, in a thread of its own; ``on_dropped(view)`` for the others.
    """

    def __init__(
        self,
        library: Library,
        on_opened: Callable[[View], None],
        on_failed: Callable[[View, Exception], None],
        on_dropped: Callable[[View], None],
    ) -> None:
        self._library = library
        self._on_opened, self._on_failed, self._on_dropped = on_opened, on_failed, on_dropped
        self._lock = threading.Lock()
        self._running = 0
        self._current: _Request | None = None
        self._waiting: _Request | None = None

    def open(self, view: View) -> None:
        """Open the recording of a view."""
        with self._lock:
            dropped, self._current = self._waiting, _Request(view)
            self._waiting = self._current
            if starts := self._running < _MAX_PARALLEL:
                self._running += 1
        if dropped is not None:
            self._on_dropped(dropped.view)
        if starts:
            threading.Thread(target=self._run, name="open recording", daemon=True).start()

    def cancel(self) -> None:
        """Forget the recording that is being opened."""
        with self._lock:
            dropped, self._waiting, self._current = self._waiting, None, None
        if dropped is not None:
            self._on_dropped(dropped.view)

    def _run(self) -> None:
        while True:
            with self._lock:
                request, self._waiting = self._waiting, None
                if request is None:
                    self._running -= 1
                    return
            self._open(request)

    def _open(self, request: "_Request") -> None:
        failure: Exception | None = None
        try:
            # The request itself keeps it open until a session does.
            self._library.open(request.view, viewer=request)
        except Exception as error:  # noqa: BLE001  # every failure must reach the user
            failure = error
        with self._lock:
            is_current = self._current is request
            if is_current:
                self._current = None
        try:
            if not is_current:
                self._on_dropped(request.view)
            elif failure is not None:
                self._on_failed(request.view, failure)
            else:
                self._on_opened(request.view)
        finally:
            self._library.release(request)


class _Request:
    """Compared by identity: the same view may be asked for twice."""

    def __init__(self, view: View) -> None:
        self.view = view
