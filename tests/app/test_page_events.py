"""What a page may send through its field, and in which order it is heard."""

import json
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.page.bridge import PageBridge, press_attributes
from scanloom.page.events import Screen, parse_events

PRESS = {"kind": "press", "name": "step", "value": "Map"}
POINT = {"picture": "depth", "kind": "move", "x_px": 3.5, "y_px": -0.5}


class Field:
    """The page's field as the bridge uses it."""

    def __init__(self) -> None:
        self.value = ""
        self.receive: Any = None

    def on_update(self, call: Any) -> None:
        self.receive = call

    def send(self, **values: Any) -> None:
        self.value = json.dumps(values)
        self.receive(SimpleNamespace(client=object()))


@pytest.fixture
def field() -> Field:
    return Field()


@pytest.fixture
def bridge(field: Field) -> PageBridge:
    gui = SimpleNamespace(add_html=lambda _: None, add_text=lambda *_: field)
    return PageBridge(gui)  # type: ignore[arg-type]  # as much of it as is needed


@given(st.text() | st.binary().map(lambda data: data.decode("latin-1")))
def test_any_text_is_events_or_nothing(text: str) -> None:
    parse_events(text)


@pytest.mark.parametrize(
    "events",
    [
        {"actions": [PRESS | {"number": -1}]},
        {"actions": [PRESS | {"number": 1, "more": 1}]},
        {"actions": [PRESS | {"number": 1, "name": "x" * 41}]},
        {"actions": [PRESS | {"number": n} for n in range(9)]},
        {"actions": [{"kind": "open", "number": 1}]},
        {"pointer": POINT | {"number": 1, "picture": "other"}},
        {"pointer": POINT | {"number": 1, "x_px": 1e9}},
        {"pointer": POINT | {"number": 1, "x_px": float("nan")}},
        {"actions": [], "more": 1},
    ],
)
def test_what_is_no_event_is_refused(events: dict[str, Any]) -> None:
    assert parse_events(json.dumps(events)) is None


def test_each_action_is_heard_once_and_in_order(bridge: PageBridge, field: Field) -> None:
    heard: list[str] = []
    bridge.on_press("step", heard.append)
    first, second, third = (PRESS | {"number": n, "value": str(n)} for n in (1, 2, 3))
    field.send(actions=[first])
    field.send(actions=[first, second, third])
    # Threads come in any order: an older value may be read last.
    field.send(actions=[first, second])
    field.send(actions=[PRESS | {"number": 4, "name": "unknown"}])
    assert heard == ["1", "2", "3"]


def test_a_pointer_that_was_overtaken_is_not_heard(bridge: PageBridge, field: Field) -> None:
    heard: list[tuple[str, float, float]] = []
    bridge.on_point("depth", lambda kind, x, y: heard.append((kind, x, y)))
    field.send(actions=[], pointer=POINT | {"number": 2})
    field.send(actions=[], pointer=POINT | {"number": 1, "x_px": 99.0})
    field.send(actions=[], pointer=POINT | {"number": 3, "kind": "leave"})
    assert heard == [("move", 3.5, -0.5), ("leave", 3.5, -0.5)]


def test_the_end_of_a_drag_is_heard_before_what_came_after(
    bridge: PageBridge, field: Field
) -> None:
    heard: list[tuple[str, float]] = []
    bridge.on_point("time", lambda kind, x, _: heard.append((kind, x)))
    ended = {"kind": "drag", "picture": "time", "x_px": 7.0, "y_px": 1.0, "number": 2}
    field.send(actions=[ended], pointer=POINT | {"picture": "time", "kind": "leave", "number": 3})
    assert heard == [("drag", 7.0), ("leave", 3.5)]


def test_a_size_told_before_anyone_hears_is_not_lost(bridge: PageBridge, field: Field) -> None:
    screen = {"kind": "screen", "width_px": 390, "height_px": 844, "prefers_dark": True}
    field.send(actions=[screen | {"number": 1}])
    heard: list[Screen] = []
    bridge.on_screen(heard.append)
    assert [(one.width_px, one.prefers_dark) for one in heard] == [(390, True)]


def test_a_buttons_values_are_text_in_its_attributes() -> None:
    hostile = '"><img src=x onerror="alert(1)">'
    attributes = press_attributes("step", hostile)
    assert "<" not in attributes
    assert attributes.count('"') == 6
