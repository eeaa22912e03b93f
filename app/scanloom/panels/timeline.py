"""The timeline: the noise of every frame along time, playback, steps, and their keys."""

import threading
from collections.abc import Callable
from functools import partial

import viser

from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, is_blind, survey_inputs
from scanloom.jobs.playback import Playback
from scanloom.page.bridge import PageBridge
from scanloom.page.events import PointKind
from scanloom.page.live_picture import LivePicture, PictureMark
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.frame_readout import frame_text, progress_text
from scanloom.panels.timeline_html import PRESS, SPEEDS, RowState, line_html, row_html
from scanloom.panels.widgets.controls import Controls
from scanloom.plots.frame_times import FrameTimes
from scanloom.plots.theme import theme_of
from scanloom.plots.time_strip import TimeStrip, time_strip
from scanloom.scene.frame_summary import conflict_runs
from scanloom.state.frame_survey import FrameCounts, FrameSurvey
from scanloom.state.hover import Hover
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import PANELS

# Frames per second at speed 1 if the recording has no rate; set by hand.
_DEFAULT_HZ = 10.0
_HEIGHT_PX = 64
# Narrower than a phone's screen the strip's numbers do not fit.
_LEAST_WIDTH_PX, _MOST_WIDTH_PX = 240, 2400
_FIRST_WIDTH_PX = 736
_CURSOR_BEYOND_PX = 2.0
# viser counts widgets up from 0.
_LAST = 1e9


