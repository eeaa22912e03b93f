"""Widgets bound to a setting or to a field of the view.

A user's input changes the view and nothing else; ``show`` sets the widgets from the view.
"""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import viser

from fusion_core.settings import StageSettings
from scanloom.client_session import ClientSession
from scanloom.page.update_widget import update_widget
from scanloom.state.view import View

# No scan and no image has more beams or rows.
_MAX_DIGITS = 7


@dataclass(slots=True)
class _Bound:
    """A widget, its value in a view, and the last value that widget and view agreed on."""

    handle: Any
    value_of: Callable[[View], Any]
    agreed: Any


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
        """A slider for a numeric setting of a stage, with the setting's help as hint.

        ``low``, ``high``: ends of the slider; the setting itself may allow more.
        """
        value = _setting(self._session.view, stage, name)
        as_number = int if isinstance(value, int) and isinstance(step, int) else float
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
            lambda new: self._session.change_setting(stage, name, as_number(new)),
        )
        return handle

    def checkbox(self, stage: str, name: str, label: str) -> viser.GuiCheckboxHandle:
        """A checkbox for a setting of a stage."""
        handle = self._gui.add_checkbox(
            label, _setting(self._session.view, stage, name), hint=self._help(stage, name)
        )
        self.bind(
            handle,
            lambda view: _setting(view, stage, name),
            lambda new: self._session.change_setting(stage, name, bool(new)),
        )
        return handle

    def dropdown(
        self, stage: str, name: str, label: str, options: Sequence[str]
    ) -> viser.GuiDropdownHandle[Any]:
        """A dropdown for a setting of a stage with named options."""
        handle = self._gui.add_dropdown(
            label,
            tuple(options),
            initial_value=_setting(self._session.view, stage, name),
            hint=self._help(stage, name),
        )
        self.bind(
            handle,
            lambda view: _setting(view, stage, name),
            lambda new: self._session.change_setting(stage, name, str(new)),
        )
        return handle

    def optional_number(self, label: str, name: str, *, hint: str) -> viser.GuiInputHandle[str]:
        """A field of text for a whole number of the view, from 0, or none where it is empty."""
        handle = self._gui.add_text(label, _digits(getattr(self._session.view, name)), hint=hint)

        def change(text: str) -> None:
            # Anything else stays in the field and changes nothing.
            if not text.strip():
                self._session.change(**{name: None})
            elif len(text.strip()) <= _MAX_DIGITS and text.strip().isdecimal():
                self._session.change(**{name: int(text)})

        self.bind(handle, lambda view: _digits(getattr(view, name)), change)
        return handle

    def bind_field(
        self,
        handle: Any,
        name: str,
        to_view: Callable[[Any], Any] = lambda value: value,
        to_widget: Callable[[Any], Any] = lambda value: value,
    ) -> None:
        """Bind a widget to the view's field ``name``, with conversions between their values."""
        self.bind(
            handle,
            lambda view: to_widget(getattr(view, name)),
            lambda new: self._session.change(**{name: to_view(new)}),
        )

    def bind(
        self, handle: Any, value_of: Callable[[View], Any], change: Callable[[Any], None]
    ) -> None:
        """Bind a widget: ``value_of`` a view (None: leave the widget), ``change`` on user input."""
        bound = _Bound(handle, value_of, handle.value)
        self._bound.append(bound)

        @handle.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            # No client: the value was set by ``show``.
            if event.client is None:
                return
            # Callbacks run in parallel and in any order: each takes the widget's latest value.
            with self._lock:
                bound.agreed = handle.value
                change(bound.agreed)

    def show(self, view: View) -> None:
        """Set each widget to its value in the view, unless the value came from the widget.

        A user may be dragging it: an outdated value would pull it back.
        """
        with self._lock:
            requested = self._session.view
            for bound in self._bound:
                value = bound.value_of(view)
                if value is None or value == bound.agreed or value != bound.value_of(requested):
                    continue
                bound.agreed = value
                update_widget(bound.handle, value=value)

    def _help(self, stage: str, name: str) -> str | None:
        fields = type(_stage(self._session.view, stage)).model_fields
        return fields[name].description


def _digits(number: int | None) -> str:
    return "" if number is None else str(number)


def _stage(view: View, stage: str) -> StageSettings:
    settings: StageSettings = view.settings if stage == "" else getattr(view.settings, stage)
    return settings


def _setting(view: View, stage: str, name: str) -> Any:
    return getattr(_stage(view, stage), name)


def _clamped(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)
