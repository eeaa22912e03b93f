"""One server and one browser for all tests of this folder, and its persons."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, ViewportSize, expect, sync_playwright

from fusion_core.workflows.convert import ConvertOptions, convert
from scanloom.server.workbench import ServeOptions, Workbench
from scanloom.state.view import View
from tests.app.browser.person import Person, at_session
from tests.hostile.topics import write_with_hostile_names
from tests.patience import ENOUGH_S

# The processor draws the scene, which asks for each next frame with the same function: one frame
# a second is enough of it. What the page asks for once, as for a drag, comes at once.
# With a longer time, a test that does not wait for the page to follow the server is found out.
FEW_FRAMES = """
const [draw, cancel] = [requestAnimationFrame.bind(window), cancelAnimationFrame.bind(window)];
const known = new WeakSet();
window.requestAnimationFrame = step => {
    if (known.has(step)) return -setTimeout(() => draw(step), 1000);
    known.add(step);
    return draw(step);
};
window.cancelAnimationFrame = id => id < 0 ? clearTimeout(-id) : cancel(id);
"""
# viser warns of software that draws, by a notice that never goes and lies over what is clicked.
CARD_OF_NO_NAME = """
const RENDERER = 0x9246;
for (const kind of [WebGLRenderingContext, WebGL2RenderingContext]) {
    const read = kind.prototype.getParameter;
    kind.prototype.getParameter = function (name) {
        return name === RENDERER ? "a card" : read.call(this, name);
    };
}
"""
SCREEN: ViewportSize = {"width": 900, "height": 600}
# What would be seen if a name were taken for HTML or Markdown.
HOSTILE = '<img src=x onerror="window.taken = 1"> **bold** ![a](b) <script>window.taken = 2.mcap'


def chromium() -> str:
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next((path for name in names if (path := shutil.which(name)) is not None), None)
    if found is None:
        pytest.skip(f"no browser on the PATH: none of {', '.join(names)}")
    return found


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    path = chromium()
    # The scene needs a graphics card, which is one of software here, as test machines have none;
    # the rest of the page is drawn without it, which takes less of the processor.
    drawing = [
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--disable-gpu-rasterization",
        "--disable-gpu-compositing",
    ]
    sandbox = ["--no-sandbox"] if os.getuid() == 0 else []
    expect.set_options(timeout=ENOUGH_S * 1000)
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=path, args=[*drawing, *sandbox])
        yield launched
        launched.close()


@pytest.fixture(scope="package")
def damaged(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording, cut off in the middle."""
    whole = small_scene.read_bytes()
    path = tmp_path_factory.mktemp("damaged") / "cut short.mcap"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    return path


@pytest.fixture(scope="package")
def hostile(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording with a name, topics and frame ids that do harm where they are not text."""
    path = tmp_path_factory.mktemp("hostile") / HOSTILE
    write_with_hostile_names(small_scene, path)
    return path


@pytest.fixture(scope="package")
def lidar_alone(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording's scans and odometry, without depth images."""
    path = tmp_path_factory.mktemp("lidar") / "lidar alone.mcap"
    convert(small_scene, path, ConvertOptions(topics=["/scan", "/odom"]), lambda *_: None)
    return path


@pytest.fixture(scope="package")
def output_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Below which the server may write."""
    return tmp_path_factory.mktemp("out")


@pytest.fixture(scope="package")
def workbench(
    small_scene: Path, damaged: Path, hostile: Path, lidar_alone: Path, output_root: Path
) -> Iterator[Workbench]:
    recordings = [small_scene, damaged, hostile, lidar_alone]
    options = ServeOptions(recordings=recordings, port=0, output_root=output_root)
    with Workbench(options) as serving:
        yield serving


@pytest.fixture(scope="package")
def arrive(browser: Browser, workbench: Workbench) -> Iterator[Callable[..., Person]]:
    """A person opens a path of the server in a browser of their own, which may be of another kind
    than the others'."""
    # Few pixels: they are drawn by the processor.
    contexts = []

    def open_in_own_browser(path: str = "/", **device: Any) -> Person:
        context = browser.new_context(**{"viewport": SCREEN, "device_scale_factor": 0.5} | device)
        context.set_default_timeout(ENOUGH_S * 1000)
        context.add_init_script(FEW_FRAMES)
        context.add_init_script(CARD_OF_NO_NAME)
        contexts.append(context)
        page = context.new_page()
        known = workbench.sessions
        page.goto(f"{workbench.address}{path}")
        return at_session(page, workbench, known)

    yield open_in_own_browser
    for context in contexts:
        context.close()


@pytest.fixture(scope="package")
def resident(arrive: Callable[..., Person]) -> Person:
    """One person for all tests that need no other."""
    return arrive()


@pytest.fixture
def person(resident: Person, small_scene: Path) -> Person:
    """The resident before a view as a new one is."""
    resident.look_at(View(recording=small_scene.name))
    return resident
