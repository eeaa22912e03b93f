"""The workbench as a person uses it: a real server and a real browser."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from base64 import b64decode
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
from playwright.sync_api import Browser, Locator, Page, ViewportSize, expect, sync_playwright

from app.desk import STORED_VIEW, Desk
from app.server import ServeOptions, Workbench
from app.shown import Shown
from app.state.library import Opened
from app.state.view import PANELS, PanelName, View
from fusion_core.workflows.frame import FrameMatch
from fusion_core.workflows.inspect import info
from fusion_core.workflows.live import FrameChoice
from fusion_core.workflows.presets import PRESETS
from tests.app.viser_client import connect

ROOT = Path(__file__).parents[2]
ENOUGH_S = 60.0
SCREEN: ViewportSize = {"width": 900, "height": 600}
# What would be seen if a name were taken for HTML or Markdown.
HOSTILE = '<img src=x onerror="window.taken = 1"> **bold** ![a](b) <script>window.taken = 2.mcap'

FETCH = """async image => {
    const bytes = new Uint8Array(await (await fetch(image.src)).arrayBuffer());
    return btoa(Array.from(bytes, byte => String.fromCharCode(byte)).join(''));
}"""


@dataclass
class Person:
    """Somebody before a browser, and the desk that the server gave them."""

    page: Page
    desk: Desk

    def look_at(self, view: View) -> None:
        """Go there at once, and wait until it is shown."""
        self.desk.change(**dict(view))
        self.wait_until(lambda: self.shown.view == view and self.shown.chain is not None)

    @property
    def shown(self) -> Shown:
        """What the desk has shown last."""
        assert self.desk.shown is not None
        return self.desk.shown

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait for what no text on the page tells."""
        deadline_s = time.monotonic() + ENOUGH_S
        while not condition():
            assert time.monotonic() < deadline_s, "it never came true"
            self.page.wait_for_timeout(50)

    def wait_for_peak(self, peak: tuple[float, float]) -> None:
        """Wait until the Match panel's words say it."""
        expect(self.text("Peak u =")).to_be_visible()
        self.wait_until(lambda: self.peak() == peak)

    def wait_for_number(self, label: str, value: float, within: float) -> None:
        """Wait until a number's field shows a value, but for less than ``within``."""
        self.wait_until(lambda: abs(self.number(label) - value) < within)

    def wait_for_another_picture(self, than: np.ndarray) -> np.ndarray:
        """The open panel's picture, once it is not ``than`` any more."""
        self.wait_until(lambda: not np.array_equal(self.picture(), than))
        return self.picture()

    def wait_for_panel(self, panel: PanelName) -> None:
        """Wait until a panel is shown."""
        self.wait_until(lambda: self.shown.view.panel == panel)

    def press(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).click()

    def choose(self, label: str, option: str) -> None:
        self.page.get_by_label(label, exact=True).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def thumb(self, label: str) -> Locator:
        """What is dragged of a slider."""
        slider = self.page.locator("label", has_text=re.compile(f"^{label}$")).get_attribute("for")
        return self.page.locator(f"[id='{slider}'] [role='slider']")

    def drag(self, label: str, by_px: float) -> float:
        """Drag a slider to the right; return the value at which it stands then."""
        thumb = self.thumb(label)
        thumb.scroll_into_view_if_needed()
        x, y = middle_of(thumb)
        mouse = self.page.mouse
        mouse.move(x, y)
        mouse.down()
        mouse.move(x + by_px, y, steps=8)
        mouse.up()
        value = thumb.get_attribute("aria-valuenow")
        assert value is not None
        return float(value)

    def number(self, label: str) -> float:
        """What a number's field shows."""
        return float(self.page.get_by_label(label, exact=True).input_value())

    def key(self, name: str) -> None:
        """Press a key after a click on some text: what is typed into a widget is for it."""
        self.page.get_by_text(re.compile(r"frame \d+ of \d+")).first.click()
        self.page.keyboard.press(name)

    def text(self, words: str) -> Locator:
        """Text that is seen and has these words in it."""
        return self.page.get_by_text(words).locator("visible=true").first

    def peak(self) -> tuple[float, float]:
        """(u, v) of the peak in the Match panel's words."""
        found = re.search(r"u = (-?[\d.]+), v = ([\d.]+)", self.text("Peak u =").inner_text())
        assert found is not None
        return float(found[1]), float(found[2])

    def picture(self) -> np.ndarray:
        """(H, W, 3) the first picture that the open panel shows."""
        shown = self.page.locator("img[src^='blob:']").locator("visible=true")
        image = shown.first.element_handle()
        data = b64decode(self.page.evaluate(FETCH, image))
        return decoded(data)

    def screen(self) -> np.ndarray:
        """(H, W, 3) what the browser shows."""
        return decoded(self.page.screenshot())


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


