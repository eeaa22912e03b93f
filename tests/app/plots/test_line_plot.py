"""Plots of curves: what viser is given, and the line at the present place."""

from collections.abc import Iterator

import numpy as np
import pytest
import viser
from hypothesis import given
from hypothesis import strategies as st

from scanloom.plots.line_plot import (
    INK,
    NEUTRAL,
    PlotLabels,
    _outwards,
    add_line_plot,
    css,
    dots,
    line,
    set_limits,
    set_theme,
    whole_limits,
    with_vertical_line,
)
from scanloom.plots.theme import DARK, LIGHT

BLUE = (0, 0, 255)


@pytest.fixture(scope="module")
def gui() -> Iterator[viser.GuiApi]:
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server.gui
    server.stop()


@pytest.mark.parametrize("x_falls", [False, True])
def test_a_plot_has_its_labels_and_begins_empty_and_hidden(
    gui: viser.GuiApi, x_falls: bool
) -> None:
    labels = PlotLabels(title="T", x="time (s)", x_short="s", y="gap (ms)", x_falls=x_falls)
    plot = add_line_plot(gui, labels, (line("a", BLUE), dots("b", BLUE)))
    assert plot.axes is not None
    assert [axis["label"] for axis in plot.axes] == ["time (s)", "gap (ms)"]
    assert [series["label"] for series in plot.series] == ["s", "a", "b"]
    assert not plot.visible
    assert np.isnan(plot.data[1:]).all()
    scales = plot.scales
    assert scales is not None
    assert scales["x"]["dir"] == (-1 if x_falls else 1)
    plot.data = np.arange(58.0), np.zeros(58), np.zeros(58)
    set_limits(plot, -2.0, 2.0)
    limited = plot.scales
    assert limited["y"]["range"] == (-2.0, 2.0)
    assert limited["x"] == {**scales["x"], "range": (0.0, 60.0)}
    # Nearly the same limits are not sent again: they would set the plot up anew.
    plot.data = np.arange(60.0), np.zeros(60), np.zeros(60)
    set_limits(plot, -2.0, 2.0)
    assert plot.scales is limited


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=9))
def test_limits_of_x_hold_all_values_and_are_near_them(values: list[float]) -> None:
    x = np.sort(np.array(values))
    low, high = _outwards(x)
    assert low < high
    assert low <= x[0] + 1e-9 * abs(x[0])
    assert high >= x[-1] - 1e-9 * abs(x[-1])
    assert high - low <= max(2.0 * (x[-1] - x[0]), 1.0)


@given(st.lists(st.floats(-1e3, 1e3) | st.just(float("nan")), max_size=20))
def test_whole_limits_are_apart_around_all_values(values: list[float]) -> None:
    low, high = whole_limits(np.array(values), np.array([]))
    assert low < high
    assert (low, high) == (np.floor(low), np.ceil(high))
    known = [value for value in values if np.isfinite(value)]
    assert all(low <= value <= high for value in known)


@given(at=st.floats(-5.0, 15.0), interpolate=st.booleans())
def test_a_vertical_line_stands_at_its_place_and_moves_no_curve(
    at: float, interpolate: bool
) -> None:
    x = np.linspace(0.0, 10.0, 21)
    curve = x**2
    new_x, new_curve, upright = with_vertical_line(
        x, (curve,), at, (-1.0, 2.0), interpolate=interpolate
    )
    assert (np.diff(new_x) >= 0.0).all()
    marked = np.isfinite(upright)
    assert new_x[marked].tolist() == [at, at]
    assert upright[marked].tolist() == [-1.0, 2.0]
    np.testing.assert_array_equal(new_x[~marked], x)
    np.testing.assert_array_equal(new_curve[~marked], curve)
    inside = interpolate and 0.0 <= at <= 10.0
    expected = np.interp(at, x, curve) if inside else np.nan
    np.testing.assert_array_equal(new_curve[marked], [expected, expected])


def test_a_theme_changes_axes_and_lines_and_back(gui: viser.GuiApi) -> None:
    labels = PlotLabels(title="T", x="time (s)", x_short="s", y="gap (ms)")
    plot = add_line_plot(gui, labels, (line("a", INK), dots("b", NEUTRAL), line("c", BLUE)))
    axes, series = plot.axes, plot.series
    set_theme(plot, DARK)
    assert plot.axes is not None
    assert [axis["label"] for axis in plot.axes] == ["time (s)", "gap (ms)"]
    assert {axis["stroke"] for axis in plot.axes} == {css(DARK.ink)}
    strokes = [one["stroke"] for one in plot.series[1:]]
    assert strokes == [css(DARK.ink), css(DARK.neutral), css(BLUE)]
    assert plot.series[2]["points"]["fill"] == css(DARK.neutral)
    dark = plot.axes
    set_theme(plot, DARK)
    # The same theme is not sent again.
    assert plot.axes is dark
    set_theme(plot, LIGHT)
    assert plot.axes == axes
    assert plot.series == series
