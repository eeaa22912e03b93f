"""The review as a person does it: by keys, box and brush, blind, with others, after a crash."""

import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, expect

from fusion_core.model.labels import NO_LABEL, Capture, Label
from fusion_core.workflows.labels.open_store import LabelStore, open_labels
from scanloom.panels.pictures import DepthImagePanel
from scanloom.panels.profile import ProfilePanel
from tests.app.browser.person import Person
from tests.patience import ENOUGH_S

ROOT = Path(__file__).parents[3]
KEYS = {"1": Label.GOOD, "2": Label.HOLE, "3": Label.BURR, "4": Label.CONFLICT, "u": Label.UNSURE}
SOME_RUNS = re.compile(r"of [1-9]\d* runs")
NAME_FIELD = "xpath=//label[text()='Your name']/following::input[1]"


@pytest.fixture
def store(small_scene: Path) -> Iterator[LabelStore]:
    """The journal beside the recording, as another program reads it."""
    with open_labels(small_scene, create=True) as opened:
        yield opened


def begin(person: Person, name: str) -> None:
    """Open the step and begin, by the keyboard."""
    person.page.keyboard.press("Alt+5")
    person.wait_for_panel("Review")
    field = person.page.locator(NAME_FIELD)
    expect(field).to_be_visible()
    field.fill(name)
    person.button("Begin the review").focus()
    person.page.keyboard.press("Enter")
    expect(person.text("The answer is about the run.")).to_be_visible()
    person.page.evaluate("document.activeElement.blur()")
    # Once all frames are counted, the queue changes by answers alone.
    expect(person.page.get_by_text("frames counted so far")).to_have_count(0)


def state(store: LabelStore, layer: str) -> dict[Capture, list[list[int]]]:
    """All labels of a layer."""
    return {labels.capture: labels.as_image().tolist() for labels in store.labelled(layer)}


def actions(store: LabelStore, layer: str) -> int:
    return sum(1 for _ in store.actions(layer))


@pytest.fixture
def anna(arrive: Callable[..., Person]) -> Iterator[Person]:
    person = arrive()
    yield person
    person.page.context.close()


def test_a_hundred_runs_by_keys_and_back_and_forth(anna: Person, store: LabelStore) -> None:
    begin(anna, "anna")
    keyboard = anna.page.keyboard
    keyboard.press("Home")
    keyboard.press("j")
    anna.wait_until(lambda: anna.session.view.selected_beam is not None)
    pressed = [*KEYS] * 20
    for key in pressed:
        keyboard.press(key)
    anna.wait_until(lambda: actions(store, "anna") == 100)
    seen: set[tuple[Capture, int, int]] = set()
    for action, key in zip(store.actions("anna"), pressed, strict=True):
        for change in store.changes_of(action.id):
            # Each key answers for a run of its own, in the order of the keys.
            assert set(change.after.label.tolist()) == {int(KEYS[key])}
            assert set(change.before.label.tolist()) == {NO_LABEL}
            own = zip(change.after.row.tolist(), change.after.column.tolist(), strict=True)
            places = {(change.capture, *place) for place in own}
            assert not places & seen
            seen |= places
    labelled = state(store, "anna")
    expect(anna.page.get_by_label("Undo your last label")).to_be_visible()
    for _ in range(100):
        keyboard.press("Control+z")
    anna.wait_until(lambda: actions(store, "anna") == 200)
    assert state(store, "anna") == {}
    for _ in range(100):
        keyboard.press("Control+Shift+z")
    anna.wait_until(lambda: actions(store, "anna") == 300)
    assert state(store, "anna") == labelled


