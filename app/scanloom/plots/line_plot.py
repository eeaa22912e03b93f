"""Curves by viser's uPlot, all in one look: axes with their units, the values under the cursor.

A missing value is NaN. uPlot would draw a line across it, so a series with gaps is one of dots.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, cast

import numpy as np
import viser
from viser import uplot

from fusion_core.model.conventions import FloatArray
from scanloom.plots.palette import Color
from scanloom.plots.theme import DARK, LIGHT, Theme

INK: Color = LIGHT.ink
"""Of marks of the present place."""
NEUTRAL: Color = LIGHT.neutral
"""Of what belongs to no sensor and no class."""

_HEIGHT_PX = 260
# Room for the ticks and the label of an axis.
_X_AXIS_PX, _Y_AXIS_PX, _LABEL_PX = 34, 48, 20
_PADDING_PX = (12, 20, 0, 0)
_DASH_PX = (5, 4)

# In a gap the legend shows the nearest value within this distance.
_CURSOR = uplot.Cursor(hover=uplot.Cursor_Hover(prox=24.0, skip=(np.nan,)))
# With x reversed, uPlot finds values at any distance; gaps show no value and no dot.
_CURSOR_ON_FALLING_X = uplot.Cursor(points=uplot.Cursor_Points(show=False))

Limits = tuple[float, float] | dict[str, Any]
"""Of y: least and greatest value, or uPlot's rule for finding them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlotLabels:
    """The labels of a plot, with units.

    ``x_short`` names the value of x under the cursor. ``x_falls``: azimuth, which is positive to
    the left, falls to the right.
    """

    title: str
    x: str
    x_short: str
    y: str
    x_falls: bool = False


def add_line_plot(
    gui: viser.GuiApi,
    labels: PlotLabels,
    series: Sequence[uplot.Series],
    *,
    y_limits: Limits = (0.0, 1.0),
    theme: Theme = LIGHT,
) -> viser.GuiUplotHandle:
    """An empty plot, hidden; its ``data`` are x, rising, and the values of each series.

    The colours of ``series`` are those of the light theme; ``set_theme`` changes them later.
    """
    plot = _add_plot(gui, labels, series, y_limits)
    set_theme(plot, theme)
    return plot


def set_theme(plot: viser.GuiUplotHandle, theme: Theme) -> None:
    """Draw a plot of ``add_line_plot`` in the colours of the page's theme.

    Another theme recreates the plot in the browser, the same one sends nothing.
    """
    axes = plot.axes
    assert axes is not None, "add_line_plot sets axes"
    labels = [str(axis["label"]) for axis in axes]
    themed = _axes(labels[0], labels[1], theme)
    if themed == axes:
        return
    plot.axes = themed
    plot.series = tuple(_in_theme(series, theme) for series in plot.series)


def _add_plot(
    gui: viser.GuiApi, labels: PlotLabels, series: Sequence[uplot.Series], y_limits: Limits
) -> viser.GuiUplotHandle:
    return gui.add_uplot(
        no_data(len(series)),
        (uplot.Series(label=labels.x_short), *series),
        title=labels.title,
        scales=_scales(y_limits, x_falls=labels.x_falls),
        axes=_axes(labels.x, labels.y, LIGHT),
        cursor=_CURSOR_ON_FALLING_X if labels.x_falls else _CURSOR,
        height=_HEIGHT_PX,
        padding=_PADDING_PX,
        visible=False,
    )


def set_limits(plot: viser.GuiUplotHandle, low: float, high: float) -> None:
    """The limits of y, and of x around the plot's data, rounded outwards; after new data.

    New limits recreate the plot in the browser, so they should seldom change. Without limits of x
    viser 1.1.1 would show the part of the new data in which all data before would lie.
    """
    assert plot.scales is not None, "add_line_plot sets scales"
    y = {**plot.scales["y"], "range": (low, high)}
    scales = {"x": {**plot.scales["x"], "range": _outwards(plot.data[0])}, "y": y}
    if plot.scales != scales:
        plot.scales = cast(dict[str, uplot.Scale], scales)


def _outwards(x: FloatArray) -> tuple[float, float]:
    """The least and the greatest of rising values, rounded to half of a power of ten."""
    least, greatest = float(x[0]), float(x[-1])
    if not greatest > least:
        return least, least + 1.0
    step = 0.5 * 10.0 ** np.floor(np.log10(greatest - least))
    return float(step * np.floor(least / step)), float(step * np.ceil(greatest / step))


