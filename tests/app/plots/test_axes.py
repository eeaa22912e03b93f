"""What pictures share: places of points, cells under pixels, round ticks, hatched gaps, legends."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.plots.axes import Axes, fit_axes, image_axes, metric_axes
from scanloom.plots.canvas import Box, blank_canvas, box_between
from scanloom.plots.color_scale import ColorScale, cells_of_pixels, hatch
from scanloom.plots.legend import Legend, LegendEntry, hatch_symbol
from scanloom.plots.palette import color_map
from scanloom.plots.ticks import (
    distinct_limits,
    number_label,
    ticks_between,
    time_ticks,
    whole_ticks_between,
)

BOX = Box(50, 20, 200, 100)
BLUE = (0, 0, 255)

limits = st.tuples(st.floats(-1e3, 1e3), st.floats(0.01, 1e3), st.booleans()).map(
    lambda drawn: (drawn[0], drawn[0] + (drawn[1] if drawn[2] else -drawn[1]))
)


def axes(x_limits: tuple[float, float] = (0, 20), y_limits: tuple[float, float] = (0, 10)) -> Axes:
    return Axes(rgb=blank_canvas(300, 150), box=BOX, x_limits=x_limits, y_limits=y_limits)


def colored(picture: Axes) -> tuple[np.ndarray, np.ndarray]:
    """x and y of the picture's pixels that are blue."""
    rows, columns = np.nonzero((picture.rgb == BLUE).all(axis=2))
    return columns, rows


@given(limits, limits, st.tuples(st.floats(0.001, 0.999), st.floats(0.001, 0.999)))
def test_a_pixel_and_its_point_undo_each_other(
    x_limits: tuple[float, float], y_limits: tuple[float, float], fraction: tuple[float, float]
) -> None:
    picture = axes(x_limits, y_limits)
    x, y = (
        low + part * (high - low)
        for part, (low, high) in zip(fraction, (x_limits, y_limits), strict=True)
    )
    place = picture.to_pixel(x, y)
    assert place == pytest.approx((49.5 + fraction[0] * 200, 119.5 - fraction[1] * 100), abs=1e-6)
    assert picture.to_data(*place) == pytest.approx((x, y), abs=1e-6)


def test_outside_of_the_box_there_is_no_point() -> None:
    picture = axes()
    for place in ((49.4, 60.0), (249.6, 60.0), (100.0, 19.4), (100.0, 119.6), (math.nan, 60.0)):
        assert picture.to_data(*place) is None
    assert picture.to_data(49.5, 119.4) is not None


def test_what_is_drawn_is_where_its_numbers_are_and_clipped_to_the_box() -> None:
    picture = axes()
    picture.draw_dots(np.array([[5.0, 5.0], [19.9, 9.9], [-8.0, 5.0], [np.nan, 1.0]]), BLUE, 3.0)
    x, y = colored(picture)
    assert x.min() == pytest.approx(picture.to_pixel(5.0, 5.0)[0] - 3, abs=1)
    assert (x.max(), y.min()) == (BOX.right - 1, BOX.top)
    assert y.max() <= picture.to_pixel(5.0, 5.0)[1] + 4
    picture = axes()
    picture.draw_line(np.array([[-50.0, 2.0], [500.0, 2.0]]), BLUE)
    x, y = colored(picture)
    assert (x.min(), x.max()) == (BOX.left, BOX.right - 1)
    assert np.abs(y - picture.to_pixel(0.0, 2.0)[1]).max() <= 1.5


def test_axes_of_an_image_count_its_pixels_from_the_top() -> None:
    picture = image_axes(blank_canvas(300, 150), BOX, (10, 40), first_column=-5)
    assert picture.to_data(BOX.left + 2, BOX.top + 4.5) == pytest.approx((-5.0, 0.0), abs=0.11)
    x, y = picture.to_pixel(34, 9)
    assert BOX.right - 5 <= x < BOX.right
    assert BOX.bottom - 10 <= y < BOX.bottom


def test_metric_axes_have_one_scale_and_show_all_that_is_asked_for() -> None:
    canvas = blank_canvas(300, 150)
    picture = metric_axes(canvas, BOX, np.array([1.0, 2.0]), 25.0)
    assert picture.px_per_unit == pytest.approx((25.0, 25.0))
    assert picture.to_pixel(1.0, 2.0) == pytest.approx((149.5, 69.5))
    low, high = np.array([-3.0, 0.0]), np.array([5.0, 1.0])
    fitted = fit_axes(canvas, BOX, low, high)
    assert fitted.px_per_unit == pytest.approx((25.0, 25.0))
    assert fitted.x_limits == pytest.approx((-3.0, 5.0))
    assert fitted.y_limits == pytest.approx((-1.5, 2.5))


