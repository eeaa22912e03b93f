"""A long job in a panel: how far it is, the button that stops it, and how it ended."""

import threading
import time
from collections.abc import Callable
from typing import Any

import viser

from fusion_core.model.progress import Progress
from scanloom.client_session import ClientSession
from scanloom.frame_view import as_failure, failure_summary
from scanloom.jobs.long_job import LongJob
from scanloom.panels.widgets.controls import update_widget
from scanloom.panels.widgets.markup import paragraph

# People see no more, and the work goes on meanwhile.
BETWEEN_S = 0.2
_CLOSE_S = 10.0


class PanelJob:
    """One job of a panel at a time.

    ``lock``: the panel's own. ``on_change``: told under it whether a job is at work, whenever that
    changes. ``done`` of ``begin`` is called in the job's thread with its result and calls ``end``.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        session: ClientSession,
        lock: threading.RLock,
        on_change: Callable[[bool], None],
        *,
        cancel_label: str = "Cancel",
    ) -> None:
        self._session, self._lock, self._on_change = session, lock, on_change
        self._job: LongJob | None = None
        self._is_cancelling = self._is_closed = False
        self._stage, self._advanced_s = "", 0.0
        self._progress_text = gui.add_html("", visible=False)
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._cancel_button = gui.add_button(cancel_label, color="gray", visible=False)
        self._said = gui.add_html("")
        self._cancel_button.on_click(lambda _: self._cancel())

    @property
    def is_at_work(self) -> bool:
        return self._job is not None

    @property
    def is_closed(self) -> bool:
        """Whether the browser has gone: no further job begins."""
        return self._is_closed

    def begin(
        self, name: str, work: Callable[[Progress], Any], done: Callable[[Any], None]
    ) -> None:
        """Start a job unless one is at work or the browser has gone."""
        with self._lock:
            if self._job is not None or self._is_closed:
                return
            self._is_cancelling, self._stage = False, ""
            update_widget(self._said, content="")
            self._advance(0, None, "starting")
            self._show_working(True)
            self._job = LongJob(
                name,
                work,
                on_progress=self._advance,
                on_done=done,
                on_failed=self.fail,
                on_cancelled=lambda: self.end("Cancelled; nothing was kept."),
            )

    def end(self, said: str = "") -> None:
        """The job's last step, in its thread: the worker draws what came of it."""
        with self._lock:
            self._job = None
            update_widget(self._said, content=paragraph(said) if said else "")
            self._show_working(False)
            is_closed = self._is_closed
        if not is_closed:
            self._session.refresh()

    def fail(self, error: Exception) -> None:
        """End with what went wrong."""
        failure = as_failure(error)
        self.end(f"Failed: {failure_summary(failure)} {failure.advice}")
        if not self._is_closed:
            self._session.fail(error)

    def close(self) -> None:
        """The browser has gone: what is at work, a build as well, is cancelled as by the button and
        leaves nothing behind. Nobody could tell who asked for it, or whether it is whole."""
        with self._lock:
            self._is_closed = True
            job = self._job
        if job is not None:
            job.cancel()
            job.wait(_CLOSE_S)

    def _cancel(self) -> None:
        with self._lock:
            if self._job is not None:
                self._is_cancelling = True
                self._job.cancel()
                update_widget(self._cancel_button, disabled=True)
                update_widget(self._progress_text, content=paragraph("Stopping at the next step …"))

    def _advance(self, done: int, total: int | None, what: str) -> None:
        now_s = time.monotonic()
        if self._is_cancelling or (what == self._stage and now_s - self._advanced_s < BETWEEN_S):
            return
        self._stage, self._advanced_s = what, now_s
        share = 100.0 * done / total if total else 100.0
        count = f", {done} of {total}" if total else f", {done}" if done else ""
        update_widget(self._progress, value=round(min(share, 100.0), 1), animated=not total)
        update_widget(self._progress_text, content=paragraph(f"{what.capitalize()}{count}"))

    def _show_working(self, is_at_work: bool) -> None:
        for handle in (self._progress, self._progress_text, self._cancel_button):
            update_widget(handle, visible=is_at_work)
        update_widget(self._cancel_button, disabled=False)
        self._on_change(is_at_work)
