"""The time strip under the mouse: a click goes to a frame, a drag through the frames."""

import numpy as np
import pytest

from scanloom.page.layout import page_sizes
from scanloom.panels.timeline import TimelinePanel
from tests.app.browser.conftest import SCREEN
from tests.app.browser.person import Person

WIDTH_PX = page_sizes(SCREEN["width"], SCREEN["height"]).profile_px[0]
# Faster than the page sends what it has seen.
AT_ONCE = """events => {
    for (const [kind, clientX, clientY] of events) {
        const to = document.elementFromPoint(clientX, clientY);
        to.dispatchEvent(new PointerEvent(kind, { clientX, clientY, bubbles: true }));
    }
}"""


class Strip:
    """The strip as it lies on the screen."""

    def __init__(self, person: Person) -> None:
        self._person, panel = person, person.panel(TimelinePanel)
        image = person.live("time")
        # At first it is drawn for another width than the page has.
        person.wait_until(lambda: panel._width_px == WIDTH_PX)
        person.wait_until(lambda: image.evaluate("it => it.naturalWidth") == WIDTH_PX)
        strip = panel._strip
        self._box = strip.box
        count = len(strip.times.times_s)
        self._middles_px = [strip.place_of(index)[0] for index in range(count)]

    @property
    def last(self) -> int:
        """The last frame."""
        return len(self._middles_px) - 1

    def column_of(self, frame_index: int, aside: float = 0.0) -> float:
        """The column of the picture in a frame's middle, or aside by a fraction of a frame."""
        step_px = self._middles_px[1] - self._middles_px[0]
        return self._middles_px[frame_index] + aside * step_px

    def nearest(self, x_px: float) -> int:
        """The frame whose middle is nearest to a column."""
        return int(np.argmin(np.abs(np.array(self._middles_px) - x_px)))

    def place(self, x_px: float, down: float = 0.5) -> tuple[float, float]:
        """Where a column lies on the screen, so far down."""
        return self._person.place_on("time", x_px, self._box.top + down * self._box.height)


def is_at(person: Person, frame_index: int) -> bool:
    return (
        person.session.view.frame_index == frame_index
        and person.frame_view.view.frame_index == frame_index
    )


@pytest.fixture
def strip(person: Person) -> Strip:
    return Strip(person)


def test_a_click_goes_to_the_frame_under_the_pointer(person: Person, strip: Strip) -> None:
    count = strip.last + 1
    for frame, aside, down in ((count // 2, 0.35, 0.2), (3, -0.35, 0.9), (strip.last, 0.0, 0.5)):
        column = strip.column_of(frame, aside)
        assert strip.nearest(column) == frame
        person.page.mouse.click(*strip.place(column, down))
        person.wait_until(lambda frame=frame: is_at(person, frame))


def test_a_click_beside_the_frames_goes_nowhere(person: Person, strip: Strip) -> None:
    person.page.mouse.click(*strip.place(strip.column_of(0) - 20.0))
    person.page.mouse.click(*strip.place(strip.column_of(4), down=-0.5))
    person.page.mouse.click(*strip.place(strip.column_of(2)))
    person.wait_until(lambda: person.session.view.frame_index != 0)
    assert person.session.view.frame_index == 2


def test_a_drag_goes_through_the_frames(person: Person, strip: Strip) -> None:
    mouse, last = person.page.mouse, strip.last
    mouse.move(*strip.place(strip.column_of(2)))
    mouse.down()
    assert person.session.view.frame_index == 0
    for frame, aside in ((5, 0.3), (9, -0.3), (4, 0.0)):
        mouse.move(*strip.place(strip.column_of(frame, aside)), steps=3)
        person.wait_until(lambda frame=frame: is_at(person, frame))
    # Both ends are reached by leaving the strip.
    for column, down, frame in ((strip.column_of(last) + 30.0, 3.0, last), (-30.0, -1.0, 0)):
        mouse.move(*strip.place(column, down), steps=3)
        person.wait_until(lambda frame=frame: is_at(person, frame))
    mouse.move(*strip.place(strip.column_of(7)))
    mouse.up()
    person.wait_until(lambda: is_at(person, 7))
    # The next click is not taken for more of the drag. Until it is heard, an end of the drag may
    # still be under way.
    mouse.click(*strip.place(strip.column_of(3)))
    person.wait_until(lambda: is_at(person, 3))


def test_a_drag_ends_at_the_frame_where_the_button_was_let_go(person: Person, strip: Strip) -> None:
    events = [
        ("pointerdown", *strip.place(strip.column_of(1))),
        ("pointermove", *strip.place(strip.column_of(6))),
        ("pointermove", *strip.place(strip.column_of(12))),
        ("pointerup", *strip.place(strip.column_of(12))),
        ("pointermove", 450.0, 100.0),
    ]
    person.page.evaluate(AT_ONCE, events)
    person.wait_until(lambda: person.session.view.frame_index not in (0, 6))
    assert person.session.view.frame_index == 12
    # Nothing is held any more.
    person.page.mouse.move(*strip.place(strip.column_of(3)))
    person.wait_until(lambda: person.session._hover.frame_index == 3)
    assert person.session.view.frame_index == 12
