"""The residuals of eq. (6) along the curve, with the threshold epsilon as two lines."""

from typing import Any

import numpy as np
import viser

from fusion_core.model.classes import NoiseClass
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.registration_details import ResidualCurve, residual_curve
from scanloom.page.update_widget import update_widget
from scanloom.plots.line_plot import (
    NEUTRAL,
    PlotLabels,
    add_line_plot,
    dots,
    line,
    no_data,
    set_theme,
)
from scanloom.plots.palette import class_color
from scanloom.plots.theme import Theme

# Set by hand: limit of y in multiples of epsilon; larger residuals are drawn at the edge.
_Y_LIMIT_IN_EPSILON = 2.5
_PLOTTED_CLASSES = (NoiseClass.GOOD, NoiseClass.CONFLICT, NoiseClass.BURR)
_NOTHING = (*no_data(len(_PLOTTED_CLASSES) + 1), np.zeros(2), np.zeros(2))
# The range of y follows the two lines of epsilon: explicit limits for each frame would recreate
# the plot at each change.
_Y_PADDING = {"pad": 0.5 * (_Y_LIMIT_IN_EPSILON - 1.0), "soft": 0.0, "mode": 0}


class ResidualPlot:
    """A dot for each pair in the colour of its class, from left to right."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._plot = add_line_plot(
            gui,
            PlotLabels(
                title="Residual of each pair",
                x="azimuth in the LiDAR frame (°)",
                x_short="azimuth (°)",
                y="residual (mm)",
                x_falls=True,
            ),
            (
                *(dots(noise.name.lower(), class_color(noise)) for noise in _PLOTTED_CLASSES),
                dots("beyond the plot", NEUTRAL, 6.0, hollow=True),
                line("+ε", NEUTRAL, dashed=True),
                line("−ε", NEUTRAL, dashed=True),
            ),
            y_limits={"min": _Y_PADDING, "max": _Y_PADDING},
        )
        self._text = gui.add_markdown("")
        self._plotted: FusedFrame | None = None

    def use_theme(self, theme: Theme) -> None:
        """Draw in the colours of the page's theme."""
        set_theme(self._plot, theme)

    def show(self, fused: FusedFrame | None, *, signed: bool) -> None:
        """Draw a frame's pairs; nothing if fewer than two have both values.

        ``signed``: residuals are differences along the beam, else lengths.
        """
        if fused is self._plotted:
            return
        self._plotted = fused
        curve = None if fused is None else residual_curve(fused)
        # Epsilon in multiples of E is NaN without an E.
        if curve is None or curve.residual_mm.size < 2 or not np.isfinite(curve.epsilon_mm).all():
            self._plot.data = _NOTHING
            update_widget(self._plot, visible=False)
            update_widget(self._text, content="")
            return
        update_widget(self._plot, visible=True)
        limit_mm = _Y_LIMIT_IN_EPSILON * float(curve.epsilon_mm.max())
        self._plot.data = _data(curve, limit_mm)
        update_widget(self._text, content=_caption(curve, limit_mm, signed=signed))


def _data(curve: ResidualCurve, limit_mm: float) -> tuple[np.ndarray[Any, Any], ...]:
    """x, a series for each class, what lies beyond at the edge, and the two lines; gaps are NaN."""
    residual_mm = curve.residual_mm
    beyond = np.abs(residual_mm) > limit_mm
    by_class = (
        np.where((curve.pair_class == noise) & ~beyond, residual_mm, np.nan)
        for noise in _PLOTTED_CLASSES
    )
    return (
        curve.azimuth_deg,
        *by_class,
        np.where(beyond, np.sign(residual_mm) * limit_mm, np.nan),
        curve.epsilon_mm,
        -curve.epsilon_mm,
    )


def _caption(curve: ResidualCurve, limit_mm: float, *, signed: bool) -> str:
    count = int((np.abs(curve.residual_mm) > limit_mm).sum())
    text = "Positive: the camera sees farther than the LiDAR. Dashed: ±ε."
    if not signed:
        text = "Length of L A − D, which is never negative. Dashed: ε."
    if count:
        farthest_m = 1e-3 * float(np.abs(curve.residual_mm).max())
        text += f" {count} beyond the plot at its edge, up to {farthest_m:.2f} m."
    return text
