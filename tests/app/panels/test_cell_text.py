"""What is said of a cell: each grid's state, and what both rules make of them."""

import html
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.grid_fusion import CellState
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.grid_fusion import cell_evidence
from scanloom.panels.cell_text import cell_state, evidence_html, states_html

RESOLUTION_M = 0.05


def grid(values: list[list[float]]) -> OccupancyGrid:
    return OccupancyGrid(
        resolution_m=RESOLUTION_M, origin_m=(-1.0, 2.0), log_odds=np.array(values, dtype=float)
    )


def rows(said: str) -> list[list[str]]:
    """The cells of a table's rows."""
    lines = re.findall(r"<tr>(.*?)</tr>", said)
    return [[html.unescape(cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", x)] for x in lines]


def test_both_grids_and_both_rules_are_told() -> None:
    lidar, camera = grid([[-2.0, 1.0]]), grid([[0.5, math.nan]])
    said = evidence_html(cell_evidence({"LiDAR": lidar, "camera": camera}, -0.98, 2.01))
    assert "x = -0.975 m, y = 2.025 m" in said
    assert rows(said) == [
        ["LiDAR", "free", "0.119", "-2.00"],
        ["camera", "occupied", "0.622", "+0.50"],
        ["by Table 3", "occupied", "0.622", "+0.50"],
        # (10): the log odds add up.
        ["by (10)", "free", "0.182", "-1.50"],
    ]
    assert "The rules differ" in said
    beside = evidence_html(cell_evidence({"LiDAR": lidar, "camera": camera}, -0.93, 2.01))
    assert rows(beside)[1] == ["camera", "unknown", "–", "–"]
    assert rows(beside)[3] == ["by (10)", "occupied", "0.731", "+1.00"]
    assert "The rules differ" not in beside


def test_outside_nothing_is_known() -> None:
    known = grid([[-2.0]])
    for place in ((5.0, 5.0), (-1.01, 2.01), (-0.99, 2.06)):
        assert cell_state(known, *place) is CellState.UNKNOWN
        said = evidence_html(cell_evidence({"a": known, "b": known}, *place))
        assert {row[1] for row in rows(said)} == {"unknown"}


@given(st.integers(0, 2), st.integers(0, 3), st.floats(0.1, 0.9), st.floats(0.1, 0.9))
def test_a_cell_is_the_one_that_holds_the_place(
    row: int, column: int, down: float, across: float
) -> None:
    values = np.full((3, 4), -1.0)
    values[row, column] = 1.0
    x_m = -1.0 + (column + across) * RESOLUTION_M
    y_m = 2.0 + (row + down) * RESOLUTION_M
    assert cell_state(grid(values.tolist()), x_m, y_m) is CellState.OCCUPIED


@pytest.mark.parametrize("name", ["<b>bold", "a & b"])
def test_names_are_text(name: str) -> None:
    said = states_html({name: grid([[1.0]])}, -0.98, 2.01)
    assert "<b>" not in said
    assert rows(said) == [[name, "occupied"]]
