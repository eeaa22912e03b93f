"""How soon the page answers the pointer, from the mouse's event to what is read out and lit up.

    python -m tests.benchmarks.bench_hover

In Chromium, with all pictures, the scene and all its layers shown. Times are taken inside the page:
from the event's own stamp to the change of the document. The server is a process of its own, held
to two cores, which the browser shares where the machine has no others. viser takes in messages
between two frames, and a processor that draws the scene itself would be all that is measured: the
calls that draw are left out, as a graphics card takes them over. Exits with 1 where an aim is
missed.
"""

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Any

from playwright.sync_api import Page, TimeoutError, sync_playwright

from scanloom.page.events import PictureName
from scanloom.resources import sample_path
from tests.app.browser.conftest import CARD_OF_NO_NAME, chromium
from tests.benchmarks.bench_workbench import CORES, Figure, latency, serving, write_panorama

HOVERS = 60
AIM_MS = 100.0
SCREEN = {"width": 1600, "height": 900}
PICTURES: tuple[PictureName, ...] = ("depth", "similarity", "profile", "time")
# Of a picture, that no axis is met.
_EDGE = 0.15
_ALIGNED_MS = 300_000.0
_ANSWERED_MS = 2_000.0
_DRAWING = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")

NO_DRAWING = """
for (const name of ["drawArrays", "drawElements", "drawRangeElements", "drawArraysInstanced",
                    "drawElementsInstanced"]) {
    WebGL2RenderingContext.prototype[name] = () => {};
}
"""

# What follows a move of the mouse: when the read-out had another text, and when each picture had
# other marks for the last time.
WATCH = """() => {
    const readout = document.querySelector(".scanloom-readout");
    const pictureOf = place => {
        const image = place.closest("div:has(> [data-picture]) + div");
        return image?.previousElementSibling.querySelector("[data-picture]").dataset.picture;
    };
    let text = "";
    window.hover = {
        begin() {
            Object.assign(this, { moved: null, readout: null, marks: {}, latest: null });
            text = readout.hidden ? "" : readout.textContent;
        },
        isAnswered() {
            return this.readout !== null && performance.now() - this.latest > 300;
        },
    };
    hover.begin();
    addEventListener("pointermove", event => {
        if (hover.moved === null && event.target.closest("img")) hover.moved = event.timeStamp;
    }, true);
    new MutationObserver(changes => {
        const now = performance.now();
        if (hover.moved === null) return;
        for (const { target } of changes) {
            if (!(target instanceof Element)) continue;
            if (target === readout) {
                const isNew = !readout.hidden && readout.textContent !== text;
                if (isNew && hover.readout === null) hover.readout = hover.latest = now;
            } else if (target.matches(".scanloom-marks")) {
                hover.marks[pictureOf(target)] = hover.latest = now;
            }
        }
    }).observe(document.body, { childList: true, subtree: true, attributes: true });
}"""


def answers(page: Page, picture: PictureName) -> Iterator[dict[str, Any]]:
    """What followed each of many moves over a picture, of those that were answered."""
    random, answered = Random(0), 0
    image = page.locator(f"div:has(> [data-picture='{picture}']) + div img")
    image.scroll_into_view_if_needed()
    box = image.bounding_box()
    assert box is not None
    for _ in range(4 * HOVERS):
        right, down = (random.uniform(_EDGE, 1.0 - _EDGE) for _ in range(2))
        page.evaluate("hover.begin()")
        page.mouse.move(box["x"] + right * box["width"], box["y"] + down * box["height"])
        try:
            page.wait_for_function("hover.isAnswered()", timeout=_ANSWERED_MS, polling=50)
        except TimeoutError:
            # Nothing is known of that place, or the same as before.
            continue
        yield page.evaluate("({ moved: hover.moved, readout: hover.readout, marks: hover.marks })")
        answered += 1
        if answered == HOVERS:
            return
    raise RuntimeError(f"{answered} moves over the {picture} picture were answered")


def hovering(page: Page, where: str) -> Iterator[Figure]:
    """The pointer over each picture."""
    for picture in PICTURES:
        readout_ms, marks_ms = [], []
        for answer in answers(page, picture):
            readout_ms.append(answer["readout"] - answer["moved"])
            others = [at for name, at in answer["marks"].items() if name != picture]
            if others:
                marks_ms.append(max(others) - answer["moved"])
        yield latency(f"{where}: {picture} to read-out", readout_ms, AIM_MS)
        # The strip is about frames, of which the others show one.
        if picture != "time":
            yield latency(f"{where}: {picture} to marks elsewhere", marks_ms, AIM_MS)


def figures(recording: Path, where: str) -> Iterator[Figure]:
    """All rows of one recording."""
    with serving(recording) as server, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=list(_DRAWING))
        page = browser.new_page(viewport=SCREEN)  # type: ignore[arg-type]  # a plain dictionary
        page.add_init_script(NO_DRAWING)
        page.add_init_script(CARD_OF_NO_NAME)
        page.goto(server.address)
        page.set_default_timeout(_ALIGNED_MS)
        page.get_by_label("Steps").get_by_role("button", name="Repair", exact=True).click()
        page.get_by_text("beams agree with the camera").wait_for()
        page.wait_for_function("!document.body.innerText.includes('counting noise')", polling=200)
        page.evaluate(WATCH)
        yield from hovering(page, where)
        browser.close()


def main() -> None:
    """Print the table; exit 1 where an aim is missed."""
    is_met = True
    with tempfile.TemporaryDirectory() as folder:
        panorama = Path(folder) / "panorama.mcap"
        write_panorama(panorama)
        print(f"{HOVERS} moves each; server on {CORES} cores")
        for recording, where in ((sample_path(), "sample"), (panorama, "panorama")):
            for figure in figures(recording, where):
                is_met &= figure.is_met
                missed = "" if figure.is_met else "  MISSED"
                print(f"{figure.name:<44}{figure.text}  (aim: {figure.aim}){missed}", flush=True)
    sys.exit(not is_met)


if __name__ == "__main__":
    main()
