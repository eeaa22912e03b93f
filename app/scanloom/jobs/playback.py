"""Playback: a thread that moves through frames by the clock."""

import threading
import time
from collections.abc import Callable
from typing import Protocol

# A browser shows no more, and a picture takes longer.
MAX_PICTURES_HZ = 30.0
# A frame that takes longer, as one that is read from a slow disk, is not waited for.
_LONGEST_FRAME_S = 2.0


class Player(Protocol):
    """What is played: a session, as far as playback needs one."""

    @property
    def frame_index(self) -> int:
        """The wanted frame."""

    @property
    def frames_hz(self) -> float:
        """Frames per second at the chosen speed."""

    @property
    def is_at_end(self) -> bool:
        """Whether playback ends here."""

    def frame_after(self, frame_index: int, by: int) -> int:
        """The frame so many frames on: at most the last one, or from the beginning again."""

    def show_frame(self, frame_index: int) -> None:
        """Have a frame shown."""

    def wait(self, timeout_s: float) -> bool:
        """Whether the latest wanted frame was shown within the time."""


class Playback:
    """Plays at the recording's rate: frames that would come late are left out.

    One frame is shown at a time. Somebody else may go to another frame or change the speed: it goes
    on from there. ``on_change`` is called when it starts or stops, in any thread.
    """

    def __init__(self, player: Player, on_change: Callable[[], None] = lambda: None) -> None:
        self._player = player
        self._on_change = on_change
        self._playing = threading.Event()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="play", daemon=True)
        self._thread.start()

    @property
    def is_playing(self) -> bool:
        """Whether frames go by."""
        return self._playing.is_set() and not self._closed.is_set()

    def toggle(self) -> None:
        """Start or stop."""
        if self._playing.is_set():
            self._playing.clear()
        else:
            self._playing.set()
        self._on_change()

    def close(self) -> None:
        """End for good."""
        self._closed.set()
        self._playing.set()

    def _run(self) -> None:
        while True:
            self._playing.wait()
            if self._closed.is_set():
                return
            if self._play():
                self._playing.clear()
                self._on_change()

    def _play(self) -> bool:
        """Play until it is stopped, or until somebody changes something; whether the end was
        reached."""
        player = self._player
        first, rate_hz = player.frame_index, player.frames_hz
        started_s = time.monotonic()
        shown, passed = first, 0
        while self.is_playing and player.frame_index == shown and player.frames_hz == rate_hz:
            if player.is_at_end:
                return True
            due = int((time.monotonic() - started_s) * rate_hz)
            if due > passed:
                passed = due
                number = player.frame_after(first, passed)
                begun_s = time.monotonic()
                if number != shown:
                    shown = number
                    player.show_frame(number)
                    player.wait(_LONGEST_FRAME_S)
                # Not more often than a browser shows pictures.
                self._closed.wait(begun_s + 1.0 / MAX_PICTURES_HZ - time.monotonic())
            next_s = started_s + (passed + 1) / rate_hz
            self._closed.wait(max(next_s - time.monotonic(), 0.0))
        return False
