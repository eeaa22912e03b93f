"""Visual SLAM in a browser: a run that grows on the stage, its keyframes, and its layers."""

from collections.abc import Iterator
from threading import Event

import numpy as np
import pytest
from playwright.sync_api import expect

from scanloom.jobs import slam_run as job
from scanloom.server.workbench import Workbench
from scanloom.state.slam_choices import SlamChoices
from tests.app.browser.person import Person
from tests.app.visual_runs import FakeVisualMap, forward
from tests.patience import ENOUGH_S

RUN = "1: visual"


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeVisualMap]:
    fake = FakeVisualMap(forward, within_m=10.0)
    monkeypatch.setattr(job, "build_map", fake)
    return fake


@pytest.fixture
def newcomer(person: Person, workbench: Workbench) -> Person:
    """The resident in the mode, after a reload, so that their runs begin anew."""
    choices = SlamChoices(estimator="visual")
    view = person.session.view.changed(panel="Map", map_mode="SLAM", slam=choices)
    person.look_at(view)
    person.reload(workbench)
    expect(person.button("Run")).to_be_enabled()
    return person


def test_the_map_grows_and_ends_with_its_keyframes(newcomer: Person, fake: FakeVisualMap) -> None:
    person = newcomer
    begun, go_on = Event(), Event()

    def wait(number: int) -> None:
        if number == 1:
            begun.set()
            assert go_on.wait(ENOUGH_S), "nobody let it go on"

    fake.at_keyframe = wait
    person.press("Run")
    person.wait_until(begun.is_set)
    expect(person.text("1 image placed, 1 keyframe, 0 loops closed.")).to_be_visible()
    # The legend is of the map in space, and of no frame.
    for label in ("Map", "Cloud", "Keyframes", "Loops"):
        expect(person.page.locator(".scanloom-over-scene").get_by_text(label)).to_be_visible()
    expect(person.page.locator(".scanloom-over-scene").get_by_text("LiDAR curve")).to_have_count(0)
    go_on.set()
    expect(person.page.get_by_label("Run shown", exact=True)).to_have_value(RUN)
    expect(person.text("Both see")).to_be_visible()
    both = person.figure()
    assert both.shape[1] == 400
    person.drag("Keyframe", -200.0)
    person.wait_until(lambda: not np.array_equal(person.figure(), both))


def test_a_layer_is_switched_off_in_the_legend(newcomer: Person, fake: FakeVisualMap) -> None:
    person = newcomer
    person.press("Run")
    expect(person.text("Both see")).to_be_visible()
    person.page.locator(".scanloom-over-scene").get_by_text("Cloud").click()
    person.wait_until(lambda: person.session.view.hidden_layers == {"cloud"})
    person.open_step("Recording")
    expect(person.page.locator(".scanloom-over-scene").get_by_text("Keyframes")).to_have_count(0)
    expect(person.page.locator(".scanloom-over-scene").get_by_text("LiDAR curve")).to_be_visible()