def test_box_and_brush_label_pixels_off_the_curve(anna: Person, store: LabelStore) -> None:
    begin(anna, "boris")
    anna.key("b")
    anna.wait_until(lambda: anna.session.view.review.tool == "box")
    corners = [(10.0, 20.0), (30.0, 28.0)]
    drag(anna, "depth", "box", [pixel(anna, *corner) for corner in corners])
    expect(anna.text("what you have marked: 0 beams, 189 pixels")).to_be_visible()
    anna.key("3")
    anna.wait_until(lambda: actions(store, "boris") == 1)
    expect(anna.text("189 pixels without a pair now")).to_be_visible()
    (labels,) = store.labelled("boris")
    assert labels.capture.sensor == "depth"
    expected = np.full((labels.capture.rows, labels.capture.columns), NO_LABEL)
    expected[20:29, 10:31] = Label.BURR
    np.testing.assert_array_equal(labels.as_image(), expected)

    anna.key("b")
    anna.wait_until(lambda: anna.session.view.review.tool == "brush")
    drag(anna, "depth", "brush", [pixel(anna, *place) for place in [(50.0, 30.0), (60.0, 30.0)]])
    expect(anna.text("what you have marked: 0 beams,")).to_be_visible()
    anna.key("2")
    anna.wait_until(lambda: actions(store, "boris") == 2)
    (labels,) = store.labelled("boris")
    image = labels.as_image()
    radius = anna.session.view.review.brush_px
    assert (image[30 - radius + 1 : 30 + radius, 50:61] == Label.HOLE).all()
    assert not (image[:, 61 + radius + 1 :] == Label.HOLE).any()
    np.testing.assert_array_equal(image[20:29, 10:31], expected[20:29, 10:31])


@pytest.mark.slow
def test_keys_go_to_a_field_that_has_the_focus_until_escape(
    anna: Person, store: LabelStore
) -> None:
    begin(anna, "cleo")
    anna.key("j")
    expect(anna.text("Automatic:")).to_be_visible()
    said = anna.page.locator(".scanloom-keys-off")
    expect(said).to_be_hidden()
    field = anna.page.get_by_role("textbox").locator("visible=true").first
    field.focus()
    expect(said).to_be_visible()
    anna.page.keyboard.press("3")
    anna.page.keyboard.press("Escape")
    expect(said).to_be_hidden()
    anna.page.keyboard.press("2")
    anna.wait_until(lambda: actions(store, "cleo") == 1)
    assert store.counts("cleo")[Label.BURR] == 0
    assert store.counts("cleo")[Label.HOLE] > 0


@pytest.mark.slow
def test_a_drag_on_the_profile_marks_beams(anna: Person, store: LabelStore) -> None:
    begin(anna, "carla")
    anna.key("b")
    anna.wait_until(lambda: anna.session.view.review.tool == "box")
    drawn = anna.panel(ProfilePanel)._drawn
    ends = [drawn.axes.to_pixel(float(drawn.azimuth_deg[at]), 0.0)[0] for at in (10, 30)]
    middle = drawn.axes.box.top + drawn.axes.box.height / 2
    drag(anna, "profile", "box", [anna.place_on("profile", x_px, middle) for x_px in ends])
    expect(anna.text("what you have marked:")).to_be_visible()
    anna.key("u")
    anna.wait_until(lambda: actions(store, "carla") == 1)
    (labels,) = store.labelled("carla")
    assert labels.capture.sensor == "lidar"
    assert set(labels.label.tolist()) == {Label.UNSURE}
    marked = set(labels.column.tolist())
    assert {int(beam) for beam in drawn.beam[11:30]} <= marked
    assert not {int(beam) for beam in [*drawn.beam[:9], *drawn.beam[32:]]} & marked


@pytest.mark.slow
def test_a_blind_review_tells_no_class(anna: Person, store: LabelStore) -> None:
    begin(anna, "dora")
    anna.key("j")
    expect(anna.text("Automatic:")).to_be_visible()
    review = anna.session.view.review.model_copy(update={"blind": True})
    anna.look_at(anna.session.view.changed(review=review))
    expect(anna.text("The automatic class is hidden.")).to_be_visible()
    expect(anna.page.get_by_text("Automatic:")).to_have_count(0)
    assert anna.frame_view.fused is None
    # Neither does the line below the strip of time, nor the buttons beside it.
    line = anna.page.locator(".scanloom-frame")
    expect(line).to_contain_text("Frame ")
    expect(line).not_to_contain_text(re.compile("pairs|noise|holes?|burrs?|conflicts?"))
    expect(anna.page.locator('[data-value="worst"]')).to_be_disabled()
    anna.key("3")

    anna.wait_until(lambda: store.counts("dora")[Label.BURR] > 0)


