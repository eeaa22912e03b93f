"""The threshold epsilon: its unit, a slider whose range fits it, and what it is in metres."""

from typing import Any

import viser

from app.desk import Desk
from app.panels.controls import put
from app.panels.register_words import epsilon_words
from app.shown import Shown
from fusion_core.workflows.epsilon import (
    EPSILON_UNITS,
    EpsilonUnit,
    converted,
    epsilon_in,
    unit_lengths_m,
)

# Ends and step of each unit's slider; a setting may lie beyond.
_RANGES: dict[EpsilonUnit, tuple[float, float, float]] = {
    "sigma": (0.5, 10.0, 0.1),
    "E": (0.1, 5.0, 0.01),
    "m": (0.005, 1.0, 0.001),
}
_LABELS: dict[EpsilonUnit, str] = {"sigma": "ε (σ)", "E": "ε (E)", "m": "ε (m)"}
_BAND_MARKS = ((1.0, "E"), (2.0**0.5, "√2 E"))


class EpsilonControls:
    """A unit, a slider for each of which one is seen, and words."""

    def __init__(self, gui: viser.GuiApi, desk: Desk) -> None:
        self._desk = desk
        self._lengths_m: dict[EpsilonUnit, float] = {}
        noise = desk.view.settings.noise
        fields = type(noise).model_fields
        self._unit = gui.add_dropdown(
            "Unit of ε",
            EPSILON_UNITS,
            initial_value=noise.epsilon_unit,
            hint=fields["epsilon_unit"].description,
        )
        self._sliders = {
            unit: self._slider(gui, unit, fields["epsilon"].description) for unit in EPSILON_UNITS
        }
        self._words = gui.add_markdown("")

        @self._unit.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._change_unit(self._unit.value)

    def show(self, shown: Shown) -> None:
        """Set unit and slider; say what epsilon is in this frame."""
        noise = shown.view.settings.noise
        put(self._unit, value=noise.epsilon_unit)
        for unit, slider in self._sliders.items():
            seen = unit == noise.epsilon_unit
            put(slider, visible=seen)
            if seen:
                low, high, _ = _RANGES[unit]
                put(slider, value=min(max(noise.epsilon, low), high))
        if shown.match is None or shown.chain is None:
            return
        self._lengths_m = unit_lengths_m(shown.match, shown.chain.alignment)
        if shown.fused is not None:
            said = epsilon_in(shown.fused)
            put(self._words, content=epsilon_words(said, noise.epsilon, noise.epsilon_unit))

    def _slider(
        self, gui: viser.GuiApi, unit: EpsilonUnit, hint: str | None
    ) -> viser.GuiSliderHandle[Any]:
        low, high, step = _RANGES[unit]
        noise = self._desk.view.settings.noise
        slider: viser.GuiSliderHandle[Any] = gui.add_slider(
            _LABELS[unit],
            min=low,
            max=high,
            step=step,
            initial_value=min(max(noise.epsilon, low), high),
            marks=_BAND_MARKS if unit == "E" else None,
            visible=unit == noise.epsilon_unit,
            hint=hint,
        )

        @slider.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            # A value that was on its way when the unit changed means the unit before.
            if event.client is not None and unit == self._desk.view.settings.noise.epsilon_unit:
                self._desk.set("noise", "epsilon", float(slider.value))

        return slider

    def _change_unit(self, unit: EpsilonUnit) -> None:
        """The same length in another unit, as one change."""
        view = self._desk.view
        noise = view.settings.noise
        low, high, step = _RANGES[unit]
        epsilon = converted(noise.epsilon, noise.epsilon_unit, unit, self._lengths_m)
        # On the slider, as if it had been set there.
        on_slider = min(max(round(epsilon / step) * step, low), high)
        changed = view.with_setting("noise", "epsilon_unit", unit).with_setting(
            "noise", "epsilon", round(on_slider, 3)
        )
        self._desk.change_settings(settings=changed.settings)