def chromium() -> str:
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next((path for name in names if (path := shutil.which(name)) is not None), None)
    if found is None:
        pytest.skip(f"no browser on the PATH: none of {', '.join(names)}")
    return found


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = chromium()
    # Drawn without a graphics card, as test machines have none.
    drawing = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    sandbox = ["--no-sandbox"] if os.getuid() == 0 else []
    with sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=path, args=[*drawing, *sandbox])
        yield launched
        launched.close()


@pytest.fixture(scope="module")
def damaged(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording, cut off in the middle."""
    whole = small_scene.read_bytes()
    path = tmp_path_factory.mktemp("damaged") / "cut short.mcap"
    path.write_bytes(whole[: len(whole) * 2 // 3])
    return path


@pytest.fixture(scope="module")
def workbench(
    small_scene: Path, damaged: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Workbench]:
    hostile = tmp_path_factory.mktemp("hostile") / HOSTILE
    hostile.write_bytes(small_scene.read_bytes())
    options = ServeOptions(
        recordings=[small_scene, damaged, hostile],
        port=0,
        output_root=tmp_path_factory.mktemp("out"),
    )
    with Workbench(options) as serving:
        yield serving


@pytest.fixture(scope="module")
def arrive(browser: Browser, workbench: Workbench) -> Iterator[Callable[..., Person]]:
    """Somebody opens a path of the server in a browser of their own."""
    # Few pixels: they are drawn by the processor.
    contexts = []

    def open_in_own_browser(path: str = "/") -> Person:
        context = browser.new_context(viewport=SCREEN, device_scale_factor=0.5)
        context.set_default_timeout(ENOUGH_S * 1000)
        contexts.append(context)
        page = context.new_page()
        known = workbench.desks
        page.goto(f"{workbench.address}{path}")
        return at_desk(page, workbench, known)

    expect.set_options(timeout=ENOUGH_S * 1000)
    yield open_in_own_browser
    for context in contexts:
        context.close()


def at_desk(page: Page, workbench: Workbench, known: list[Desk]) -> Person:
    """The person at a page whose desk is none of those known; their recording is aligned."""
    deadline_s = time.monotonic() + ENOUGH_S
    while time.monotonic() < deadline_s:
        for desk in workbench.desks:
            if desk not in known and desk.shown is not None and desk.shown.chain is not None:
                return Person(page, desk)
        page.wait_for_timeout(50)
    raise AssertionError("no desk was made")


@pytest.fixture(scope="module")
def resident(arrive: Callable[..., Person]) -> Person:
    """One person for all tests that need no other."""
    return arrive()


@pytest.fixture
def person(resident: Person, small_scene: Path) -> Person:
    """The resident before a view as a new one is."""
    resident.look_at(View(recording=small_scene.name))
    return resident


def match_of(opened: Opened, view: View) -> FrameMatch:
    """What the chain computes for a view."""
    assert opened.chain is not None
    return opened.chain.matched(FrameChoice(number=view.number), view.settings)


def peak_of(opened: Opened, view: View) -> tuple[float, float]:
    """(u, v) of the peak as the Match panel writes it."""
    peak = match_of(opened, view).search.peaks[view.settings.search.metric]
    return round(peak.u, 2), round(peak.v, 1)


def test_the_page_shows_the_scene_and_the_panel(person: Person, small_scene: Path) -> None:
    expect(person.text(small_scene.name)).to_be_visible()
    expect(person.text("as the preset default has it")).to_be_visible()
    canvas = person.page.locator("canvas[data-engine]").bounding_box()
    assert canvas is not None
    assert canvas["width"] > 400
    # Rows, pairs and boards are drawn over a white ground.
    person.wait_until(lambda: 0.01 < coloured_share(person, canvas["width"]) < 0.9)


def coloured_share(person: Person, width_px: float) -> float:
    """How much of the scene is neither ground nor grid."""
    return float(colourful(person.screen()[:, : int(width_px / 2)]).mean())


def test_the_streams_are_listed_with_their_counts(person: Person, small_scene: Path) -> None:
    listed = [row.split("\t") for row in person.page.locator("tr:visible").all_inner_texts()]
    found = {name: (role, int(count), rate) for name, role, count, rate in listed[1:]}
    expected = {
        topic["name"]: (
            topic["role"].replace("_", " "),
            topic["count"],
            "–" if topic["rate_hz"] is None else f"{topic['rate_hz']:.1f}",
        )
        for topic in info(small_scene)["topics"]
    }
    assert found == expected
    assert found["/scan"][:2] == ("lidar", 20)


def test_the_sampling_slider_changes_heatmap_and_peak(person: Person) -> None:
    person.press("Match")
    expect(person.text("Peak u =")).to_be_visible()
    opened = person.shown.opened
    first = peak_of(opened, person.desk.view)
    assert person.peak() == first
    before = person.picture()
    step_deg = person.drag("Degrees a sample", 60.0)
    assert step_deg > 1.0
    person.wait_until(lambda: person.shown.view.settings.sampling.step_deg == step_deg)
    second = peak_of(opened, person.shown.view)
    assert second != first
    person.wait_for_peak(second)
    person.wait_for_another_picture(before)
    # A slow drag may be several changes.
    while person.desk.view.differing():
        person.press("Undo")
        person.page.wait_for_timeout(100)
    person.wait_for_peak(first)
    person.wait_until(lambda: np.array_equal(person.picture(), before))


def test_a_click_on_the_heatmap_picks_the_offset_under_it(person: Person) -> None:
    person.press("Match")
    expect(person.text("Peak u =")).to_be_visible()
    picture = person.picture()
    field = match_of(person.shown.opened, person.desk.view).search.fields["euclidean"]
    canvas = person.page.locator("canvas[data-engine]").bounding_box()
    assert canvas is not None
    person.press("Heatmap")
    # The board stands straight before the camera and fills the screen's height but for a tenth.
    picture_per_screen_px = 1.1 * picture.shape[1] / canvas["height"]
    x = canvas["x"] + canvas["width"] / 2
    y = canvas["y"] + canvas["height"] / 2
    around = np.s_[round(y / 2) - 20 : round(y / 2) + 60, round(x / 2) - 60 : round(x / 2) + 60]
    person.wait_until(lambda: bool(colourful(person.screen()[around]).mean() > 0.5))
    rows, columns = field.scores.shape
    for right_px, down_px in ((30.0, 20.0), (-90.0, 60.0)):
        person.page.mouse.click(x + right_px, y + down_px)
        left, top, width, height = box_of_field(picture)
        x_px = (picture.shape[1] - 1) / 2 + right_px * picture_per_screen_px
        y_px = (picture.shape[0] - 1) / 2 + down_px * picture_per_screen_px
        u = field.u_first + (x_px - left + 0.5) * columns / width - 0.5
        v = (y_px - top + 0.5) * rows / height - 0.5
        person.wait_for_number("u (samples)", u, within=1.0)
        person.wait_for_number("v (row)", v, within=1.0)
        # The mark of what was picked takes a line below the next picture.
        picture = person.wait_for_another_picture(picture)
    expect(person.text("Picked by hand: u =")).to_be_visible()
    assert person.desk.view.picked is not None
    person.press("Clear")
    u, v = peak_of(person.shown.opened, person.desk.view)
    person.wait_for_number("u (samples)", u, within=0.01)
    # Rows are shown whole.
    person.wait_for_number("v (row)", v, within=0.51)


def box_of_field(picture: np.ndarray) -> tuple[int, int, int, int]:
    """(left, top, width, height) of the field in a heatmap: its largest coloured part."""
    mask = cv2.morphologyEx(
        colourful(picture).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8)
    )
    _, _, boxes, _ = cv2.connectedComponentsWithStats(mask)
    left, top, width, height, _ = max(boxes[1:], key=lambda box: int(box[cv2.CC_STAT_AREA]))
    return int(left), int(top), int(width), int(height)


def test_the_keys_go_through_the_frames(person: Person) -> None:
    times_ns = person.shown.opened.frames.times_ns
    count = len(times_ns)
    for key, number in (
        ("PageDown", 1),
        ("PageDown", 2),
        ("PageUp", 1),
        ("End", count - 1),
        ("PageDown", 0),
        ("PageUp", count - 1),
        ("Home", 0),
    ):
        person.key(key)
        time_s = (times_ns[number] - times_ns[0]) / 1e9
        expect(person.text(f"{time_s:.3f} s · frame {number} of {count}")).to_be_visible()
        expect(person.thumb("Frame")).to_have_attribute("aria-valuenow", str(number))
        assert person.desk.view.number == number


def test_a_preset_changes_the_line_of_differences_and_undo_brings_it_back(person: Person) -> None:
    person.desk.set("noise", "epsilon", 2.5)
    expect(person.text("differs: noise.epsilon = 2.5")).to_be_visible()
    person.choose("Preset", "published")
    expect(person.text("as the preset published has it")).to_be_visible()
    person.wait_until(lambda: person.shown.view.preset == "published")
    person.press("Undo")
    expect(person.text("differs: noise.epsilon = 2.5")).to_be_visible()
    assert person.page.get_by_label("Preset", exact=True).input_value() == "default"
    person.press("Reset")
    expect(person.text("as the preset default has it")).to_be_visible()


def kept_by(page: Page) -> str | None:
    """The link of the view that a browser keeps."""
    kept: str | None = page.evaluate(f"localStorage.getItem('viser-user:{STORED_VIEW}')")
    return kept


def assert_shows(person: Person, view: View) -> None:
    """The page shows frame, settings and panel of a view whose panel is Match."""
    assert person.desk.view == view
    count = len(person.shown.opened.frames)
    expect(person.text(f"frame {view.number} of {count}")).to_be_visible()
    expect(person.text(f"sampling.step_deg = {view.settings.sampling.step_deg}")).to_be_visible()
    assert person.page.get_by_label("Recording", exact=True).count() == 0
    person.wait_for_peak(peak_of(person.shown.opened, view))


def changed(view: View) -> View:
    """Another frame, another panel, another setting."""
    return view.with_setting("sampling", "step_deg", 1.75).changed(number=11, panel="Match")


def test_a_reload_brings_everything_back(person: Person, workbench: Workbench) -> None:
    view = changed(person.desk.view)
    person.look_at(view)
    person.wait_until(lambda: kept_by(person.page) == view.to_link())
    known = workbench.desks
    person.page.reload()
    again = at_desk(person.page, workbench, known)
    person.desk = again.desk
    assert_shows(again, view)


@pytest.fixture(scope="module")
def friend(arrive: Callable[..., Person], small_scene: Path) -> Person:
    """Somebody who followed a link, in a browser that had never seen the workbench."""
    return arrive(f"/go?view={changed(View(recording=small_scene.name)).to_link()}")


def test_a_link_brings_everything_into_another_browser(person: Person, friend: Person) -> None:
    view = changed(person.desk.view)
    assert_shows(friend, view)
    assert friend.page.url.endswith("/")
    person.look_at(view)
    person.press("Link")
    dialog = person.page.get_by_role("dialog")
    link = dialog.get_by_role("textbox").input_value()
    dialog.get_by_role("button", name="Close", exact=True).click()
    expect(dialog).to_have_count(0)
    assert link == f"/go?view={view.to_link()}"


def test_what_one_does_changes_nothing_for_another(person: Person, friend: Person) -> None:
    first = person.desk.view.changed(panel="Match")
    person.look_at(first)
    friend.look_at(first)
    friend.choose("Preset", "published")
    person.choose("Score", "cosine")
    friend.key("End")
    last = len(friend.shown.opened.frames) - 1
    expect(friend.text("as the preset published has it")).to_be_visible()
    expect(friend.text(f"frame {last} of {last + 1}")).to_be_visible()
    expect(person.text("search.metric = cosine")).to_be_visible()
    expect(person.text(f"frame 0 of {last + 1}")).to_be_visible()
    assert person.desk.view == first.with_setting("search", "metric", "cosine")
    published = PRESETS["published"]
    assert friend.desk.view == first.changed(
        preset="published", settings=published, aligned=published, number=last
    )
    friend.wait_until(
        lambda: friend.shown.view == friend.desk.view and friend.shown.match is not None
    )
    for someone in (person, friend):
        someone.wait_for_peak(peak_of(someone.shown.opened, someone.desk.view))


def test_a_recording_cut_in_the_middle_warns_and_works(
    person: Person, small_scene: Path, damaged: Path
) -> None:
    whole = len(person.shown.opened.frames)
    person.choose("Recording", damaged.name)
    expect(person.text("Warning:")).to_be_visible()
    expect(person.text(info(damaged)["warnings"][0])).to_be_visible()
    person.wait_until(lambda: person.shown.view.recording == damaged.name)
    person.wait_until(lambda: person.shown.fused is not None)
    left = len(person.shown.opened.frames)
    assert whole // 3 < left < whole
    person.key("End")
    expect(person.text(f"frame {left - 1} of {left}")).to_be_visible()
    person.key("Home")
    person.press("Match")
    person.wait_for_peak(peak_of(person.shown.opened, View(recording=damaged.name)))


def test_a_hostile_name_is_text(person: Person) -> None:
    header = person.page.get_by_text(HOSTILE, exact=True).locator("visible=true")
    expect(header).to_have_count(0)
    person.choose("Recording", HOSTILE)
    expect(header).to_have_count(1)
    assert person.page.get_by_label("Recording", exact=True).input_value() == HOSTILE
    person.wait_until(lambda: person.shown.view.recording == HOSTILE)
    for number, panel in enumerate(PANELS):
        person.key(f"Alt+{number + 1}")
        person.wait_for_panel(panel)
    assert person.page.evaluate("window.taken") is None
    assert person.page.locator("img[src='x'], img[src='b']").count() == 0
    assert person.page.locator("strong", has_text="bold").count() == 0


def test_the_command_serves_until_it_is_interrupted(small_scene: Path) -> None:
    command = [sys.executable, "-m", "app.cli", "view", str(small_scene), "--port", "0", "--json"]
    with subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as serving:
        assert serving.stdout is not None
        try:
            address = json.loads(serving.stdout.readline())["address"]
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+", address)
            with urlopen(address, timeout=ENOUGH_S) as page:
                assert b"<html" in page.read()
            with connect(address) as client:
                title = f'<b>ScanLoom</b> <span style="opacity:0.75">{small_scene.name}</span>'
                client.wait_until(lambda: any_content(client, title), ENOUGH_S)
                serving.send_signal(signal.SIGINT)
                rest, errors = serving.communicate(timeout=10.0)
        finally:
            serving.kill()
    assert (serving.returncode, rest, errors) == (0, "", "")


def any_content(client: object, words: str) -> bool:
    widgets = list(client.widgets.values())  # type: ignore[attr-defined]  # a ViserClient
    return any(words in str(widget.props.get("content")) for widget in widgets)
