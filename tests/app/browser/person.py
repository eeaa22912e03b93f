"""What a person does in a browser, and what they see."""

import re
import time
from base64 import b64decode
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from playwright.sync_api import Locator, Page, expect

from fusion_core.workflows.fuse.cached_chain import FrameChoice
from fusion_core.workflows.fuse.frame_match import FrameMatch
from scanloom.client_session import STORED_VIEW, ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.events import PictureName
from scanloom.server.workbench import Workbench
from scanloom.state.view import PanelName, View
from tests.patience import ENOUGH_S

# A fresh machine compiles what it calls first, beside other work.

# Null where another picture took the place of this one meanwhile.
FETCH = """async image => {
    const answer = await fetch(image.src).catch(() => null);
    if (answer === null) return null;
    const bytes = new Uint8Array(await answer.arrayBuffer());
    return btoa(Array.from(bytes, byte => String.fromCharCode(byte)).join(''));
}"""

DRAWN = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"


@dataclass
class Person:
    """A person at a browser, with its client session on the server."""

    page: Page
    session: ClientSession

    def look_at(self, view: View) -> None:
        """Go there at once, and wait until it is shown."""
        self.session.change(**dict(view))
        self.wait_until(lambda: self.frame_view.view == view and self.frame_view.chain is not None)
        self.wait_until_on_page()

    @property
    def frame_view(self) -> FrameView:
        """What the session has shown last."""
        assert self.session.frame_view is not None
        return self.session.frame_view

    def reload(self, workbench: Workbench) -> None:
        """Load the page again, once the browser has kept the view, and wait for the new session."""
        self.wait_until_on_page()
        known = workbench.sessions
        self.page.reload()
        self.session = at_session(self.page, workbench, known).session

    def kept(self) -> str | None:
        """The link of the view that the browser keeps."""
        kept: str | None = self.page.evaluate(f"localStorage.getItem('viser-user:{STORED_VIEW}')")
        return kept

    def wait_until_on_page(self) -> None:
        """Wait until the page shows the view: what the server has shown comes there later."""
        # The browser keeps a view after it has taken in all that shows it.
        self.wait_until(lambda: self.kept() == self.session.view.to_link())
        self.page.evaluate(DRAWN)

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait for what no text on the page tells."""
        deadline_s = time.monotonic() + ENOUGH_S
        while not condition():
            assert time.monotonic() < deadline_s, "it never came true"
            self.page.wait_for_timeout(50)

    def wait_for_peak(self, peak: tuple[float, float]) -> None:
        """Wait until the Match panel's words say it."""
        self.unfold("Pick by hand")
        expect(self.text("Best fit: u =")).to_be_visible()
        self.wait_until(lambda: self.peak() == peak)

    def wait_for_number(self, label: str, value: float, within: float) -> None:
        """Wait until a number's field shows a value, but for less than ``within``."""
        self.wait_until(lambda: abs(self.number(label) - value) < within)

    def wait_for_figure(self, expected: np.ndarray, which: int = 0) -> None:
        """Wait until a figure of the open step is this one, (H, W, 3) RGB, to the pixel."""
        self.wait_until(lambda: np.array_equal(self.figure(which)[..., ::-1], expected))

    def wait_for_another_picture(self, name: PictureName, than: np.ndarray) -> np.ndarray:
        """A picture that is always in sight, once it is not ``than`` any more."""
        self.wait_until(lambda: not np.array_equal(self.picture(name), than))
        return self.picture(name)

    def wait_for_panel(self, panel: PanelName) -> None:
        """Wait until a panel is shown on the page."""
        self.wait_until(lambda: self.frame_view.view.panel == panel)
        self.wait_until_on_page()

    def open_step(self, name: PanelName) -> None:
        """Open a step by its button at the top."""
        self.page.get_by_label("Steps").get_by_role("button", name=name, exact=True).click()

    def unfold(self, label: str) -> None:
        """Open a folder if it is closed."""
        head = self.page.get_by_text(label, exact=True).locator("visible=true").first
        expect(head).to_be_visible()
        if head.locator("svg.tabler-icon-chevron-down").count():
            head.click()

    def press(self, name: str) -> None:
        self.button(name).click()

    def button(self, name: str) -> Locator:
        return self.page.get_by_role("button", name=name, exact=True)

    def open_recording(self, name: str) -> None:
        """Choose a recording in the opening dialog."""
        self.key("o")
        self.page.locator(".scanloom-files").get_by_text(name, exact=True).click()

    def choose(self, label: str, option: str) -> None:
        self.page.get_by_role("combobox", name=label, exact=True).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def thumb(self, label: str) -> Locator:
        """What is dragged of a slider."""
        words = re.compile(f"^{re.escape(label)}$")
        slider = self.page.locator("label", has_text=words).get_attribute("for")
        return self.page.locator(f"[id='{slider}'] [role='slider']")

    def drag(self, label: str, by_px: float) -> float:
        """Drag a slider, to the left by less than 0; return the value at which it stands then."""
        thumb = self.thumb(label)
        thumb.scroll_into_view_if_needed()
        x, y = self.middle_at_rest(thumb)
        mouse = self.page.mouse
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + by_px, y, steps=8)
        mouse.up()
        # The slider follows the mouse with the next picture.
        self.page.evaluate(DRAWN)
        value = thumb.get_attribute("aria-valuenow")
        assert value is not None
        return float(value)

    def middle_at_rest(self, place: Locator) -> tuple[float, float]:
        """Where a place is once it does not move: a folder that has just been opened slides."""
        seen = [middle_of(place)]

        def is_at_rest() -> bool:
            seen.append(middle_of(place))
            return seen[-1] == seen[-2]

        self.page.wait_for_timeout(50)
        self.wait_until(is_at_rest)
        return seen[-1]

    def number(self, label: str) -> float:
        """What a number's field shows."""
        return float(self.page.get_by_label(label, exact=True).input_value())

    def key(self, name: str) -> None:
        """Press a key after a click on some text: what is typed into a widget is for it."""
        self.page.locator(".scanloom-verdict h2").click()
        self.page.keyboard.press(name)

    def change_by_key(self, name: str) -> None:
        """Press a key that changes the view, and wait for the change."""
        before = self.session.view
        self.page.keyboard.press(name)
        self.wait_until(lambda: self.session.view != before)

    def text(self, words: str | re.Pattern[str]) -> Locator:
        """Text that is seen and has these words in it."""
        return self.page.get_by_text(words).locator("visible=true").first

    def read(self, words: str, pattern: str) -> tuple[str, ...]:
        """What the groups of ``pattern`` are in the text that has ``words`` in it."""
        said = self.text(words).inner_text()
        found = re.search(pattern, said)
        assert found is not None, said
        return found.groups()

    def peak(self) -> tuple[float, float]:
        """(u, v) of the peak in the Match panel's words."""
        u, v = self.read("Best fit: u =", r"u = (-?[\d.]+), v = ([\d.]+)")
        return float(u), float(v)

    def picture(self, which: PictureName) -> np.ndarray:
        """(H, W, 3) BGR: a picture that is always in sight."""
        return self._content(self.live(which))

    def panel(self, kind: type[Any]) -> Any:
        """The session's panel of a class."""
        return next(panel for panel in self.session.panels if isinstance(panel, kind))

    def place_on(self, which: PictureName, x_px: float, y_px: float) -> tuple[float, float]:
        """Where a pixel of a picture that answers to the pointer lies on the screen."""
        image = self.live(which)
        image.scroll_into_view_if_needed()
        self.middle_at_rest(image)
        box = image.bounding_box()
        assert box is not None
        zoom = box["width"] / image.evaluate("it => it.naturalWidth")
        return box["x"] + (x_px + 0.5) * zoom, box["y"] + (y_px + 0.5) * zoom

    def live(self, name: PictureName) -> Locator:
        """The image of a picture that answers to the pointer."""
        return self.page.locator(f"div:has(> [data-picture='{name}']) + div img")

    def figure(self, which: int = 0) -> np.ndarray:
        """(H, W, 3) BGR: a figure of the open step, counted from its top."""
        own = "img[src^='blob:']:not(div:has(> [data-picture]) + div img)"
        return self._content(self.page.locator(own).locator("visible=true").nth(which))

    def _content(self, image: Locator) -> np.ndarray:
        deadline_s = time.monotonic() + ENOUGH_S
        while (data := self.page.evaluate(FETCH, image.element_handle())) is None:
            assert time.monotonic() < deadline_s, "no picture stayed"
        return decoded(b64decode(data))

    def screen(self) -> np.ndarray:
        """(H, W, 3) BGR: what the browser shows."""
        return decoded(self.page.screenshot())