@given(st.integers(1, 500), st.integers(1, 900))
def test_a_pixel_shows_the_cell_at_its_centre(cells: int, pixels: int) -> None:
    shown = cells_of_pixels(cells, pixels)
    exact = [math.floor(Fraction(2 * pixel + 1, 2 * pixels) * cells) for pixel in range(pixels)]
    assert shown.tolist() == exact
    assert 0 <= shown[0] <= shown[-1] < cells


@given(
    st.floats(-1e4, 1e4),
    st.floats(1e-6, 1e4),
    st.integers(2, 12),
)
def test_ticks_are_few_round_and_within(low: float, span: float, most: int) -> None:
    high = low + span
    ticks = ticks_between(low, high, most)
    assert len(ticks) <= most
    tolerance = 1e-6 * span + 1e-9 * abs(low)
    assert all(low - tolerance <= tick <= high + tolerance for tick in ticks)
    if len(ticks) > 2:
        steps = np.diff(ticks)
        assert np.allclose(steps, steps[0], rtol=1e-3)


def test_ticks_of_known_axes() -> None:
    assert ticks_between(-0.3, 1.0, 7) == [-0.2, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    assert ticks_between(0, 182, 4) == [0, 50, 100, 150]
    assert ticks_between(5.0, 5.0, 4) == [5.0]
    assert whole_ticks_between(0, 1, 8) == [0, 1]


def test_numbers_are_short_and_have_a_true_minus() -> None:
    assert [number_label(value) for value in (-0.25, 150, 0.00025, 0.0)] == [
        "−0.25",
        "150",
        "2.5e−4",
        "0",
    ]


def test_values_take_the_colours_between_the_limits_and_gaps_are_hatched() -> None:
    colors = color_map("viridis")
    values = np.array([[0.0, 1.0], [np.nan, 5.0]])
    target = np.zeros((40, 40, 3), dtype=np.uint8)
    ColorScale(colors=colors, limits=(0.0, 1.0)).paint(target, values)
    assert (target[:20, :20] == colors[0]).all()
    assert (target[:20, 20:] == colors[255]).all()
    assert (target[20:, 20:] == colors[255]).all()
    assert np.array_equal(target[20:, :20], hatch(40, 40)[20:, :20])


def test_without_limits_all_is_hatched() -> None:
    target = np.zeros((9, 11, 3), dtype=np.uint8)
    ColorScale(colors=color_map("viridis"), limits=None).paint(target, np.full((2, 2), np.nan))
    assert np.array_equal(target, hatch(9, 11))


def test_the_hatch_is_neutral() -> None:
    spread = np.ptp(hatch(20, 20).astype(int), axis=2)
    assert spread.max() < 16


@pytest.mark.parametrize("value", [0.0, 0.4, -3.0, 1e9])
def test_limits_of_one_value_are_apart(value: float) -> None:
    low, high = distinct_limits(value, value)
    assert low < value < high


@given(st.lists(st.text("abc ", max_size=40), max_size=12), st.integers(60, 600))
def test_a_legend_keeps_every_entry_in_order(labels: list[str], width_px: int) -> None:
    entries = [LegendEntry(hatch_symbol, label) for label in labels]
    legend = Legend.of(entries, width_px)
    assert [entry for line in legend.lines for entry in line] == entries
    assert all(legend.lines)


def test_a_picture_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match="leaves"):
        box_between(50, 50, 60, 300)


@pytest.mark.parametrize(
    ("last_s", "labels"),
    [
        (9.9, ["0 s", "5 s"]),
        (299.0, ["0 s", "100 s", "200 s"]),
        (300.0, ["0 min", "2 min", "4 min"]),
        (2691.0, ["0 min", "20 min", "40 min"]),
        (6.0 * 3600.0, ["0 h", "5 h"]),
    ],
)
def test_long_times_have_long_units(last_s: float, labels: list[str]) -> None:
    ticks = time_ticks(0.0, last_s, 3)
    assert [label for _, label in ticks] == labels
    seconds_of = {"s": 1.0, "min": 60.0, "h": 3600.0}
    for value_s, label in ticks:
        number, unit = label.split()
        assert value_s == float(number) * seconds_of[unit]
