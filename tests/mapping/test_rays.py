"""The cells on a ray, against exact clipping in fractions."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.mapping.rays import trace_ray

coordinates = st.floats(-20.0, 20.0)
Cell = tuple[int, int]


def traced(x0: float, y0: float, x1: float, y1: float) -> list[Cell]:
    cells = np.full((200, 2), 10**6, dtype=np.int64)
    count = trace_ray(x0, y0, x1, y1, cells)
    assert (cells[count:] == 10**6).all()
    return [(int(row), int(column)) for row, column in cells[:count]]


def fraction_inside(x0: float, y0: float, x1: float, y1: float, cell: Cell) -> Fraction:
    """Fraction of a segment inside a cell (Liang & Barsky 1984), exact; negative where outside."""
    low, high = Fraction(0), Fraction(1)
    for start, end, first in ((x0, x1, cell[1]), (y0, y1, cell[0])):
        step = Fraction(end) - Fraction(start)
        if step == 0:
            if not first <= start <= first + 1:
                return Fraction(-1)
            continue
        entry, leave = sorted(
            ((first - Fraction(start)) / step, (first + 1 - Fraction(start)) / step)
        )
        low, high = max(low, entry), min(high, leave)
    return high - low


@given(coordinates, coordinates, coordinates, coordinates)
def test_exactly_the_cells_that_the_segment_crosses(
    x0: float, y0: float, x1: float, y1: float
) -> None:
    cells = traced(x0, y0, x1, y1)
    assert len(set(cells)) == len(cells)
    for cell in cells:
        assert fraction_inside(x0, y0, x1, y1, cell) > -1e-12
    rows = range(math.floor(min(y0, y1)), math.floor(max(y0, y1)) + 1)
    columns = range(math.floor(min(x0, x1)), math.floor(max(x0, x1)) + 1)
    crossed = {
        (row, column)
        for row in rows
        for column in columns
        if fraction_inside(x0, y0, x1, y1, (row, column)) > 1e-12
    }
    # Along a border between two cells the fraction in both is the same; one of them is traced.
    along_border = (x0 == x1 and x0 == round(x0)) or (y0 == y1 and y0 == round(y0))
    if not along_border:
        assert crossed <= set(cells)


@given(coordinates, coordinates, coordinates, coordinates)
def test_the_cells_lead_from_start_to_end_through_neighbours(
    x0: float, y0: float, x1: float, y1: float
) -> None:
    cells = traced(x0, y0, x1, y1)
    assert cells[0] == (math.floor(y0), math.floor(x0))
    assert cells[-1] == (math.floor(y1), math.floor(x1))
    steps = np.abs(np.diff(cells, axis=0)) if len(cells) > 1 else np.ones((1, 2))
    assert (steps.max(axis=1) == 1).all()


@given(coordinates, coordinates, coordinates, coordinates)
def test_mirroring_at_the_diagonal_mirrors_the_cells(
    x0: float, y0: float, x1: float, y1: float
) -> None:
    assert traced(y0, x0, y1, x1) == [(c, r) for r, c in traced(x0, y0, x1, y1)]


@pytest.mark.parametrize(("dx", "dy"), [(1, 1), (-1, 1), (1, -1), (-1, -1)])
def test_a_segment_through_corners_crosses_them_diagonally(dx: int, dy: int) -> None:
    cells = traced(0.5, 0.5, 0.5 + 4 * dx, 0.5 + 4 * dy)
    assert cells == [(k * dy, k * dx) for k in range(5)]


def test_within_one_cell_and_along_an_axis() -> None:
    assert traced(0.2, 0.2, 0.7, 0.9) == [(0, 0)]
    assert traced(0.2, 0.2, 0.2, 0.2) == [(0, 0)]
    assert traced(0.5, 2.5, 3.5, 2.5) == [(2, 0), (2, 1), (2, 2), (2, 3)]
    assert traced(0.5, 2.5, 0.5, -0.5) == [(2, 0), (1, 0), (0, 0), (-1, 0)]