class TimelinePanel(Panel):
    """Moves through the frames. A click on the strip goes to a frame, a drag through them."""

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, session: ClientSession) -> None:
        self._session = session
        # Drawn in the session's worker, in the survey's thread and in viser's.
        self._lock = threading.RLock()
        self._frame_view: FrameView | None = None
        self._times: FrameTimes | None = None
        self._survey: FrameSurvey | None = None
        self._counts: FrameCounts | None = None
        self._strip: TimeStrip | None = None
        self._drawn_of: tuple[object, ...] = ()
        self._width_px = _FIRST_WIDTH_PX
        self._hover = Hover()
        # The frame whose conflict is selected once it is shown.
        self._select_conflict_in: int | None = None
        self._is_closed = False
        self._playback = Playback(_SessionPlayer(session, self), self._redraw)
        self._row = gui.add_html("")
        self._picture = LivePicture(gui, bridge, "time")
        self._line = gui.add_html("")
        self._controls = Controls(gui, session)
        # Last in its panel: it is seldom needed.
        with gui.add_folder("Frame by number", expand_by_default=False, order=_LAST):
            frame = gui.add_slider(
                "Frame",
                min=1,
                max=2,
                step=1,
                initial_value=1,
                hint="Depth images or, without any, scans in the order of the log, from 1",
            )
            loop = gui.add_checkbox(
                "Loop", session.view.loop_playback, hint="Begin again after the last frame"
            )
        self._frame = frame
        self._controls.bind_field(
            frame, "frame_index", lambda number: int(number) - 1, self._number_of
        )
        self._controls.bind_field(loop, "loop_playback", bool)
        self._picture.on_point(self._pointed)
        self._actions: dict[str, Callable[[], None]] = {
            "first": self.first,
            "previous": lambda: session.step(-1),
            "play": self.play_or_pause,
            "next": lambda: session.step(1),
            "last": self.last,
            "worst": self.go_to_worst,
            "next_conflict": self.go_to_conflict,
            "previous_conflict": lambda: self.go_to_conflict(-1),
        } | {f"speed {s:g}": partial(session.change, playback_speed=s) for _, s in SPEEDS}
        bridge.on_press(PRESS, lambda value: self._actions.get(value, _do_nothing)())
        self._add_keys(bridge)

    # What people do

    def play_or_pause(self) -> None:
        """Start or stop moving; from the end it starts at the beginning."""
        if self.is_at_end and not self._playback.is_playing:
            self.first()
        self._playback.toggle()

    def first(self) -> None:
        """Go to the first frame."""
        self._session.change(frame_index=0)

    def last(self) -> None:
        """Go to the last frame."""
        self._session.change(frame_index=self.last_index)

    def go_to_worst(self) -> None:
        """Go to the frame with the most noise; say why where there is none."""
        worst = None if self._counts is None else self._counts.worst_frame()
        self._go_to(worst, self._missing(self._counts, worst, "noise"))

    def go_to_conflict(self, direction: int = 1) -> None:
        """Go to the next stretch with a conflict, or the previous one for -1, and select the beam
        that it is about."""
        counts, at = self._counts, self._session.view.frame_index
        found = None if counts is None else counts.next_conflict(at, direction)
        self._select_conflict_in = at if found is None else found
        is_here = self._select_conflict(self._session.frame_view)
        if is_here and counts is not None and counts.is_complete:
            return
        self._go_to(found, self._missing(counts, found, "conflict"))

    def set_width(self, width_px: float) -> None:
        """Draw the strip for a panel of this width, in CSS pixels."""
        width = round(min(max(width_px, _LEAST_WIDTH_PX), _MOST_WIDTH_PX))
        if width != self._width_px:
            self._width_px = width
            self._redraw()

    # What is shown

    @property
    def last_index(self) -> int:
        """The last frame's index; 0 where there is none."""
        return 0 if self._times is None else self._times.times_s.size - 1

    @property
    def is_at_end(self) -> bool:
        """Whether playback ends at the wanted frame."""
        view = self._session.view
        return not view.loop_playback and view.frame_index >= self.last_index

    @property
    def frames_hz(self) -> float:
        """Frames per second of the recording."""
        times = self._times
        span_s = 0.0 if times is None else float(times.times_s[-1])
        return self.last_index / span_s if span_s > 0.0 else _DEFAULT_HZ

    def show(self, frame_view: FrameView) -> None:
        """Move the cursor, and survey the frames with the view's settings."""
        with self._lock:
            self._show_recording(frame_view)
            self._frame_view = frame_view
            self._want_survey(frame_view)
            self._controls.show(frame_view.view)
            self._draw()
        self._select_conflict(frame_view)

    def show_hover(self, frame_view: FrameView, hover: Hover) -> None:
        """Mark the frame under the pointer and say what is known of it."""
        with self._lock:
            self._hover = hover
            self._mark()

    def close(self) -> None:
        """Stop moving and counting."""
        with self._lock:
            self._is_closed = True
            self._playback.close()
            if self._frame_view is not None:
                self._frame_view.open_recording.surveys.release(self)

    def _select_conflict(self, frame_view: FrameView | None) -> bool:
        """Select the strongest conflict if it is wanted in this frame; whether there is one."""
        if frame_view is None or frame_view.fused is None:
            return False
        if frame_view.view.frame_index != self._select_conflict_in:
            return False
        self._select_conflict_in = None
        runs = conflict_runs(frame_view.fused)
        if runs:
            self._session.change(selected_beam=runs[0].middle)
        return bool(runs)

    def _show_recording(self, frame_view: FrameView) -> None:
        opened = frame_view.open_recording
        before = None if self._frame_view is None else self._frame_view.open_recording
        if before is opened:
            return
        if before is not None:
            before.surveys.release(self)
        self._survey, self._counts = None, None
        times_ns = opened.frames.times_ns
        self._times = FrameTimes.of(times_ns) if len(times_ns) else None
        update_widget(self._frame, max=max(self.last_index + 1, 2))

    def _want_survey(self, frame_view: FrameView) -> None:
        opened, view, inputs = frame_view.open_recording, frame_view.view, survey_inputs(frame_view)
        if inputs is None or self._is_closed:
            return
        self._survey = opened.surveys.want(self, inputs, self._redraw)
        is_automatic = view.picked_offset is None and (
            not view.label_layer or view.panel == "Review"
        )
        if frame_view.fused is not None and is_automatic:
            self._survey.note(view.frame_index, frame_view.fused)

    def _redraw(self) -> None:
        """Draw again what has changed beside the frame."""
        with self._lock:
            if self._frame_view is not None and not self._is_closed:
                with self._session.batch_updates():
                    self._draw()

    def _draw(self) -> None:
        frame_view, times = self._frame_view, self._times
        assert frame_view is not None, "a view was shown"
        is_hidden = is_blind(frame_view.view)
        self._counts = None if self._survey is None or is_hidden else self._survey.counts
        has_pairs = frame_view.open_recording.can_be_fused and not is_hidden
        drawn_of = (times, self._counts, has_pairs, self._width_px, frame_view.is_dark)
        if times is None:
            self._strip = None
            self._picture.show(None)
        elif self._strip is None or drawn_of != self._drawn_of:
            self._drawn_of = drawn_of
            self._strip = time_strip(
                times,
                self._counts,
                width_px=self._width_px,
                height_px=_HEIGHT_PX,
                theme=theme_of(is_dark=frame_view.is_dark),
                has_pairs=has_pairs,
            )
            self._picture.show(self._strip.rgb)
        self._mark()
        update_widget(self._row, content=row_html(self._row_state(frame_view)))
        text, details = "Nothing to play", ""
        if times is not None:
            index = min(frame_view.view.frame_index, self.last_index)
            text = frame_text(times, self._counts, index)
            text = text[0].upper() + text[1:] + _camera(frame_view, index)
            details = _gap(frame_view)
        update_widget(self._line, content=line_html(text, details, progress_text(self._counts)))

    def _missing(self, counts: FrameCounts | None, found: int | None, what: str) -> str:
        opened = None if self._frame_view is None else self._frame_view.open_recording
        if opened is not None and not opened.can_be_fused:
            return opened.opened.why_not_fused
        if is_blind(self._session.view):
            return "Noise is not told in a blind review."
        return _missing(counts, found, what)

    def _row_state(self, frame_view: FrameView) -> RowState:
        counts = self._counts
        worst = None if counts is None else counts.worst_frame()
        conflict = None if counts is None else counts.next_conflict(-1)
        return RowState(
            is_playing=self._playback.is_playing,
            speed=frame_view.view.playback_speed,
            worst_missing=self._missing(counts, worst, "noise"),
            conflict_missing=self._missing(counts, conflict, "conflict"),
        )

    def _mark(self) -> None:
        """The cursor, and a cross where the pointer is; no new picture."""
        strip, times, frame_view = self._strip, self._times, self._frame_view
        if strip is None or times is None or frame_view is None:
            return
        marks = []
        if (place := strip.place_of(frame_view.view.frame_index)) is not None:
            # Not over the legend above.
            reach_px = 0.5 * strip.box.height + _CURSOR_BEYOND_PX
            marks.append(PictureMark("column", *place, reach_px=reach_px))
        readout = ""
        hovered = self._hover.frame_index
        if hovered is not None and (place := strip.place_of(hovered)) is not None:
            marks.append(PictureMark("cross", *place))
            if self._hover.source == "time":
                readout = frame_text(times, self._counts, hovered)
        self._picture.mark(marks, readout)

    def _number_of(self, frame_index: int) -> int:
        return min(frame_index, self.last_index) + 1

    # What the page sends

    def _pointed(self, kind: PointKind, x_px: float, y_px: float) -> None:
        strip = self._strip
        if kind == "drag" and strip is not None:
            # The pointer may leave the strip, and the ends are reached so.
            box = strip.box
            x_px = min(max(x_px, float(box.left)), box.right - 1.0)
            y_px = float(box.top)
        index = None if strip is None else strip.frame_at(x_px, y_px)
        if kind == "leave" or index is None:
            self._session.hover(Hover())
            return
        if kind != "move":
            self._session.change(frame_index=index)
        self._session.hover(Hover(source="time", frame_index=index))

    def _go_to(self, frame_index: int | None, missing: str) -> None:
        if frame_index is not None:
            self._session.change(frame_index=frame_index)
        else:
            self._session.notify("Not found", missing)

    def _go_on(self, direction: int) -> None:
        review = self._session.active_review
        if review is not None:
            review.go(direction)
        else:
            self._session.step(direction)

    def _conflict_or_no(self) -> None:
        review = self._session.active_review
        if review is not None:
            review.answer("reject")
        else:
            self.go_to_conflict()

    def _add_keys(self, bridge: PageBridge) -> None:
        session = self._session
        keys: tuple[tuple[str, str, str | None, Callable[[], None]], ...] = (
            ("Play or pause", "space", None, self.play_or_pause),
            ("Previous frame", "pageup", None, lambda: session.step(-1)),
            ("Next frame", "pagedown", None, lambda: session.step(1)),
            ("Next frame (J; in the review: run)", "J", None, lambda: self._go_on(1)),
            ("Previous frame (K; in the review: run)", "K", None, lambda: self._go_on(-1)),
            ("First frame", "home", None, self.first),
            ("Last frame", "end", None, self.last),
            ("Frame with the most noise", "M", None, self.go_to_worst),
            ("Next conflict (in the review: no)", "N", None, self._conflict_or_no),
            ("Previous conflict", "N", "shift", lambda: self.go_to_conflict(-1)),
            ("Undo", "Z", "cmd/ctrl", session.undo),
            ("Redo", "Z", "cmd/ctrl+shift", session.redo),
        )
        for label, hotkey, modifier, action in keys:
            bridge.add_key(label, hotkey, action, modifier)
        for number, name in enumerate(PANELS):
            bridge.add_key(
                f"Panel {name}", str(number + 1), partial(session.change, panel=name), "alt"
            )


