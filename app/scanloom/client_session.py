"""One browser's session: its view, the worker that computes it, and the panels that display it.

A widget's callback only changes the view. One worker computes the latest view and passes the result
to the panels. A failure is shown as a notification, and the session goes on.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import viser

from fusion_core.model.errors import ScanLoomError, SettingsError
from fusion_core.model.names import printable
from fusion_core.workflows.fuse.settings import PRESETS, PresetName
from scanloom.frame_view import FrameView, as_failure, compute_frame_view, failure_summary
from scanloom.jobs.latest_only_worker import LatestOnlyWorker
from scanloom.jobs.long_job import Cancelled
from scanloom.page.layout import FIRST_WINDOW_PX
from scanloom.page_parts import Panel, Review
from scanloom.scene.sample_readout import linked
from scanloom.state.hand_pose import HandPose
from scanloom.state.history import PASSING_FRAMES, History
from scanloom.state.hover import Hover
from scanloom.state.library import Library
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import View

if TYPE_CHECKING:
    # It takes long to import, and most recordings are of another kind.
    from fusion_core.workflows.calibrate.recorded_camera import RecordedCalibration

# Key of the view in the browser's local storage.
STORED_VIEW = "view"
# Long enough to read two lines.
_NOTIFICATION_S = 9.0
# During a drag that outruns the computation, an outdated result is displayed at least this often.
_MAX_DISPLAY_INTERVAL_S = 0.1
# The panels' last messages need the connection, which closes after the session.
_CLOSE_TIMEOUT_S = 3.0
# What sliders change beside settings.
_DRAGGED = ("frame_index", "slam")


class ClientSession:
    """The session of one browser. Thread-safe.

    ``panels``: closed with the session. ``review``: of the labels, once there is a panel for it.
    ``window_px``: (width, height) of the page. ``after_drawing``: calls a function once the browser
    has taken in what it was sent.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        library: Library,
        view: View,
        after_drawing: Callable[[Callable[[], None]], None] = lambda start: start(),
    ) -> None:
        self.panels: list[Panel] = []
        self.review: Review | None = None
        self.frame_view: FrameView | None = None
        self._client = client
        self._after_drawing = after_drawing
        # The recording whose alignment was asked for last.
        self._alignment_of: OpenRecording | None = None
        self._library = library
        self._view = view
        self._history = History()
        self._open_recording: OpenRecording | None = None
        self._last_failure = ""
        self._displayed_s = 0.0
        # How often it was asked to display a view, and how often it had been when it last did.
        self._asked = self._answered = 0
        self.window_px = FIRST_WINDOW_PX
        self._prefers_dark = False
        self._hover = Hover()
        self._found: tuple[str, RecordedCalibration] | None = None
        self._closed = threading.Event()
        self._lock = threading.RLock()
        # Held while a view is displayed, and while there are not all panels to display it.
        self._displaying = threading.Lock()
        self._worker = LatestOnlyWorker(
            f"session {client.client_id}", self._compute_and_show, self.show_failure
        )

    @property
    def library(self) -> Library:
        """The recordings that may be opened."""
        return self._library

    @property
    def view(self) -> View:
        """The requested view; ``frame_view`` may lag behind by one computation."""
        return self._view

    @property
    def active_review(self) -> Review | None:
        """The review while keys and clicks are about labels, else None."""
        review = self.review
        return review if review is not None and review.is_on else None

    @contextmanager
    def building(self) -> Iterator[None]:
        """Display nothing before the block ends, which adds the panels. A page takes clicks before
        it is built whole; a panel that had shown nothing yet would not answer the next one."""
        with self._displaying:
            yield

    def refresh(self) -> None:
        """Compute and display the view again."""
        with self._lock:
            self._asked += 1
        self._worker.submit(self._view)

    def wait(self, timeout_s: float) -> bool:
        """Whether the latest view was displayed within the time."""
        return self._worker.wait(timeout_s)

    def change(self, **values: Any) -> None:
        """Change fields of the view. A refused value is reported, and the widgets are reset.

        An offset picked by hand belongs to its frame, unless it is locked.
        """
        dragged = next((name for name in _DRAGGED if name in values), "")
        self._change(values, dragged)

    def pass_to_frame(self, frame_index: int, **values: Any) -> None:
        """Go to a frame on the way to others, with other fields of the view. Undo takes the whole
        way as one step."""
        self._change({"frame_index": frame_index} | values, PASSING_FRAMES)

    def adjust(self, pose: HandPose, part: str) -> None:
        """Set the camera's pose by hand. ``part``: what of it; undo takes the changes of one part
        that follow each other as one step."""
        self._change({"extrinsics": pose}, part)

    def show_recording(self, name: str) -> None:
        """Go to the first frame of another recording."""
        self._replace(lambda view: view.of_recording(name))

    def change_setting(self, stage: str, name: str, value: Any) -> None:
        """Change a setting of a stage ("" for the chain itself). Undo takes a drag as one step."""
        self._replace(lambda view: view.with_setting(stage, name, value), f"{stage}.{name}")

    def apply_preset(self, preset: PresetName) -> None:
        """Reset all settings to a preset."""
        settings = PRESETS[preset]
        self.change(
            preset=preset, settings=settings, alignment_settings=settings, picked_offset=None
        )

    def align_again(self) -> None:
        """Align the whole recording again, with the current settings."""
        self.change(alignment_settings=self._view.settings)

    def set_prefers_dark(self, prefers_dark: bool) -> None:
        """Set what the browser asks for where the view leaves the choice to it."""
        if prefers_dark != self._prefers_dark:
            self._prefers_dark = prefers_dark
            self.refresh()

    def hover(self, hover: Hover) -> None:
        """Light up a sample in all views, without computing the frame again."""
        frame_view = self.frame_view
        if frame_view is None or hover == self._hover:
            return
        self._hover = hover
        complete = linked(frame_view, hover)
        with self.batch_updates():
            for panel in self.panels:
                panel.show_hover(frame_view, complete)

    def keep_found(self, recording: str, found: "RecordedCalibration") -> None:
        """Keep what a calibration of a recording has found, instead of what one had before. It
        shows with the next view."""
        self._found = recording, found

    def found_of(self, recording: str) -> "RecordedCalibration | None":
        """What the last calibration has found, if it was of this recording."""
        kept = self._found
        return kept[1] if kept is not None and kept[0] == recording else None

    def undo(self) -> None:
        """Undo the last label in the review, elsewhere the last change of settings, frame, step or
        recording."""
        review = self.active_review
        if review is not None:
            review.undo()
        else:
            self._return_to(self._history.undo)

    def redo(self) -> None:
        """Redo what was undone last."""
        review = self.active_review
        if review is not None:
            review.redo()
        else:
            self._return_to(self._history.redo)

    def step(self, by: int) -> None:
        """Move by so many frames; stop at the ends, or wrap around if playback loops."""
        with self._lock:
            count = len(self._open_recording.frames) if self._open_recording is not None else 0
            if not count:
                return
            self.pass_to_frame(self._view.frame_after(self._view.frame_index, by, count))

    def notify(
        self,
        title: str,
        body: str,
        *,
        color: Literal["blue", "red"] = "blue",
        until_dismissed: bool = False,
    ) -> None:
        """Show a notification that closes by itself, or when a person closes it."""
        self._client.add_notification(
            printable(title),
            printable(body),
            auto_close_seconds=None if until_dismissed else _NOTIFICATION_S,
            color=color,
        )

    def show_failure(self, error: Exception, *, until_dismissed: bool = False) -> None:
        """Notify of a failure, unless it is the same as the last one."""
        failure = as_failure(error)
        if str(failure) != self._last_failure:
            self._last_failure = str(failure)
            self.notify(
                failure_summary(failure),
                failure.advice,
                color="red",
                until_dismissed=until_dismissed,
            )

    def send_file(self, name: str, content: bytes) -> None:
        """Have the browser save a file."""
        self._client.send_file_download(name, content, save_immediately=True)

    @contextmanager
    def batch_updates(self) -> Iterator[None]:
        """Send all widget updates of the block to the browser together, at its end."""
        with self._client.atomic():
            yield
        # Otherwise viser waits up to 1/60 s for more.
        self._client.flush()

    def recording_path(self, name: str) -> Path:
        """The file of a recording. Raises RecordingError for a name that may not be opened."""
        return self._library.path(name)

    def raise_if_closed(self) -> None:
        """Raises Cancelled once the browser has disconnected; called between steps of work."""
        if self._closed.is_set():
            raise Cancelled

    def close(self) -> None:
        """End the session and its panels; running computations end at their next step."""
        for panel in self.panels:
            panel.close()
        self._closed.set()
        self._worker.close()
        self._worker.join(_CLOSE_TIMEOUT_S)
        if self._open_recording is not None:
            self._open_recording.remove_listener(self._hear_of_alignment)
        self._library.release(self)

    def _is_dark(self, view: View) -> bool:
        is_auto = view.color_scheme == "auto"
        return self._prefers_dark if is_auto else view.color_scheme == "dark"

    def _hear_of_alignment(self) -> None:
        self._worker.submit(self._view)

    def _change(self, values: dict[str, Any], dragged: str) -> None:
        if "frame_index" in values and not self._view.lock_picked_offset:
            values = {"picked_offset": None} | values
        self._replace(lambda view: view.changed(**values), dragged)

    def _return_to(self, step: Callable[[View], View | None]) -> None:
        with self._lock:
            self._view = step(self._view) or self._view
            self.refresh()

    def _replace(self, change: Callable[[View], View], dragged: str = "") -> None:
        with self._lock:
            before = self._view
            try:
                after = change(before)
            except SettingsError as error:
                self._last_failure = ""
                self.show_failure(error)
                after = before
            self._history.add(before, after, dragged, time.monotonic())
            self._view = after
            self.refresh()

    def _compute_and_show(self, view: View, is_newest: Callable[[], bool]) -> None:
        with self._displaying, self._library.activity.working():
            self._compute_and_show_now(view, is_newest)

    def _return_from(self, failed: View, error: ScanLoomError) -> None:
        """Go back to what is displayed, as a recording or its streams cannot be opened."""
        self._last_failure = ""
        self.show_failure(error, until_dismissed=True)
        with self._lock:
            shown = self.frame_view
            if (
                shown is not None
                and shown.view.opened_by != failed.opened_by
                and self._view.opened_by == failed.opened_by
            ):
                self._view = shown.view
                self.refresh()

    def _compute_and_show_now(self, view: View, is_newest: Callable[[], bool]) -> None:
        try:
            open_recording = self._library.open(view, viewer=self)
        except ScanLoomError as error:
            self._return_from(view, error)
            return
        if self._closed.is_set():
            self._library.release(self)
            return
        if open_recording is not self._open_recording:
            if self._open_recording is not None:
                self._open_recording.remove_listener(self._hear_of_alignment)
            self._open_recording, self._alignment_of = open_recording, None
        asked = self._asked
        labels = self._library.labels(open_recording.recording.path)
        frame_view = compute_frame_view(view, open_recording, self.raise_if_closed, labels.layer)
        review = None if self.review is None else self.review.overlay(frame_view)
        found = self.found_of(view.recording)
        frame_view = replace(
            frame_view,
            is_dark=self._is_dark(view),
            review=review,
            found_pose=None if found is None else found.calibration.estimate,
        )
        is_overdue = time.monotonic() - self._displayed_s > _MAX_DISPLAY_INTERVAL_S
        if self._closed.is_set() or not (is_newest() or is_overdue):
            return
        if frame_view.failure is not None:
            self.show_failure(frame_view.failure)
        elif frame_view.fused is not None:
            self._last_failure = ""
        # A refused value leaves the view as it is, and its widget is set back.
        has_progressed = asked == self._answered and frame_view.differs_in_progress_only(
            self.frame_view
        )
        self._answered = asked
        before, self.frame_view = self.frame_view, frame_view
        # No two frames are seen at one time. A setting's effect is seen as soon as it is drawn.
        is_other_frame = (
            before is None
            or before.open_recording is not frame_view.open_recording
            or before.view.frame_index != frame_view.view.frame_index
        )
        try:
            with self.batch_updates() if is_other_frame else nullcontext():
                for panel in self.panels:
                    if self._closed.is_set():
                        return
                    with self.batch_updates():
                        if has_progressed:
                            panel.show_progress(frame_view)
                        else:
                            panel.show(frame_view)
        finally:
            # Whatever a panel cannot show yet, it may once the recording is aligned.
            if frame_view.is_being_aligned:
                self._align_behind(open_recording)
        self._displayed_s = time.monotonic()
        self._client.local_storage.set_item(STORED_VIEW, view.to_link())

    def _align_behind(self, open_recording: OpenRecording) -> None:
        """Start the alignment once the browser has taken in the frame as it was recorded: both
        need the processor, and a person waits for the frame."""

        def start() -> None:
            with self._lock:
                if not self._closed.is_set() and self._open_recording is open_recording:
                    open_recording.align(self._hear_of_alignment)
                    if not open_recording.is_aligning:
                        # Another browser's has ended meanwhile.
                        self._hear_of_alignment()

        if self._alignment_of is open_recording:
            return
        self._alignment_of = open_recording
        if open_recording.is_aligning:
            start()
        else:
            self._after_drawing(start)
