"""A long job in a panel, with a progress bar, a cancel button and its outcome as text."""

import threading
import time
from collections.abc import Callable
from typing import Any

import viser

from fusion_core.model.progress import Progress
from scanloom.client_session import ClientSession
from scanloom.frame_view import as_failure, failure_summary
from scanloom.jobs.long_job import LongJob
from scanloom.jobs.time_left import TimeLeft, time_left_text
from scanloom.page.markup import paragraph
from scanloom.page.update_widget import update_widget

# Interval of progress updates.
UPDATE_INTERVAL_S = 0.2
# Time in which a cancelled job should reach its next step.
_CANCEL_TIMEOUT_S = 10.0


class PanelJob:
    """At most one running job of a panel.

    ``lock``: the panel's own. ``on_change`` is called, with the lock held, when a job starts (True)
    or ends (False).
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
        self._time_left = TimeLeft()
        self._progress_text = gui.add_html("", visible=False)
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._cancel_button = gui.add_button(cancel_label, color="gray", visible=False)
        self._outcome = gui.add_html("")
        self._cancel_button.on_click(lambda _: self._cancel())

    @property
    def is_running(self) -> bool:
        """Whether a job is running."""
        return self._job is not None

    @property
    def is_closed(self) -> bool:
        """Whether the session is closed: no further job starts."""
        return self._is_closed

    def begin(
        self, name: str, work: Callable[[Progress], Any], done: Callable[[Any], None]
    ) -> None:
        """Start a job unless one is running or the session is closed.

        ``done`` is called in the job's thread with the result, and must call ``end``.
        """
        with self._lock:
            if self._job is not None or self._is_closed:
                return
            self._is_cancelling, self._stage = False, ""
            self._time_left = TimeLeft()
            update_widget(self._outcome, content="")
            self._advance(0, None, "starting")
            self._set_running(True)
            self._job = LongJob(
                name,
                work,
                on_progress=self._advance,
                on_done=done,
                on_failed=self.fail,
                on_cancelled=lambda: self.end("Cancelled; nothing was saved."),
            )

    def end(self, message: str = "") -> None:
        """End the job, in its thread, and have the session display the result."""
        with self._lock:
            self._job = None
            update_widget(self._outcome, content=paragraph(message) if message else "")
            self._set_running(False)
            is_closed = self._is_closed
        if not is_closed:
            self._session.refresh()

    def fail(self, error: Exception) -> None:
        """End the job with an error."""
        failure = as_failure(error)
        self.end(f"Failed: {failure_summary(failure)} {failure.advice}")
        if not self._is_closed:
            self._session.show_failure(error)

    def close(self) -> None:
        """Cancel the running job, which leaves no files behind. No further job starts."""
        with self._lock:
            self._is_closed = True
            job = self._job
        if job is not None:
            job.cancel()
            job.wait(_CANCEL_TIMEOUT_S)

    def _cancel(self) -> None:
        with self._lock:
            if self._job is not None:
                self._is_cancelling = True
                self._job.cancel()
                update_widget(self._cancel_button, disabled=True)
                update_widget(self._progress_text, content=paragraph("Stopping at the next step …"))

    def _advance(self, done: int, total: int | None, what: str) -> None:
        left_s = self._time_left.after(done, total, what)
        now_s = time.monotonic()
        if self._is_cancelling or (
            what == self._stage and now_s - self._advanced_s < UPDATE_INTERVAL_S
        ):
            return
        self._stage, self._advanced_s = what, now_s
        percent = 100.0 * done / total if total else 100.0
        count = f", {done:,} of {total:,}" if total else f", {done:,}" if done else ""
        update_widget(self._progress, value=round(min(percent, 100.0), 1), animated=not total)
        # The first letter alone: what is fused or drawn may be a name.
        text = f"{what[:1].upper()}{what[1:]}{count}"
        if left_s is not None:
            text += f". {time_left_text(left_s)}"
        update_widget(self._progress_text, content=paragraph(text))

    def _set_running(self, is_running: bool) -> None:
        for handle in (self._progress, self._progress_text, self._cancel_button):
            update_widget(handle, visible=is_running)
        update_widget(self._cancel_button, disabled=False)
        self._on_change(is_running)
