"""What pictures share: cells under pixels, round ticks, hatched gaps, legends that fit."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.plots.palette import color_map
from scanloom.plots.sheet import (
    LegendEntry,
    cells_of_pixels,
    hatch,
    hatched,
    legend_lines,
    number,
    paint_values,
    room,
    ticks_between,
    whole_ticks_between,
    wide_limits,
)


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
    assert [number(value) for value in (-0.25, 150, 0.00025, 0.0)] == [
        "−0.25",
        "150",
        "2.5e−4",
        "0",
    ]


def test_values_take_the_colours_between_the_limits_and_gaps_are_hatched() -> None:
    colors = color_map("viridis")
    values = np.array([[0.0, 1.0], [np.nan, 5.0]])
    target = np.zeros((40, 40, 3), dtype=np.uint8)
    paint_values(target, values, (0.0, 1.0), colors)
    assert (target[:20, :20] == colors[0]).all()
    assert (target[:20, 20:] == colors[255]).all()
    assert (target[20:, 20:] == colors[255]).all()
    assert np.array_equal(target[20:, :20], hatch(40, 40)[20:, :20])


def test_without_limits_all_is_hatched() -> None:
    target = np.zeros((9, 11, 3), dtype=np.uint8)
    paint_values(target, np.full((2, 2), np.nan), None, color_map("viridis"))
    assert np.array_equal(target, hatch(9, 11))


def test_the_hatch_is_neutral() -> None:
    spread = np.ptp(hatch(20, 20).astype(int), axis=2)
    assert spread.max() < 16


@pytest.mark.parametrize("value", [0.0, 0.4, -3.0, 1e9])
def test_limits_of_one_value_are_apart(value: float) -> None:
    low, high = wide_limits(value, value)
    assert low < value < high


@given(st.lists(st.text("abc ", max_size=40), max_size=12), st.integers(60, 600))
def test_a_legend_keeps_every_entry_in_order(words: list[str], width_px: int) -> None:
    entries = [LegendEntry(hatched, text) for text in words]
    lines = legend_lines(entries, width_px)
    assert [entry for line in lines for entry in line] == entries
    assert all(lines)


def test_a_picture_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match="leaves"):
        room(50, 50, 60, 300)
