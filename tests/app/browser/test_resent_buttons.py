"""Buttons in HTML that the server sends anew while the mouse is down on them."""

from collections.abc import Callable

import pytest
from playwright.sync_api import Locator

from scanloom.panels.timeline import TimelinePanel
from tests.app.browser.person import Person, middle_of

Presses = list[tuple[str, str]]


@pytest.fixture
def presses(person: Person, monkeypatch: pytest.MonkeyPatch) -> Presses:
    """The names and values of all presses that the server hears of."""
    bridge = person.panel(TimelinePanel)._picture._bridge
    heard: Presses = []

    def also_note(name: str, call: Callable[[str], None]) -> Callable[[str], None]:
        def answer(value: str) -> None:
            heard.append((name, value))
            call(value)

        return answer

    for name, call in list(bridge._on_press.items()):
        monkeypatch.setitem(bridge._on_press, name, also_note(name, call))
    return heard


def next_frame(person: Person) -> Locator:
    return person.page.get_by_label("Next frame", exact=True)


def step(person: Person, name: str) -> Locator:
    return person.page.get_by_label("Steps").get_by_role("button", name=name, exact=True)


def wait_for_presses(person: Person, presses: Presses, expected: Presses) -> None:
    """Wait until the server has heard of a last press, and compare all."""
    # Presses are heard in order: once the last one is, none is under way.
    person.page.get_by_label("Last frame", exact=True).click()
    last = ("timeline", "last")
    person.wait_until(lambda: last in presses)
    assert presses == [*expected, last]


def resend_under(person: Person, button: Locator, change: Callable[[], None]) -> None:
    """Press the mouse on a button, and let it go when another one has taken its place."""
    # At the top, so that what stands below it moves nothing.
    button.evaluate("it => { for (; it; it = it.parentElement) it.scrollTop = 0; }")
    mouse, place = person.page.mouse, person.middle_at_rest(button)
    mouse.move(*place)
    before = button.element_handle()
    mouse.down()
    change()
    person.wait_until(lambda: not before.evaluate("it => it.isConnected"))
    person.wait_until(lambda: lies_at(button, place))
    mouse.up()


def lies_at(button: Locator, place: tuple[float, float]) -> bool:
    """Whether a place on the screen is on a button."""
    box = button.bounding_box()
    return (
        box is not None
        and box["x"] < place[0] < box["x"] + box["width"]
        and box["y"] < place[1] < box["y"] + box["height"]
    )


def test_a_button_of_the_timeline_is_pressed_once(person: Person, presses: Presses) -> None:
    resend_under(person, next_frame(person), lambda: person.session.change(playback_speed=2.0))
    person.wait_until(lambda: person.session.view.frame_index == 1)
    wait_for_presses(person, presses, [("timeline", "next")])


def test_a_step_is_opened_once(person: Person, presses: Presses) -> None:
    resend_under(person, step(person, "Register"), lambda: person.session.change(panel="Repair"))
    person.wait_for_panel("Register")
    wait_for_presses(person, presses, [("step", "Register")])


def test_a_tool_is_used_once(person: Person, presses: Presses) -> None:
    letters = person.page.get_by_label("Large, for a projector (P)")
    resend_under(person, letters, lambda: person.session.change(color_scheme="dark"))
    person.wait_until(lambda: person.session.view.large_text)
    wait_for_presses(person, presses, [("projector", "")])


def test_ordinary_clicks_are_pressed_once_each(person: Person, presses: Presses) -> None:
    next_frame(person).click()
    step(person, "Map").click()
    next_frame(person).click()
    steps = [("timeline", "next"), ("step", "Map"), ("timeline", "next")]
    wait_for_presses(person, presses, steps)


def test_a_button_that_the_mouse_has_left_is_not_pressed(person: Person, presses: Presses) -> None:
    mouse = person.page.mouse
    for left, entered in (("Next frame", "Previous frame"), ("First frame", "Next frame")):
        mouse.move(*middle_of(person.page.get_by_label(left, exact=True)))
        mouse.down()
        mouse.move(*middle_of(person.page.get_by_label(entered, exact=True)))
        mouse.up()
    wait_for_presses(person, presses, [])