def at_session(page: Page, workbench: Workbench, known: list[ClientSession]) -> Person:
    """The person at a page whose session is none of those known, once their recording is aligned
    and the page takes keys."""
    person = Person(page, _aligned_session(page, workbench, known))
    page.wait_for_function("window.scanloomPage")
    # The keys come to the page before the view, and are heard once it has drawn.
    person.wait_until_on_page()
    return person


def _aligned_session(page: Page, workbench: Workbench, known: list[ClientSession]) -> ClientSession:
    deadline_s = time.monotonic() + ENOUGH_S
    while time.monotonic() < deadline_s:
        for session in workbench.sessions:
            if (
                session not in known
                and session.frame_view is not None
                and session.frame_view.chain is not None
            ):
                return session
        page.wait_for_timeout(50)
    shown = [session.frame_view and session.frame_view.failure for session in workbench.sessions]
    raise AssertionError(f"no session was aligned: {shown}")


def decoded(png: bytes) -> np.ndarray:
    image: np.ndarray | None = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image


def middle_of(place: Locator) -> tuple[float, float]:
    box = place.bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def colourful(image: np.ndarray) -> np.ndarray:
    """(H, W) bool: neither white nor grey nor black."""
    return np.ptp(image.astype(np.int64), axis=2) > 40


def match_of(frame_view: FrameView, view: View) -> FrameMatch:
    """What the chain of what is shown computes for a view."""
    assert frame_view.chain is not None
    return frame_view.chain.match(FrameChoice(number=view.frame_index), view.settings)


def peak_of(frame_view: FrameView, view: View) -> tuple[float, float]:
    """(u, v) of the peak as the Match panel writes it."""
    peak = match_of(frame_view, view).search.peaks[view.settings.search.metric]
    return round(peak.u, 2), round(peak.v, 1)
