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
from fusion_core.workflows.fuse.settings import PRESETS, PresetName
from scanloom.frame_view import FrameView, as_failure, compute_frame_view, failure_summary
from scanloom.jobs.latest_only_worker import LatestOnlyWorker
from scanloom.jobs.long_job import Cancelled
from scanloom.state.history import History
from scanloom.state.library import Library
from scanloom.state.open_recording import OpenRecording
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

    def show(self, frame_view: FrameView) -> None: ...


class ClientSession:
    """The view of one browser. Safe for threads."""

    def __init__(self, client: viser.ClientHandle, library: Library, view: View) -> None:
        self.client = client
        self.library = library
        self.panels: list[Panel] = []
        self.frame_view: FrameView | None = None
        self._view = view
        self._history = History()
        self._opened: OpenRecording | None = None
        self._told = ""
        self._shown_s = 0.0
        self._closed = threading.Event()
        self._lock = threading.RLock()
        self._worker = LatestOnlyWorker(f"desk {client.client_id}", self._work, self.fail)

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
        if "frame_index" in values and not self._view.lock_picked_offset:
            values = {"picked_offset": None} | values
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
        self.change_settings(
            preset=preset, settings=settings, alignment_settings=settings, picked_offset=None
        )

    def align_again(self) -> None:
        """Align the whole recording with the settings as they are."""
        self.change_settings(alignment_settings=self._view.settings)

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
            number = self._view.frame_index + by
            number = number % count if self._view.loop_playback else min(max(number, 0), count - 1)
            self.change(frame_index=number)

    def tell(self, title: str, body: str, *, color: Literal["blue", "red"] = "blue") -> None:
        """A notification that goes away by itself."""
        self.client.add_notification(title, body, auto_close_seconds=_SHOWN_S, color=color)

    def fail(self, error: Exception) -> None:
        """Tell of a failure; the same one twice in a row is told once."""
        failure = as_failure(error)
        if str(failure) != self._told:
            self._told = str(failure)
            self.tell(failure_summary(failure), failure.advice, color="red")

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
        open_recording = self.library.open(view, seen_by=self)
        if self._closed.is_set():
            self.library.leave(self)
            return
        if open_recording is not self._opened:
            if self._opened is not None:
                self._opened.forget(self.refresh)
            self._opened = open_recording
        if open_recording.chain is None and open_recording.failure is None:
            open_recording.align(self.refresh)
        frame_view = compute_frame_view(view, open_recording, self.check)
        is_due = time.monotonic() - self._shown_s > _LEAST_OFTEN_S
        if self._closed.is_set() or not (is_newest() or is_due):
            return
        if frame_view.failure is not None:
            self.fail(frame_view.failure)
        elif frame_view.fused is not None:
            self._told = ""
        self.frame_view = frame_view
        for panel in self.panels:
            if self._closed.is_set():
                return
            with self.client.atomic():
                panel.show(frame_view)
            # Else viser waits a sixtieth of a second for more.
            self.client.flush()
        self._shown_s = time.monotonic()
        self.client.local_storage.set_item(STORED_VIEW, view.to_link())
