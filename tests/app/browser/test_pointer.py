"""Pictures that answer: what the pointer is on is read out and lights up in the other views."""

import re

import numpy as np
from playwright.sync_api import expect

from scanloom.panels.pictures import DepthImagePanel
from scanloom.plots.pair_pixels import pixels_of_match
from tests.app.browser.expected_frame import NUMBER
from tests.app.browser.person import Person


def marks_of(person: Person, name: str) -> int:
    return person.page.locator(
        f"div:has(> [data-picture='{name}']) + div svg.scanloom-marks path"
    ).count()


def place_of_pixel(person: Person, row: int, column: int) -> tuple[float, float]:
    """Where a pixel of the depth image lies on the screen."""
    panel = person.panel(DepthImagePanel)
    return person.place_on("depth", *panel._drawn.axes.to_pixel(column, row))


def test_a_pixel_is_read_out_and_lights_up_elsewhere(person: Person) -> None:
    person.look_at(person.session.view.changed(frame_index=NUMBER, panel="Match"))
    match = person.frame_view.match
    assert match is not None
    pixels = pixels_of_match(match)
    at = int(np.flatnonzero(pixels.row >= 0)[40])
    row, column = int(pixels.row[at]), int(pixels.column[at])
    person.page.mouse.move(*place_of_pixel(person, row, column))
    readout = person.page.locator(".scanloom-readout")
    expect(readout).to_contain_text(re.compile(r"row \d+, column \d+: (depth [\d.]+ m|no depth)"))
    expect(readout).to_contain_text(re.compile(r"beam \d+, [\d.]+° (left|right)"))
    assert marks_of(person, "depth") == 2
    person.wait_until(lambda: marks_of(person, "similarity") == 2)
    person.page.mouse.move(450.0, 100.0)
    expect(readout).to_be_hidden()
    person.wait_until(lambda: marks_of(person, "similarity") == 0)


def test_a_click_on_a_pixel_opens_why_its_beam_has_its_class(person: Person) -> None:
    person.look_at(person.session.view.changed(frame_index=NUMBER, panel="Repair"))
    match = person.frame_view.match
    assert match is not None
    pixels = pixels_of_match(match)
    at = int(np.flatnonzero(pixels.row >= 0)[40])
    person.page.mouse.click(*place_of_pixel(person, int(pixels.row[at]), int(pixels.column[at])))
    person.wait_until(lambda: person.session.view.selected_beam is not None)
    beam = person.session.view.selected_beam
    near = np.abs(pixels.beam - beam) if beam is not None else np.array([99])
    assert near.min() == 0
    assert abs(int(pixels.beam[at]) - int(beam or 0)) <= 3
    expect(person.text(f"beam {beam}, range")).to_be_visible()


def test_light_and_dark_by_a_button_and_by_the_browsers_wish(person: Person) -> None:
    ground = "getComputedStyle(document.querySelector('[data-mantine-color-scheme]')).colorScheme"
    assert person.page.evaluate(ground) == "light"
    person.page.emulate_media(color_scheme="dark")
    person.wait_until(lambda: person.page.evaluate(ground) == "dark")
    person.page.get_by_label("Light or dark").click()
    person.wait_until(lambda: person.page.evaluate(ground) == "light")
    person.page.emulate_media(color_scheme="light")
    # Not before the server has heard of it: until then the browser asked for dark.
    person.wait_until(lambda: not person.session._prefers_dark)
    person.look_at(person.session.view.changed(color_scheme="auto"))
    person.wait_until(lambda: person.page.evaluate(ground) == "light")


def test_a_key_makes_letters_large_and_small_again(person: Person) -> None:
    size = "getComputedStyle(document.documentElement).fontSize"
    before = person.page.evaluate(size)
    person.key("p")
    person.wait_until(lambda: person.page.evaluate(size) == "20px")
    person.key("p")
    person.wait_until(lambda: person.page.evaluate(size) == before)
