"""The page's script and its keys, and the way back from them to the server."""

import html
import threading
from collections.abc import Callable
from functools import cache

import viser

from scanloom.jobs.ordered_calls import OrderedCalls
from scanloom.page.events import (
    Click,
    PictureName,
    Point,
    PointKind,
    Press,
    Screen,
    Stroke,
    parse_events,
)
from scanloom.resources import static_path

# The script finds its field by this label.
_CHANNEL = "page events"
# Runs the script: viser keeps inline handlers of HTML, but no script elements. A GIF of one pixel.
_PIXEL = "R0lGODlhAQABAIAAAAAAAP///yH5BAEAAAAALAAAAAABAAEAAAIBRAA7"
_RUN = '<img alt="" hidden src="data:image/gif;base64,{pixel}" onload="{script}">'

OnPoint = Callable[[PointKind, float, float], None]


class PageBridge:
    """Installs the script in one browser's page and passes on what it sends.

    Callbacks run in viser's threads, one at a time and in the page's order; they must be quick.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._lock = threading.Lock()
        self._last_action = self._last_point = 0
        self._on_point: dict[PictureName, OnPoint] = {}
        self._on_stroke: dict[PictureName, Callable[[Stroke], None]] = {}
        self._on_press: dict[str, Callable[[str], None]] = {}
        self._gui = gui
        self._keys = OrderedCalls(lambda run: gui._thread_executor.submit(run))
        self._screen: Screen | None = None
        self._on_screen: Callable[[Screen], None] = lambda _: None
        gui.add_html(_style() + script_html("page.js"))
        gui.add_html('<div class="scanloom-channel"></div>')
        self._channel = gui.add_text(_CHANNEL, "")
        self._channel.on_update(self._receive)

    def on_point(self, picture: PictureName, call: OnPoint) -> None:
        """Call ``call(kind, x_px, y_px)`` for the pointer's events on a picture, in its pixels."""
        self._on_point[picture] = call

    def on_stroke(self, picture: PictureName, call: Callable[[Stroke], None]) -> None:
        """Call ``call`` with what is drawn on a picture that has a tool."""
        self._on_stroke[picture] = call

    def on_press(self, name: str, call: Callable[[str], None]) -> None:
        """Call ``call(value)`` when a button of ``press_attributes(name, value)`` is pressed. A
        browser may send any value."""
        self._on_press[name] = call

    def add_key(
        self, label: str, key: str, action: Callable[[], None], modifier: str | None = None
    ) -> None:
        """Call ``action`` when a key is pressed, or the command of this label is chosen. ``key``
        and ``modifier`` are of viser's lists. Keys act one after the other, as they were pressed.
        """
        command = self._gui.add_command(label, hotkey=key, modifier=modifier)  # type: ignore[arg-type]  # lists of literals

        # viser runs other functions in any order, but waits for this one.
        async def pressed(_: object) -> None:
            self._keys.add(action)

        command.on_trigger(pressed)

    def on_screen(self, call: Callable[[Screen], None]) -> None:
        """Call ``call`` with the page's size and wish for dark, at first and at each change."""
        with self._lock:
            self._on_screen = call
            # The page may have told it before there was anybody to hear.
            if self._screen is not None:
                call(self._screen)

    def _receive(self, event: viser.GuiEvent[viser.GuiTextHandle]) -> None:
        if event.client is None:
            return
        # Threads come in any order: the latest value holds all that was missed.
        with self._lock:
            events = parse_events(self._channel.value)
            if events is None:
                return
            for action in events.actions:
                if action.number > self._last_action:
                    self._last_action = action.number
                    self._act(action)
            point = events.pointer
            if point is not None and point.number > self._last_point:
                self._last_point = point.number
                self._point(point.picture, point.kind, point)

    def _act(self, action: Click | Stroke | Press | Screen) -> None:
        match action:
            case Click():
                self._point(action.picture, action.kind, action)
            case Stroke() if action.picture in self._on_stroke:
                self._on_stroke[action.picture](action)
            case Press() if action.name in self._on_press:
                self._on_press[action.name](action.value)
            case Screen():
                self._screen = action
                self._on_screen(action)

    def _point(self, picture: PictureName, kind: PointKind, at: Point | Click) -> None:
        if picture in self._on_point:
            self._on_point[picture](kind, at.x_px, at.y_px)


def press_attributes(name: str, value: str = "") -> str:
    """The attributes that make an HTML button answer. One named "link" copies the link to the
    view, which the page has in an attribute ``data-view-link``."""
    return f'type="button" data-press="{html.escape(name)}" data-value="{html.escape(value)}"'


@cache
def _style() -> str:
    return f"<style>{static_path('page.css').read_text(encoding='utf-8')}</style>"


@cache
def script_html(name: str) -> str:
    """HTML that runs a script of the static files, once in a page if the script sees to it."""
    script = html.escape(static_path(name).read_text(encoding="utf-8"))
    return _RUN.format(pixel=_PIXEL, script=script)
