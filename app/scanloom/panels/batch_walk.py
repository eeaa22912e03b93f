"""Going through the list of a batch, recording by recording, in the order in which it was shown."""

import threading
from collections.abc import Callable

import viser

from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.bridge import PageBridge
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.batch_html import walk_html
from scanloom.state.batch_list import BatchWalk


class BatchWalkPanel(Panel):
    """Which recording of the list is shown, and buttons to the one before and after; nothing while
    a recording is shown that was not opened from a list."""

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, session: ClientSession) -> None:
        self._library = session.library
        self._text = gui.add_html("", visible=False)
        self._lock = threading.Lock()
        self._walk: BatchWalk | None = None
        # What was asked for last, and is shown once it is open.
        self._name = ""
        self._open: Callable[[str], None] = lambda _: None
        bridge.on_press("batch-step", lambda value: self.step(-1 if value == "-1" else 1))
        bridge.add_key("Next recording of the batch", "pagedown", lambda: self.step(1), "shift")
        bridge.add_key("Previous recording of the batch", "pageup", lambda: self.step(-1), "shift")

    def set_opener(self, open_recording: Callable[[str], None]) -> None:
        """What opens a recording by its name."""
        self._open = open_recording

    def begin(self, walk: BatchWalk, name: str) -> None:
        """Go on from a recording that has been chosen in a list."""
        with self._lock:
            self._walk, self._name = walk, name

    def step(self, direction: int) -> None:
        """To the next recording that can be opened, to the previous one for -1; at an end, stay."""
        with self._lock:
            if self._walk is None:
                return
            found = self._walk.next_name(self._library, direction)
            if found is None:
                return
            self._walk.place, self._name = found
        self._open(found[1])

    def show(self, frame_view: FrameView) -> None:
        """Tell where one is in the list."""
        with self._lock:
            walk = self._walk
            is_on = walk is not None and frame_view.view.recording == self._name
            content = ""
            if walk is not None and is_on:
                content = walk_html(walk.label, walk.place, walk.count)
        update_widget(self._text, content=content)
        update_widget(self._text, visible=is_on)
