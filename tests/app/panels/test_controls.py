"""Bound widgets: what a person moves stays where it is, and what the view says is shown."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from scanloom.panels.controls import Controls
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


class Desk:
    """Takes every change, unless it is told to refuse."""

    def __init__(self) -> None:
        self.view = View(recording="one")
        self.refuses = False

    def change(self, **values: Any) -> None:
        if not self.refuses:
            self.view = self.view.changed(**values)


@pytest.fixture
def desk() -> Desk:
    return Desk()


@pytest.fixture
def slider(desk: Desk) -> Slider:
    return Slider(desk.view.number)


@pytest.fixture
def controls(desk: Desk, slider: Slider) -> Controls:
    controls = Controls(gui=None, desk=desk)  # type: ignore[arg-type]  # no widget is made
    controls.bind(slider, "number", int)
    return controls


def test_a_view_from_elsewhere_moves_the_widget(
    desk: Desk, slider: Slider, controls: Controls
) -> None:
    desk.view = desk.view.changed(number=7)
    controls.show(desk.view)
    assert slider.value == 7
    assert desk.view.number == 7


def test_a_view_that_is_no_longer_asked_for_does_not_pull_the_widget_back(
    desk: Desk, slider: Slider, controls: Controls
) -> None:
    slider.arrive(3)
    slider.hear()
    late = desk.view
    slider.arrive(4)
    slider.hear()
    controls.show(late)
    assert slider.value == 4


def test_a_value_whose_callback_is_still_to_come_is_not_lost(
    desk: Desk, slider: Slider, controls: Controls
) -> None:
    slider.arrive(3)
    slider.hear()
    slider.arrive(4)
    controls.show(desk.view)
    slider.hear()
    assert desk.view.number == 4


def test_a_refused_value_is_set_back(desk: Desk, slider: Slider, controls: Controls) -> None:
    desk.refuses = True
    slider.arrive(3)
    slider.hear()
    controls.show(desk.view)
    assert slider.value == desk.view.number == 0
