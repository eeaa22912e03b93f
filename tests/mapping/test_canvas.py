"""Grids on one canvas: against a dictionary of cells."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.mapping.canvas import pad_to_common_canvas
from fusion_core.model.grids import OccupancyGrid

CELL_M = 0.1

grids = st.builds(
    lambda row, column, rows, columns, seed: _grid(row, column, rows, columns, seed),
    st.integers(-4, 4),
    st.integers(-4, 4),
    st.integers(1, 4),
    st.integers(1, 4),
    st.integers(0, 99),
)


def _grid(row: int, column: int, rows: int, columns: int, seed: int) -> OccupancyGrid:
    rng = np.random.default_rng(seed)
    log_odds = rng.normal(size=(rows, columns))
    log_odds[rng.random((rows, columns)) < 0.3] = np.nan
    return OccupancyGrid(
        resolution_m=CELL_M, origin_m=(column * CELL_M, row * CELL_M), log_odds=log_odds
    )


def cells(grid: OccupancyGrid) -> dict[tuple[int, int], float]:
    """Known cells by their place on the raster."""
    column, row = (round(value / CELL_M) for value in grid.origin_m)
    return {(row + r, column + c): float(grid.log_odds[r, c]) for r, c in np.argwhere(grid.known)}


@given(grids, grids)
def test_a_canvas_changes_no_cell(first: OccupancyGrid, second: OccupancyGrid) -> None:
    laid = pad_to_common_canvas({"a": first, "b": second})
    assert cells(laid["a"]) == cells(first)
    assert cells(laid["b"]) == cells(second)
    assert laid["a"].log_odds.shape == laid["b"].log_odds.shape
    assert laid["a"].origin_m == laid["b"].origin_m


def test_another_raster_is_refused() -> None:
    shifted = OccupancyGrid(resolution_m=CELL_M, origin_m=(0.04, 0.0), log_odds=np.zeros((1, 1)))
    with pytest.raises(ValueError, match="do not lie on those"):
        pad_to_common_canvas({"a": _grid(0, 0, 1, 1, 0), "b": shifted})