def no_data(series: int) -> tuple[FloatArray, ...]:
    """Empty data for this number of series."""
    return (np.arange(2.0), *(np.full(2, np.nan) for _ in range(series)))


def line(label: str, color: Color, *, dashed: bool = False) -> uplot.Series:
    """A series without gaps, as a line."""
    style = uplot.Series(
        label=label, stroke=css(color), width=1.5, points=uplot.Series_Points(show=False)
    )
    return uplot.Series(**style, dash=_DASH_PX) if dashed else style


def dots(label: str, color: Color, size_px: float = 4.0, *, hollow: bool = False) -> uplot.Series:
    """A series that may have gaps, as dots or rings."""
    points = uplot.Series_Points(
        show=True,
        size=size_px,
        stroke=css(color),
        width=1,
        fill="transparent" if hollow else css(color),
    )
    # Without a line between them, and ignored by the automatic range of y.
    return uplot.Series(label=label, stroke=css(color), width=0, auto=False, points=points)


def area(label: str, color: Color) -> uplot.Series:
    """A series as the area below it."""
    fill = css(color)
    points = uplot.Series_Points(show=False)
    return uplot.Series(label=label, stroke=fill, fill=fill, width=0, points=points)


def css(color: Color) -> str:
    """A colour in CSS syntax."""
    return f"rgb({color[0]},{color[1]},{color[2]})"


def whole_limits(*curves: FloatArray) -> tuple[float, float]:
    """Whole numbers around all values, so that they seldom change from frame to frame."""
    values = np.concatenate(curves)
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    low, high = float(np.floor(values.min())), float(np.ceil(values.max()))
    return low, max(high, low + 1.0)


def with_vertical_line(
    x: FloatArray,
    curves: Sequence[FloatArray],
    at: float,
    limits: tuple[float, float],
    *,
    interpolate: bool,
) -> tuple[FloatArray, ...]:
    """The data with one more series, a vertical line at ``at`` between ``limits``.

    x has that place twice more then, where the curves are interpolated or, as dots, have no value.
    """
    place = int(np.searchsorted(x, at))
    values = np.full(x.size, np.nan)
    data = [np.insert(x, place, (at, at))]
    for curve in curves:
        between = np.interp(at, x, curve, np.nan, np.nan) if interpolate and x.size else np.nan
        data.append(np.insert(curve, place, (between, between)))
    return (*data, np.insert(values, place, limits))


def _scales(y_limits: Limits, *, x_falls: bool) -> dict[str, uplot.Scale]:
    return {
        "x": uplot.Scale(time=False, dir=-1 if x_falls else 1),
        "y": uplot.Scale(range=y_limits),
    }


def _axes(x_label: str, y_label: str, theme: Theme) -> tuple[uplot.Axis, uplot.Axis]:
    x = uplot.Axis(label=x_label, labelSize=_LABEL_PX, size=_X_AXIS_PX)
    y = uplot.Axis(label=y_label, labelSize=_LABEL_PX, size=_Y_AXIS_PX)
    if not theme.is_dark:
        # viser's own colours are for a light page; its dark grid cannot be seen.
        return x, y
    grid, ticks = uplot.Axis_Grid(stroke=css(theme.grid)), uplot.Axis_Ticks(stroke=css(theme.grey))
    text = css(theme.ink)
    return (
        uplot.Axis(**x, stroke=text, grid=grid, ticks=ticks),
        uplot.Axis(**y, stroke=text, grid=grid, ticks=ticks),
    )


def _in_theme(series: uplot.Series, theme: Theme) -> uplot.Series:
    """A series whose colours of other themes are replaced by those of this one."""
    colors = _counterparts(theme)

    def themed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: themed(part) for key, part in value.items()}
        return colors.get(value, value) if isinstance(value, str) else value

    keys = ("stroke", "fill", "points")
    changed = {key: themed(value) for key, value in series.items() if key in keys}
    return cast("uplot.Series", {**series, **changed})


@cache
def _counterparts(theme: Theme) -> dict[str, str]:
    """The colour of this theme, by that of any theme for the same thing."""
    return {
        css(before): css(after)
        for other in (LIGHT, DARK)
        for before, after in zip(_own(other), _own(theme), strict=True)
    }


def _own(theme: Theme) -> tuple[Color, ...]:
    """The colours of data that differ from theme to theme."""
    return theme.ink, theme.neutral, theme.fused
