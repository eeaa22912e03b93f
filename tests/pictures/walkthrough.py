"""The README's moving picture: a minute's use of the workbench on the built-in recording.

    python -m tests.pictures.walkthrough [FILE.webp]

Needs chromium. The page is used by mouse and keyboard; each picture is what the browser shows.
"""

import argparse
import io
import shutil
import sys
import time
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from fusion_core.workflows.fuse.settings import PRESETS
from scanloom.client_session import ClientSession
from scanloom.page.events import PictureName
from scanloom.server.workbench import ServeOptions, Workbench
from tests.pictures.workbench import FLAGS, SIZE

PICTURE = Path(__file__).parents[2] / "samples" / "walkthrough.webp"
MOST_BYTES = 3 << 20
_LOADED_S = 180.0
_WIDTH_PX, _HEIGHT_PX = 1200, 675
_SCENE_PX = (800.0, 250.0)
# How long each picture stays, and the last one.
_SHOWN_MS, _END_MS = 1200, 3000
# Without a graphics card the scene takes this long to follow.
_DRAWN_S = 1.5


class Walk:
    """A page and the pictures taken of it."""

    def __init__(self, page: Page, session: ClientSession) -> None:
        self._page, self._session = page, session
        self.pictures: list[Image.Image] = []

    def take(self) -> None:
        """Take a picture once the page shows the latest view."""
        self._session.wait(20.0)
        self._page.wait_for_timeout(1000.0 * _DRAWN_S)
        shot = Image.open(io.BytesIO(self._page.screenshot())).convert("RGB")
        self.pictures.append(shot.resize((_WIDTH_PX, _HEIGHT_PX), Image.Resampling.LANCZOS))

    def key(self, name: str) -> None:
        """Press a key of the page, with the pointer where it reads nothing out."""
        self._page.mouse.move(_SCENE_PX[0], _SCENE_PX[1])
        self._page.keyboard.press(name)
        self.take()

    def undo_epsilon(self) -> None:
        """Take back all changes of the threshold; a drag on a slow machine may be several."""
        epsilon = PRESETS["default"].noise.epsilon
        while self._session.view.settings.noise.epsilon != epsilon:
            before = self._session.view
            self._page.keyboard.press("Control+z")
            until = time.monotonic() + _LOADED_S
            while self._session.view == before and time.monotonic() < until:
                self._page.wait_for_timeout(50.0)
        self.take()

    def point(self, name: PictureName, right: float, down: float, *, click: bool = False) -> None:
        """Move to a place of a picture, as fractions of its width and height."""
        image = self._page.locator(f"div:has(> [data-picture='{name}']) + div img")
        box = image.bounding_box()
        if box is None:
            raise RuntimeError(f"there is no picture {name}")
        x, y = box["x"] + right * box["width"], box["y"] + down * box["height"]
        self._page.mouse.move(x, y, steps=4)
        if click:
            self._page.mouse.click(x, y)
        self.take()

    def drag_epsilon(self, by_px: float) -> None:
        """Drag the threshold of the Repair step."""
        box = self._page.locator("[role='slider']:visible").first.bounding_box()
        if box is None:
            raise RuntimeError("there is no slider")
        mouse = self._page.mouse
        mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        mouse.down()
        mouse.move(box["x"] + by_px, box["y"] + box["height"] / 2, steps=6)
        mouse.up()
        self.take()


def main() -> None:
    """Serve, walk through the steps, and write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", nargs="?", type=Path, default=PICTURE)
    asked = parser.parse_args()
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("chromium is not on the PATH; install it, e.g. with apt-get install chromium")
    with Workbench(ServeOptions(port=0)) as workbench, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport=SIZE)
        page.goto(workbench.address)
        until = time.monotonic() + _LOADED_S
        while not any(one.frame_view and one.frame_view.fused for one in workbench.sessions):
            if time.monotonic() > until:
                sys.exit("the recording was not aligned in time")
            time.sleep(0.2)
        # The browser's own warning that it has no graphics card is no part of the picture.
        page.get_by_text("Software WebGL").locator("xpath=../..").get_by_role("button").click()
        walk = Walk(page, workbench.sessions[0])
        _walk(walk)
        browser.close()
    durations = [_SHOWN_MS] * (len(walk.pictures) - 1) + [_END_MS]
    packed = io.BytesIO()
    walk.pictures[0].save(
        packed,
        "WEBP",
        save_all=True,
        append_images=walk.pictures[1:],
        duration=durations,
        loop=0,
        quality=60,
        method=4,
    )
    content = packed.getvalue()
    if len(content) > MOST_BYTES:
        sys.exit(f"the picture has {len(content)} bytes, more than {MOST_BYTES}")
    asked.picture.write_bytes(content)
    sys.stdout.write(f"{asked.picture}: {len(walk.pictures)} pictures, {len(content)} bytes\n")


def _walk(walk: Walk) -> None:
    walk.take()
    walk.key("Alt+2")
    for right in (0.3, 0.45, 0.6):
        walk.point("similarity", right, 0.4)
    walk.point("similarity", 0.7, 0.5, click=True)
    walk.key("Control+z")
    walk.key("Alt+3")
    walk.key("Alt+4")
    for right in (0.2, 0.45, 0.75):
        walk.point("depth", right, 0.65)
    walk.point("profile", 0.72, 0.5, click=True)
    for by_px in (40.0, 120.0):
        walk.drag_epsilon(by_px)
    walk.undo_epsilon()
    for right in (0.2, 0.4, 0.8):
        walk.point("time", right, 0.5, click=True)
    walk.key("m")
    walk.key("l")
    walk.key("Alt+2")
    walk.key("Alt+1")
    walk.key("l")


if __name__ == "__main__":
    main()