class _SessionPlayer:
    """The session as something that is played."""

    def __init__(self, session: ClientSession, timeline: TimelinePanel) -> None:
        self._session, self._timeline = session, timeline

    @property
    def frame_index(self) -> int:
        return self._session.view.frame_index

    @property
    def frames_hz(self) -> float:
        return self._timeline.frames_hz * self._session.view.playback_speed

    @property
    def is_at_end(self) -> bool:
        return self._timeline.is_at_end

    def frame_after(self, frame_index: int, by: int) -> int:
        count = self._timeline.last_index + 1
        return self._session.view.frame_after(frame_index, by, count)

    def show_frame(self, frame_index: int) -> None:
        self._session.pass_to_frame(frame_index)

    def wait(self, timeout_s: float) -> bool:
        return self._session.wait(timeout_s)


def _do_nothing() -> None:
    """A browser may send any name."""


def _missing(counts: FrameCounts | None, found: int | None, what: str) -> str:
    """Why there is no frame to go to, empty where there is one."""
    if found is not None:
        return ""
    if counts is None or not counts.done:
        return "No frame is counted yet."
    if not counts.is_complete:
        return f"No {what} found yet; frames are still being counted."
    return f"No frame of this recording has a {what}." if what == "conflict" else "No noise at all."


def _gap(frame_view: FrameView) -> str:
    paired = frame_view.paired
    if paired is None or frame_view.view.virtual_row is not None:
        return ""
    if paired.window is None:
        return ""
    gap_ms = paired.gap_ns / 1e6
    gap = f" · scan {abs(gap_ms):.1f} ms {'before' if gap_ms >= 0.0 else 'after'} it"
    match = frame_view.match
    if match is not None and match.pair.aligned_scan is not match.scan:
        gap += ", for u and v interpolated at the image's instant"
    return gap


def _camera(frame_view: FrameView, index: int) -> str:
    """The frame's camera, if the recording has several."""
    opened: OpenRecording = frame_view.open_recording
    topic = opened.camera_of(index)
    return f" · {topic}" if topic else ""
