"""The threshold epsilon: its unit, a slider for that unit, and its value in metres."""

from typing import Any

import viser

from fusion_core.workflows.fuse.epsilon import (
    EPSILON_UNITS,
    EpsilonUnit,
    convert_epsilon,
    measure_epsilon,
    unit_lengths_m,
)
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.update_widget import update_widget
from scanloom.panels.registration_text import epsilon_text
from scanloom.panels.widgets.controls import Controls
from scanloom.state.view import View

# Range and step of each unit's slider, set by hand; a setting may lie outside.
_RANGES: dict[EpsilonUnit, tuple[float, float, float]] = {
    "sigma": (0.5, 10.0, 0.1),
    "E": (0.1, 5.0, 0.01),
    "m": (0.005, 1.0, 0.001),
}
_LABELS: dict[EpsilonUnit, str] = {"sigma": "ε (σ)", "E": "ε (E)", "m": "ε (m)"}
_BAND_MARKS = ((1.0, "E"), (2.0**0.5, "√2 E"))


class EpsilonSliders:
    """A slider for each unit; one is visible."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession, controls: Controls) -> None:
        self._session = session
        self._sliders = {unit: self._add(gui, controls, unit) for unit in EPSILON_UNITS}

    def show(self, view: View) -> None:
        """Show the slider of the view's unit."""
        for unit, slider in self._sliders.items():
            update_widget(slider, visible=unit == view.settings.noise.epsilon_unit)

    def _add(
        self, gui: viser.GuiApi, controls: Controls, unit: EpsilonUnit
    ) -> viser.GuiSliderHandle[Any]:
        low, high, step = _RANGES[unit]
        noise = self._session.view.settings.noise
        slider: viser.GuiSliderHandle[Any] = gui.add_slider(
            _LABELS[unit],
            min=low,
            max=high,
            step=step,
            initial_value=min(max(noise.epsilon, low), high),
            marks=_BAND_MARKS if unit == "E" else None,
            visible=unit == noise.epsilon_unit,
            hint=type(noise).model_fields["epsilon"].description,
        )

        def value_of(view: View) -> float | None:
            noise = view.settings.noise
            return min(max(noise.epsilon, low), high) if noise.epsilon_unit == unit else None

        def change(value: float) -> None:
            # A late value of the previous unit is dropped.
            if unit == self._session.view.settings.noise.epsilon_unit:
                self._session.change_setting("noise", "epsilon", float(value))

        controls.bind(slider, value_of, change)
        return slider


class EpsilonControls:
    """The unit, its slider, and epsilon in metres as text."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        self._lengths_m: dict[EpsilonUnit, float] = {}
        self._controls = Controls(gui, session)
        noise = session.view.settings.noise
        unit = gui.add_dropdown(
            "Unit of ε",
            EPSILON_UNITS,
            initial_value=noise.epsilon_unit,
            hint=type(noise).model_fields["epsilon_unit"].description,
        )
        self._controls.bind(unit, lambda view: view.settings.noise.epsilon_unit, self._change_unit)
        self._sliders = EpsilonSliders(gui, session, self._controls)
        self._text = gui.add_markdown("")

    def show(self, frame_view: FrameView) -> None:
        """Set unit and slider, and display epsilon in this frame."""
        noise = frame_view.view.settings.noise
        self._controls.show(frame_view.view)
        self._sliders.show(frame_view.view)
        if frame_view.match is not None and frame_view.chain is not None:
            self._lengths_m = unit_lengths_m(frame_view.match, frame_view.chain.alignment)
        text = ""
        if frame_view.fused is not None:
            text = epsilon_text(
                measure_epsilon(frame_view.fused), noise.epsilon, noise.epsilon_unit
            )
        update_widget(self._text, content=text)

    def _change_unit(self, unit: EpsilonUnit) -> None:
        """Convert epsilon to another unit, as one change."""
        view = self._session.view
        noise = view.settings.noise
        low, high, step = _RANGES[unit]
        epsilon = convert_epsilon(noise.epsilon, noise.epsilon_unit, unit, self._lengths_m)
        # Rounded to a step of the slider.
        on_slider = min(max(round(epsilon / step) * step, low), high)
        changed = view.with_setting("noise", "epsilon_unit", unit).with_setting(
            "noise", "epsilon", round(on_slider, 3)
        )
        self._session.change(settings=changed.settings)
