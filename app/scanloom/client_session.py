"""One person's desk: their view, what is computed for it, and the panels that show it.

A widget's callback only changes the view. One worker computes the latest view and hands it to the
panels; a failure is told and the desk goes on.
"""

import threading
import time
from collections.abc import Callable
from typing import Any, Literal, Protocol

import viser

from fusion_core.model.errors import SettingsError
from fusion_core.workflows.fuse.presets import PRESETS, PresetName
from scanloom.frame_view import Shown, as_failure, problem_of, shown_of
from scanloom.jobs.latest import LatestWorker
from scanloom.jobs.long import Cancelled
from scanloom.state.history import History
from scanloom.state.library import Library
from scanloom.state.opened import Opened
from scanloom.state.view import View

# Where a browser keeps the view between two visits.
STORED_VIEW = "view"
_SHOWN_S = 9.0
# A drag that is faster than the computation shows where it goes at least so often.
_LEAST_OFTEN_S = 0.1
_PARTING_S = 3.0


class Panel(Protocol):
    """Shows one stage. ``show`` gets each computed view, in the worker's thread, and must set its
    widgets from it: the view may come from a link, an undo or another panel."""

    def show(self, shown: Shown) -> None: ...


class Desk:
    """The view of one browser. Safe for threads."""

    def __init__(self, client: viser.ClientHandle, library: Library, view: View) -> None:
        self.client = client
        self.library = library
        self.panels: list[Panel] = []
        self.shown: Shown | None = None
        self._view = view
        self._history = History()
        self._opened: Opened | None = None
        self._told = ""
        self._shown_s = 0.0
        self._closed = threading.Event()
        self._lock = threading.RLock()
        self._worker = LatestWorker(f"desk {client.client_id}", self._work, self.fail)

    @property
    def view(self) -> View:
        """What is asked for; what is shown may lag behind by one computation."""
        return self._view

    def refresh(self) -> None:
        """Compute and show the view again."""
        self._worker.ask(self._view)

    def wait(self, timeout_s: float) -> bool:
        """Whether the latest view was shown within the time."""
        return self._worker.wait(timeout_s)

    def change(self, **values: Any) -> None:
        """Change the view; a refused value is told, and the widgets go back.

        An offset that was picked by hand is that of its frame, unless it is locked.
        """
        if "number" in values and not self._view.lock_picked:
            values = {"picked": None} | values
        self._replace(lambda view: view.changed(**values), remember=False)

    def change_settings(self, **values: Any) -> None:
        """As ``change``, to be undone by ``undo``."""
        self._replace(lambda view: view.changed(**values), remember=True)

    def set(self, stage: str, name: str, value: Any) -> None:
        """Change one setting of one stage ("" for the chain's own). A drag is undone at once."""
        self._replace(
            lambda view: view.with_setting(stage, name, value),
            remember=True,
            dragged=f"{stage}.{name}",
        )

    def set_preset(self, preset: PresetName) -> None:
        """All settings as the preset has them."""
        settings = PRESETS[preset]
        self.change_settings(preset=preset, settings=settings, aligned=settings, picked=None)

    def align_again(self) -> None:
        """Align the whole recording with the settings as they are."""
        self.change_settings(aligned=self._view.settings)

    def undo(self) -> None:
        """Take back the last change of settings."""
        self._replace(lambda view: self._history.undo(view) or view, remember=False)

    def redo(self) -> None:
        """Make the change again that was taken back."""
        self._replace(lambda view: self._history.redo(view) or view, remember=False)

    def step(self, by: int) -> None:
        """Go on by so many frames; at an end stop, or come in again from the other where asked."""
        with self._lock:
            count = len(self._opened.frames) if self._opened is not None else 0
            if not count:
                return
            number = self._view.number + by
            number = number % count if self._view.loop else min(max(number, 0), count - 1)
            self.change(number=number)

    def tell(self, title: str, body: str, *, color: Literal["blue", "red"] = "blue") -> None:
        """A notification that goes away by itself."""
        self.client.add_notification(title, body, auto_close_seconds=_SHOWN_S, color=color)

    def fail(self, error: Exception) -> None:
        """Tell of a failure; the same one twice in a row is told once."""
        failure = as_failure(error)
        if str(failure) != self._told:
            self._told = str(failure)
            self.tell(problem_of(failure), failure.advice, color="red")

    def check(self) -> None:
        """Raises Cancelled once the browser has gone: for the steps of what the worker does."""
        if self._closed.is_set():
            raise Cancelled

    def close(self) -> None:
        """The browser has gone. What is computed for it alone ends at its next step."""
        self._closed.set()
        self._worker.close()
        # What is at work talks to the client, whose connection ends next.
        self._worker.join(_PARTING_S)
        if self._opened is not None:
            self._opened.forget(self.refresh)
        self.library.leave(self)

    def _replace(
        self, change: Callable[[View], View], *, remember: bool, dragged: str = ""
    ) -> None:
        with self._lock:
            before = self._view
            try:
                after = change(before)
            except SettingsError as error:
                self._told = ""
                self.fail(error)
                after = before
            if remember and after != before:
                self._history.add(before, dragged, time.monotonic())
            self._view = after
            self.refresh()

    def _work(self, view: View, is_newest: Callable[[], bool]) -> None:
        opened = self.library.open(view, seen_by=self)
        if self._closed.is_set():
            self.library.leave(self)
            return
        if opened is not self._opened:
            if self._opened is not None:
                self._opened.forget(self.refresh)
            self._opened = opened
        if opened.chain is None and opened.failure is None:
            opened.align(self.refresh)
        shown = shown_of(view, opened, self.check)
        is_due = time.monotonic() - self._shown_s > _LEAST_OFTEN_S
        if self._closed.is_set() or not (is_newest() or is_due):
            return
        if shown.failure is not None:
            self.fail(shown.failure)
        elif shown.fused is not None:
            self._told = ""
        self.shown = shown
        for panel in self.panels:
            if self._closed.is_set():
                return
            with self.client.atomic():
                panel.show(shown)
            # Else viser waits a sixtieth of a second for more.
            self.client.flush()
        self._shown_s = time.monotonic()
        self.client.local_storage.set_item(STORED_VIEW, view.to_link())
