"""The page on a phone: one sheet below the scene, and fingers instead of a mouse."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect

from scanloom.page.events import PictureName
from scanloom.panels.pictures import DepthImagePanel
from scanloom.panels.timeline import TimelinePanel
from scanloom.plots.pair_pixels import pixels_of_match
from scanloom.state.view import PANELS, View
from tests.app.browser.person import Person

WIDTH_PX, HEIGHT_PX = 390, 844
# The panels beside the main one are sections of the sheet.
SECTIONS: dict[str, PictureName] = {
    "Depth image": "depth",
    "Where do they fit?": "similarity",
    "Time and ranges": "time",
}

# What can be read or pressed and is cut off by the screen's right side.
BEYOND = """() => [...document.querySelectorAll("button, input, textarea, img, table, h2, p")]
    .filter(it => it.checkVisibility() && it.getBoundingClientRect().right > innerWidth + 1)
    .map(it => it.outerHTML.slice(0, 200))"""


@pytest.fixture(scope="module")
def owner(arrive: Callable[..., Person]) -> Iterator[Person]:
    """A person with a phone, who has opened all sections."""
    screen = {"width": WIDTH_PX, "height": HEIGHT_PX}
    person = arrive(viewport=screen, has_touch=True, is_mobile=True)
    for name, picture in SECTIONS.items():
        head = person.page.get_by_text(name, exact=True)
        expect(person.live(picture)).to_be_hidden()
        head.tap()
        expect(person.live(picture)).to_be_visible()
    yield person
    person.page.context.close()


@pytest.fixture
def phone(owner: Person, small_scene: Path) -> Person:
    owner.look_at(View(recording=small_scene.name))
    return owner


def is_on_screen(phone: Person, picture: PictureName) -> bool:
    """Whether a picture is as wide as can be seen, once it is scrolled to."""
    image = phone.live(picture)
    image.scroll_into_view_if_needed()
    phone.middle_at_rest(image)
    box = image.bounding_box()
    assert box is not None
    is_seen = box["y"] > 0.0 and box["y"] < HEIGHT_PX
    return is_seen and box["x"] >= 0.0 and box["x"] + box["width"] <= WIDTH_PX


def test_pictures_and_verdict_are_reached(phone: Person) -> None:
    for picture in (*SECTIONS.values(), "profile"):
        phone.wait_until(lambda picture=picture: is_on_screen(phone, picture))
    verdict = phone.page.locator(".scanloom-verdict h2")
    verdict.scroll_into_view_if_needed()
    expect(verdict).to_be_in_viewport()
    legend = phone.page.get_by_role("group", name="Legend", exact=True).last
    expect(legend.get_by_role("button", name="LiDAR curve")).to_be_in_viewport(ratio=1.0)


@pytest.mark.parametrize(
    "large", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["letters", "large letters"]
)
def test_nothing_is_wider_than_the_screen(phone: Person, large: bool) -> None:
    for name in PANELS:
        phone.look_at(phone.session.view.changed(panel=name, large_text=large))
        expect(phone.page.locator(f"[aria-current=step][data-value='{name}']")).to_be_visible()
        # The page cannot be moved sideways, and nothing is cut off beside it.
        assert phone.page.evaluate("document.documentElement.scrollWidth") <= WIDTH_PX, name
        assert phone.page.evaluate(BEYOND) == [], name


def test_a_tap_opens_a_step_and_goes_to_the_next_frame(phone: Person) -> None:
    phone.page.get_by_label("Steps").get_by_role("button", name="Match", exact=True).tap()
    phone.wait_for_panel("Match")
    expect(phone.page.locator(".scanloom-verdict h2")).to_contain_text("fits best at row")
    phone.page.get_by_label("Next frame", exact=True).tap()
    phone.wait_until(lambda: phone.frame_view.view.frame_index == 1)


def test_a_tap_on_the_depth_image_selects_the_beam_there(phone: Person) -> None:
    phone.look_at(phone.session.view.changed(panel="Repair"))
    match = phone.frame_view.match
    assert match is not None
    pixels = pixels_of_match(match)
    at = int(np.flatnonzero(pixels.row >= 0)[40])
    axes = phone.panel(DepthImagePanel)._drawn.axes
    place_px = axes.to_pixel(int(pixels.column[at]), int(pixels.row[at]))
    phone.page.touchscreen.tap(*phone.place_on("depth", *place_px))
    phone.wait_until(lambda: phone.session.view.selected_beam is not None)
    assert abs(int(pixels.beam[at]) - int(phone.session.view.selected_beam or 0)) <= 3
    expect(phone.text(f"beam {phone.session.view.selected_beam}, range")).to_be_visible()


def test_a_finger_drags_through_the_frames(phone: Person) -> None:
    strip = phone.panel(TimelinePanel)._strip
    screen = phone.page.context.new_cdp_session(phone.page)
    for kind, frame in (("touchStart", 2), ("touchMove", 5), ("touchMove", 9), ("touchMove", 12)):
        x, y = phone.place_on("time", *strip.place_of(frame))
        points = [{"x": x, "y": y}]
        screen.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        if kind == "touchMove":
            phone.wait_until(lambda frame=frame: phone.session.view.frame_index == frame)
    screen.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    screen.detach()
    phone.page.get_by_label("Next frame", exact=True).tap()
    phone.wait_until(lambda: phone.frame_view.view.frame_index == 13)
