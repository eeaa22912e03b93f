"""Widgets bound to a setting or to a value of the view, with the range and the help that it has.

A widget changes the view and nothing else; ``show`` sets it to what the view says.
"""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import viser

from fusion_core.settings import StageSettings
from scanloom.client_session import ClientSession
from scanloom.state.view import View


@dataclass(slots=True)
class _Bound:
    """A widget, what a view says of it, and the value that widget and view last agreed on."""

    handle: Any
    value_of: Callable[[View], Any]
    known: Any


class Controls:
    """The bound widgets of one panel."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._gui = gui
        self._session = session
        self._bound: list[_Bound] = []
        self._lock = threading.RLock()

    def slider(
        self, stage: str, name: str, label: str, low: float, high: float, step: float
    ) -> viser.GuiSliderHandle[Any]:
        """A number of a stage's settings. The ends are the widget's; the setting's are checked."""
        value = _setting(self._session.view, stage, name)
        whole = isinstance(value, int) and isinstance(step, int)
        handle = self._gui.add_slider(
            label,
            min=low,
            max=high,
            step=step,
            initial_value=min(max(value, low), high),
            hint=self._help(stage, name),
        )
        self.bind(
            handle,
            lambda view: _clamped(_setting(view, stage, name), low, high),
            lambda new: self._session.set(stage, name, int(new) if whole else float(new)),
        )
        return handle

    def checkbox(self, stage: str, name: str, label: str) -> viser.GuiCheckboxHandle:
        """A switch of a stage's settings."""
        handle = self._gui.add_checkbox(
            label, _setting(self._session.view, stage, name), hint=self._help(stage, name)
        )
        self.bind(
            handle,
            lambda view: _setting(view, stage, name),
            lambda new: self._session.set(stage, name, bool(new)),
        )
        return handle

    def dropdown(
        self, stage: str, name: str, label: str, options: Sequence[str]
    ) -> viser.GuiDropdownHandle[Any]:
        """A choice of a stage's settings."""
        handle = self._gui.add_dropdown(
            label,
            tuple(options),
            initial_value=_setting(self._session.view, stage, name),
            hint=self._help(stage, name),
        )
        self.bind(
            handle,
            lambda view: _setting(view, stage, name),
            lambda new: self._session.set(stage, name, str(new)),
        )
        return handle

    def bind_field(
        self,
        handle: Any,
        name: str,
        convert: Callable[[Any], Any] = lambda value: value,
        frame_view: Callable[[Any], Any] = lambda value: value,
    ) -> None:
        """Tie a widget to a value of the view itself. ``shown``: how the widget has that value."""
        self.bind(
            handle,
            lambda view: frame_view(getattr(view, name)),
            lambda new: self._session.change(**{name: convert(new)}),
        )

    def bind(
        self, handle: Any, value_of: Callable[[View], Any], change: Callable[[Any], None]
    ) -> None:
        """Tie a widget to what a view says of it, None for nothing, by what a new value changes."""
        bound = _Bound(handle, value_of, handle.value)
        self._bound.append(bound)

        @handle.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            # Without a client it was ``show`` that set the value.
            if event.client is None:
                return
            # Callbacks run in any order: each takes the widget's latest value, one at a time.
            with self._lock:
                bound.known = handle.value
                change(bound.known)

    def show(self, view: View) -> None:
        """Set every widget to what the view says, where that is not what the widget said itself.

        A person may be moving it: a value that is no longer asked for would pull it back.
        """
        with self._lock:
            asked = self._session.view
            for bound in self._bound:
                value = bound.value_of(view)
                if value is None or value == bound.known or value != bound.value_of(asked):
                    continue
                bound.known = value
                update_widget(bound.handle, value=value)

    def _help(self, stage: str, name: str) -> str | None:
        fields = type(_stage(self._session.view, stage)).model_fields
        return fields[name].description


def update_widget(handle: Any, **values: Any) -> None:
    """Set properties of a widget that differ: what is set goes over the wire."""
    for name, value in values.items():
        if getattr(handle, name) != value:
            setattr(handle, name, value)


def _stage(view: View, stage: str) -> StageSettings:
    settings: StageSettings = view.settings if stage == "" else getattr(view.settings, stage)
    return settings


def _setting(view: View, stage: str, name: str) -> Any:
    return getattr(_stage(view, stage), name)


def _clamped(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
