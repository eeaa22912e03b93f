"""The Register panel: the map A, its draws one by one, the residuals and the threshold epsilon."""

from typing import Any

import viser
import viser.uplot

from app.desk import Desk
from app.panels.controls import Controls, put
from app.panels.epsilon import EpsilonControls
from app.panels.residual_plot import ResidualPlot
from app.shown import Shown
from fusion_core.workflows.registered import (
    Registration,
)

_WIDTH_PX, _PAIRS_PX, _DRAW_PX = 480, 590, 330
_MODELS = ("auto", "rigid", "similarity", "affine", "homography")
_STOPPINGS = ("fixed", "adaptive")
# In the paper's own pairs x is no length that was measured.
_AXES_BY_SAMPLE = ("x: sample times its width (m)", "z: value (m)")
_AXES = ("x to the right (m)", "z ahead (m)")


class RegisterPanel:
    """Settings of RANSAC, its draws, A before and after, residuals and epsilon."""

    def __init__(self, gui: viser.GuiApi, desk: Desk) -> None:
        self._desk = desk
        self._registration: Registration | None = None
        self._drawn_pairs: object = None
        self._drawn_draw: object = None
        controls = Controls(gui, desk)
        self._controls = controls
        controls.dropdown("registration", "model", "Map A", _MODELS)
        self._epsilon = EpsilonControls(gui, desk)
        self._residuals = ResidualPlot(gui)
        self._pairs = gui.add_image(_blank(_PAIRS_PX), format="png")
        self._words = gui.add_markdown("")
        with gui.add_folder("Draws, one by one"):
            self._draw = gui.add_slider("Draw", min=0, max=1, step=1, initial_value=0)
            self._buttons = gui.add_button_group("Go to", ("Previous", "Next", "Best"))
            self._draw_words = gui.add_markdown("")
            self._draw_picture = gui.add_image(_blank(_DRAW_PX), format="png")
            self._consensus = gui.add_markdown("")
        with gui.add_folder("How it draws", expand_by_default=False):
            controls.slider("registration", "sample_size", "Pairs in a draw, n", 2, 20, 1)
            controls.slider(
                "registration", "inlier_threshold_m", "Inlier within (m)", 0.01, 0.5, 0.01
            )
            controls.dropdown("registration", "stopping", "Stop", _STOPPINGS)
            controls.slider("registration", "draws", "Draws", 1, 500, 1)
            self._confidence = controls.slider(
                "registration", "confidence", "Confidence", 0.5, 0.999, 0.001
            )
            controls.slider("registration", "seed", "Seed", 0, 99, 1)
            controls.checkbox("registration", "guards", "Refuse maps that stretch or mirror")
        with gui.add_folder("The matrix", expand_by_default=False):
            self._matrix = gui.add_markdown("")

        @self._draw.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                desk.change(draw=int(self._draw.value))

        @self._buttons.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            self._go(self._buttons.value)

    def show(self, shown: Shown) -> None:
        """Set the widgets; draw what differs from what is drawn, while the panel is open."""
        self._controls.show(shown.view)
        put(self._confidence, disabled=shown.view.settings.registration.stopping == "fixed")
        self._epsilon.show(shown)
        match = shown.match
        if match is None:
            self._show_nothing(shown)
            return
        found = match.registration
        self._registration = found
        if found is not None:
            last = len(found.draws) - 1
            put(self._draw, max=max(last, 1))
            put(self._draw, value=min(shown.view.draw, last))
        for widget in (self._draw, self._buttons, self._draw_picture, self._consensus):
            put(widget, visible=found is not None)
        if shown.view.panel != "Register":
            return
        self._residuals.show(shown.fused)
        # The same pairs and the same A make the same picture, whatever epsilon is.
        if self._drawn_pairs is not match.pairs:
            self._drawn_pairs = match.pairs
            self._show_pairs(match, by_sample=shown.view.settings.pairing == "frame")
        if found is None:
            self._drawn_draw = None
            put(self._draw_words, content="Without an A there is no draw to show.")
            return
        index = min(shown.view.draw, len(found.draws) - 1)
        if self._drawn_draw != (id(found), index):
            self._drawn_draw = (id(found), index)
            self._show_draw(match, found, index, shown)