@pytest.mark.slow
def test_two_people_at_once_see_each_others_answers(
    anna: Person, arrive: Callable[..., Person], store: LabelStore
) -> None:
    ben = arrive()
    begin(anna, "emma")
    begin(ben, "fred")
    for person, key in ((anna, "3"), (ben, "1")):
        person.key("Home")
        person.wait_until(lambda person=person: person.frame_view.view.frame_index == 0)
        person.key("j")
        person.wait_until(lambda person=person: person.session.view.selected_beam is not None)
        person.key(key)
    anna.wait_until(lambda: actions(store, "emma") == actions(store, "fred") == 1)
    for person, layer, label in ((anna, "fred", "good"), (ben, "emma", "burr")):
        person.key("k")
        expect(person.text(f"{layer}: {label}")).to_be_visible()
    # The one takes back their own label alone.
    anna.key("Control+z")
    anna.wait_until(lambda: state(store, "emma") == {})
    assert store.counts("fred")[Label.GOOD] > 0
    ben.page.context.close()


@pytest.mark.slow
def test_a_second_window_of_one_person_stays_consistent(
    anna: Person, arrive: Callable[..., Person], store: LabelStore
) -> None:
    window = arrive()
    for person in (anna, window):
        begin(person, "gerda")
        person.key("Home")
        person.wait_until(lambda person=person: person.frame_view.view.frame_index == 0)
    anna.key("j")
    anna.wait_until(lambda: anna.session.view.selected_beam is not None)
    anna.key("2")
    anna.wait_until(lambda: actions(store, "gerda") == 1)
    # The other window passes over what is labelled, and takes it back.
    expect(window.page.locator(".scanloom-review-progress b")).to_have_text("1")
    window.key("Control+z")
    window.wait_until(lambda: actions(store, "gerda") == 2)
    expect(anna.page.locator(".scanloom-review-progress b")).to_have_text("0")
    window.page.context.close()


def pixel(person: Person, column: float, row: float) -> tuple[float, float]:
    """Where a pixel of the depth image lies on the screen."""
    return person.place_on(
        "depth", *person.panel(DepthImagePanel)._drawn.axes.to_pixel(column, row)
    )


def drag(person: Person, picture: str, tool: str, places: list[tuple[float, float]]) -> None:
    """Draw with a tool, once the page has heard of it."""
    shown = person.page.locator(f"[data-picture='{picture}']")
    person.wait_until(lambda: shown.get_attribute("data-tool") == tool)
    mouse = person.page.mouse
    mouse.move(*places[0])
    mouse.down()
    for place in places[1:]:
        mouse.move(*place, steps=6)
    mouse.up()


class Serving:
    """The command in a process of its own, which may be killed."""

    def __init__(self, recording: Path, labels: Path) -> None:
        command = [sys.executable, "-m", "scanloom", "view", str(recording)]
        command += ["--port", "0", "--json", "--labels", str(labels)]
        self.process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        assert self.process.stdout is not None
        self.address = json.loads(self.process.stdout.readline())["address"]

    def kill(self) -> None:
        """As a crash ends it."""
        self.process.kill()
        self.process.communicate()


@pytest.mark.slow
def test_a_server_that_is_killed_loses_nothing_but_the_key_in_flight(
    browser: Browser, small_scene: Path, tmp_path: Path
) -> None:
    labels = tmp_path / "killed.sqlite"
    answered = 0
    for key in ("3", "1"):
        serving = Serving(small_scene, labels)
        page = browser.new_page(viewport={"width": 900, "height": 600})
        page.set_default_timeout(ENOUGH_S * 1000)
        try:
            page.goto(serving.address)
            page.get_by_label("Steps").get_by_role("button", name="Review", exact=True).click()
            page.locator(NAME_FIELD).fill("ida")
            page.get_by_role("button", name="Begin the review", exact=True).click()
            # Until frames are counted there is no run to begin with.
            expect(page.locator(".scanloom-review-progress")).to_contain_text(SOME_RUNS)
            page.locator(".scanloom-verdict h2").click()
            page.keyboard.press("j")
            asked = page.locator(".scanloom-run h3")
            expect(asked).to_be_visible()
            for _ in range(5):
                before = asked.inner_text()
                page.keyboard.press(key)
                # The page goes on once the answer is kept.
                expect(asked).not_to_have_text(before)
                answered += 1
            page.keyboard.press(key)
        finally:
            serving.kill()
            page.close()
        with open_labels(small_scene, labels, create=False) as store:
            kept = actions(store, "ida")
        assert answered <= kept <= answered + 1
        answered = kept
