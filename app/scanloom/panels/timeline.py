"""The timeline: play, pause, step, speed, loop, and their keys."""

import html
import threading
import time
from collections.abc import Callable
from functools import partial

import viser

from scanloom.client_session import ClientSession, Panel
from scanloom.frame_view import FrameView
from scanloom.panels.widgets.controls import Controls, update_widget
from scanloom.state.view import PANELS

# Frames per second at speed 1 if the recording has no rate; set by hand.
_DEFAULT_HZ = 10.0
_MAX_HZ = 30.0
_SPEEDS = ("0.25", "0.5", "1", "2", "4")
_CHOICE_OF_SPEED = {float(speed): speed for speed in _SPEEDS}


class TimelinePanel(Panel):
    """Moves through the frames."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        self._rate_hz = _DEFAULT_HZ
        self._last = 0
        self._playing = threading.Event()
        self._closed = threading.Event()
        self._frame = gui.add_slider(
            "Frame",
            min=0,
            max=1,
            step=1,
            initial_value=0,
            hint="Depth images in the order of the log",
        )
        self._time = gui.add_html("")
        self._buttons = gui.add_button_group("Go", ("|<", "<", "Play", ">", ">|"))
        speed = gui.add_dropdown("Speed", _SPEEDS, initial_value="1")
        self._loop = gui.add_checkbox("Loop", session.view.loop_playback)
        self._controls = Controls(gui, session)
        self._controls.bind_field(self._loop, "loop_playback", bool)
        self._controls.bind_field(
            self._frame, "frame_index", int, lambda number: min(number, self._last)
        )
        # A link may ask for a speed that is not among the choices.
        self._controls.bind_field(
            speed, "playback_speed", float, lambda value: _CHOICE_OF_SPEED.get(value)
        )

        @self._buttons.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            actions = {
                "|<": self.first,
                "<": lambda: session.step(-1),
                "Play": self.play_or_pause,
                ">": lambda: session.step(1),
                ">|": self.last,
            }
            actions[self._buttons.value]()

        self._add_keys(gui)
        self._thread = threading.Thread(target=self._play, name="play", daemon=True)
        self._thread.start()

    def play_or_pause(self) -> None:
        """Start or stop moving."""
        if self._playing.is_set():
            self._playing.clear()
        else:
            self._playing.set()

    def first(self) -> None:
        """Go to the first frame."""
        self._session.change(frame_index=0)

    def last(self) -> None:
        """Go to the last frame."""
        self._session.change(frame_index=self._last)

    def show(self, frame_view: FrameView) -> None:
        """Set the slider and the stamp."""
        times_ns = frame_view.open_recording.frames.times_ns
        self._last = max(len(times_ns) - 1, 0)
        if self._frame.max != max(self._last, 1):
            update_widget(self._frame, max=max(self._last, 1))
            span_s = float(times_ns[-1] - times_ns[0]) / 1e9 if len(times_ns) > 1 else 0.0
            self._rate_hz = self._last / span_s if span_s > 0.0 else _DEFAULT_HZ
        number = min(frame_view.view.frame_index, self._last)
        self._controls.show(frame_view.view)
        self._time.content = (
            '<div style="padding:0 0.5em;font-size:0.85em;opacity:0.75">'
            f"{_seconds(frame_view, number)} · frame {number} of {self._last + 1}"
            f"{_gap(frame_view)}{_camera(frame_view, number)}</div>"
        )

    def close(self) -> None:
        """Stop moving."""
        self._closed.set()
        self._playing.set()

    def _play(self) -> None:
        due_s = 0.0
        while True:
            self._playing.wait()
            if self._closed.is_set():
                return
            rate_hz = min(self._rate_hz * self._session.view.playback_speed, _MAX_HZ)
            view = self._session.view
            if not view.loop_playback and view.frame_index >= self._last:
                self._playing.clear()
                continue
            self._session.step(1)
            # Playback waits for slow frames instead of dropping them.
            self._session.wait(2.0)
            due_s = max(due_s + 1.0 / rate_hz, time.monotonic())
            self._closed.wait(due_s - time.monotonic())

    def _add_keys(self, gui: viser.GuiApi) -> None:
        session = self._session
        keys: tuple[tuple[str, str, Callable[[], None]], ...] = (
            ("Play or pause", "space", self.play_or_pause),
            ("Previous frame", "pageup", lambda: session.step(-1)),
            ("Next frame", "pagedown", lambda: session.step(1)),
            ("Next frame (J)", "J", lambda: session.step(1)),
            ("Previous frame (K)", "K", lambda: session.step(-1)),
            ("First frame", "home", self.first),
            ("Last frame", "end", self.last),
        )
        for label, hotkey, action in keys:
            command = gui.add_command(label, hotkey=hotkey)  # type: ignore[arg-type]  # a key of viser's list
            command.on_trigger(_calling(action))
        for number, name in enumerate(PANELS):
            command = gui.add_command(f"Panel {name}", hotkey=str(number + 1), modifier="alt")  # type: ignore[arg-type]  # a digit
            command.on_trigger(_calling(partial(session.change, panel=name)))
        undo = gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl")
        undo.on_trigger(lambda _: session.undo())
        redo = gui.add_command("Redo", hotkey="Z", modifier="cmd/ctrl+shift")
        redo.on_trigger(lambda _: session.redo())


def _calling(action: Callable[[], None]) -> Callable[[object], None]:
    """A callback that ignores the event."""
    return lambda _: action()


def _seconds(frame_view: FrameView, number: int) -> str:
    times_ns = frame_view.open_recording.frames.times_ns
    if not len(times_ns):
        return "no frames"
    return f"{(int(times_ns[number]) - int(times_ns[0])) / 1e9:.3f} s"


def _gap(frame_view: FrameView) -> str:
    if frame_view.paired is None or frame_view.open_recording.fuse_session.virtual_row is not None:
        return ""
    if frame_view.paired.window is None:
        return " · no scan near enough"
    gap_ms = frame_view.paired.gap_ns / 1e6
    gap = f" · scan {abs(gap_ms):.1f} ms {'before' if gap_ms >= 0.0 else 'after'} it"
    match = frame_view.match
    if match is not None and match.pair.aligned_scan is not match.scan:
        gap += ", for u and v interpolated at the image's instant"
    return gap


def _camera(frame_view: FrameView, number: int) -> str:
    """The frame's camera, if the recording has several."""
    cameras = frame_view.open_recording.fuse_session.rig.cameras
    if len(cameras) < 2 or not len(frame_view.open_recording.frames):
        return ""
    return f"<br>{html.escape(cameras[frame_view.open_recording.frames.camera_of(number)].topic)}"
