"""Bound widgets: what a person moves stays where it is, and what the view says is shown."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from scanloom.panels.widgets.controls import Controls
from scanloom.state.view import View


class Slider:
    """A widget that hears of its own changes, as viser's do."""

    def __init__(self, value: int) -> None:
        self._value = value
        self._callbacks: list[Callable[[Any], None]] = []

    @property
    def value(self) -> int:
        return self._value

    @value.setter
    def value(self, value: int) -> None:
        self._value = value
        self._tell(None)

    def on_update(self, callback: Callable[[Any], None]) -> None:
        self._callbacks.append(callback)

    def arrive(self, value: int) -> None:
        """A browser's value is there; its callback runs with ``hear``."""
        self._value = value

    def hear(self) -> None:
        self._tell("a browser")

    def _tell(self, client: object) -> None:
        for callback in self._callbacks:
            callback(SimpleNamespace(client=client))


class ClientSession:
    """Takes every change, unless it is told to refuse."""

    def __init__(self) -> None:
        self.view = View(recording="one")
        self.refuses = False

    def change(self, **values: Any) -> None:
        if not self.refuses:
            self.view = self.view.changed(**values)


@pytest.fixture
def session() -> ClientSession:
    return ClientSession()


@pytest.fixture
def slider(session: ClientSession) -> Slider:
    return Slider(session.view.frame_index)


@pytest.fixture
def controls(session: ClientSession, slider: Slider) -> Controls:
    controls = Controls(gui=None, session=session)  # type: ignore[arg-type]  # no widget is made
    controls.bind_field(slider, "frame_index", int)
    return controls


def test_a_view_from_elsewhere_moves_the_widget(
    session: ClientSession, slider: Slider, controls: Controls
) -> None:
    session.view = session.view.changed(frame_index=7)
    controls.show(session.view)
    assert slider.value == 7
    assert session.view.frame_index == 7


def test_a_view_that_is_no_longer_asked_for_does_not_pull_the_widget_back(
    session: ClientSession, slider: Slider, controls: Controls
) -> None:
    slider.arrive(3)
    slider.hear()
    late = session.view
    slider.arrive(4)
    slider.hear()
    controls.show(late)
    assert slider.value == 4


def test_a_value_whose_callback_is_still_to_come_is_not_lost(
    session: ClientSession, slider: Slider, controls: Controls
) -> None:
    slider.arrive(3)
    slider.hear()
    slider.arrive(4)
    controls.show(session.view)
    slider.hear()
    assert session.view.frame_index == 4


def test_a_refused_value_is_set_back(
    session: ClientSession, slider: Slider, controls: Controls
) -> None:
    session.refuses = True
    slider.arrive(3)
    slider.hear()
    controls.show(session.view)
    assert slider.value == session.view.frame_index == 0
