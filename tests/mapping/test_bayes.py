"""Two grids fused cell by cell: Table 3 and (10) of Fu 2024 against the paper's own words and a
plain loop over cells."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.mapping.bayes import cell_evidence, fuse_grids, fuse_grids_by
from fusion_core.mapping.growing_grid import log_odds
from fusion_core.model.grid_fusion import CellState, GridFusion, cell_states
from fusion_core.model.grids import OccupancyGrid

CELL_M = 0.1
OCC, EMP, UNK = CellState.OCCUPIED, CellState.EMPTY, CellState.UNKNOWN
VALUE = {OCC: 0.8, EMP: -0.4, UNK: math.nan}

# Table 3 of the paper, row by row: (camera, LiDAR, fused).
TABLE_3 = [
    (OCC, OCC, OCC),
    (OCC, EMP, OCC),
    (OCC, UNK, OCC),
    (EMP, OCC, OCC),
    (EMP, EMP, EMP),
    (EMP, UNK, EMP),
    (UNK, OCC, OCC),
    (UNK, EMP, EMP),
    (UNK, UNK, UNK),
]


def _grid(rows: list[list[float]], row: int = 0, column: int = 0) -> OccupancyGrid:
    return OccupancyGrid(
        resolution_m=CELL_M,
        origin_m=(column * CELL_M, row * CELL_M),
        log_odds=np.array(rows, dtype=np.float64),
    )


def _of_seed(row: int, column: int, rows: int, columns: int, seed: int) -> OccupancyGrid:
    rng = np.random.default_rng(seed)
    values = rng.normal(scale=2.0, size=(rows, columns))
    values[rng.random((rows, columns)) < 0.3] = np.nan
    # Undecided: known, and not known to be anything.
    values[rng.random((rows, columns)) < 0.1] = 0.0
    return _grid(values.tolist(), row, column)


grids = st.builds(
    _of_seed,
    st.integers(-4, 4),
    st.integers(-4, 4),
    st.integers(1, 4),
    st.integers(1, 4),
    st.integers(0, 99),
)


def cells(grid: OccupancyGrid) -> dict[tuple[int, int], float]:
    """Known cells by their place on the raster."""
    column, row = (round(value / CELL_M) for value in grid.origin_m)
    return {(row + r, column + c): float(grid.log_odds[r, c]) for r, c in np.argwhere(grid.known)}


@pytest.mark.parametrize(("camera", "lidar", "fused"), TABLE_3)
def test_the_nine_cases_of_table_3(camera: CellState, lidar: CellState, fused: CellState) -> None:
    fusion = fuse_grids({"camera": _grid([[VALUE[camera]]]), "lidar": _grid([[VALUE[lidar]]])})
    assert cell_states(fusion.table.log_odds).item() == fused
    # Unknown stays without a probability, by either rule: it is not 1/2.
    for grid in (fusion.table, fusion.bayes):
        assert np.isnan(grid.probability.item()) == (camera == lidar == UNK)


@pytest.mark.parametrize(
    ("first", "second", "by_ten"), [(0.7, 0.3, 0.5), (0.6, 0.1, 1.0 / 7.0), (0.7, 0.7, 49.0 / 58.0)]
)
def test_ten_by_hand(first: float, second: float, by_ten: float) -> None:
    fusion = fuse_grids({"a": _grid([[log_odds(first)]]), "b": _grid([[log_odds(second)]])})
    assert fusion.bayes.probability.item() == pytest.approx(by_ten)
    # The table takes the state of the grid that has an obstacle, and that grid's probability.
    assert fusion.table.probability.item() == pytest.approx(first)


@given(grids, grids)
def test_the_table_keeps_obstacles_in_each_cell(
    first: OccupancyGrid, second: OccupancyGrid
) -> None:
    expected = cells(first)
    for place, value in cells(second).items():
        values = [value, expected.get(place, value)]
        expected[place] = max(values) if max(values) > 0.0 else min(values)
    assert cells(fuse_grids_by("table", {"a": first, "b": second})) == expected


@given(grids, grids)
def test_ten_against_a_plain_loop(first: OccupancyGrid, second: OccupancyGrid) -> None:
    fusion = fuse_grids({"a": first, "b": second})
    p, q = (
        {place: 1.0 / (1.0 + math.exp(-value)) for place, value in cells(grid).items()}
        for grid in (first, second)
    )
    fused = {place: 1.0 / (1.0 + math.exp(-value)) for place, value in cells(fusion.bayes).items()}
    assert fused.keys() == p.keys() | q.keys()
    for place, probability in fused.items():
        if place in p and place in q:
            both, neither = p[place] * q[place], (1.0 - p[place]) * (1.0 - q[place])
            assert probability == pytest.approx(both / (both + neither), rel=1e-12)
        else:
            # Unknown to one is no evidence.
            assert probability == pytest.approx(p[place] if place in p else q[place], rel=1e-12)


@given(grids, grids)
def test_the_order_of_the_grids_does_not_matter(
    first: OccupancyGrid, second: OccupancyGrid
) -> None:
    ab, ba = fuse_grids({"a": first, "b": second}), fuse_grids({"b": second, "a": first})
    assert cells(ab.table) == cells(ba.table)
    assert cells(ab.bayes) == cells(ba.bayes)


@given(grids)
def test_an_unknown_grid_is_neutral(grid: OccupancyGrid) -> None:
    nothing = _grid([[math.nan] * 3])
    fusion = fuse_grids({"a": grid, "b": nothing})
    assert cells(fusion.table) == cells(fusion.bayes) == cells(grid)


@given(grids, grids)
def test_the_states_are_counted_and_the_rules_differ_only_against_an_obstacle(
    first: OccupancyGrid, second: OccupancyGrid
) -> None:
    fusion = fuse_grids({"a": first, "b": second})
    counts = fusion.count_states()
    assert len(counts) == 9
    assert sum(counts.values()) == fusion.table.log_odds.size
    a, b = (cell_states(fusion.layers[name].log_odds) for name in ("a", "b"))
    assert counts["occupied empty"] == sum(
        x == OCC and y == EMP for x, y in zip(a.flat, b.flat, strict=True)
    )
    table = cell_states(fusion.table.log_odds)
    differ = [
        place
        for place in np.ndindex(table.shape)
        if table[place] == OCC and not fusion.bayes.log_odds[place] > 0.0
    ]
    assert [tuple(place) for place in np.argwhere(fusion.rules_differ)] == differ


@given(grids, grids, st.floats(-1.0, 1.5), st.floats(-1.0, 1.5))
def test_the_evidence_of_a_cell_is_that_of_the_grids(
    first: OccupancyGrid, second: OccupancyGrid, x_m: float, y_m: float
) -> None:
    evidence = cell_evidence({"a": first, "b": second}, x_m, y_m)
    place = tuple(round(value / CELL_M - 0.5) for value in reversed(evidence.centre_m))
    assert abs(evidence.centre_m[0] - x_m) <= 0.5 * CELL_M + 1e-9
    assert abs(evidence.centre_m[1] - y_m) <= 0.5 * CELL_M + 1e-9
    nan = math.nan
    fusion = fuse_grids({"a": first, "b": second})
    for value, grid in (
        (evidence.log_odds["a"], first),
        (evidence.log_odds["b"], second),
        (evidence.table_log_odds, fusion.table),
        (evidence.bayes_log_odds, fusion.bayes),
    ):
        assert value == pytest.approx(cells(grid).get(place, nan), nan_ok=True)


def test_a_cell_says_its_states_and_probabilities() -> None:
    pair = {"lidar": _grid([[log_odds(0.1)]]), "camera": _grid([[log_odds(0.6), 1.0]])}
    evidence = cell_evidence(pair, 0.05, 0.05)
    assert evidence.states == {"lidar": EMP, "camera": OCC}
    assert evidence.probabilities == pytest.approx({"lidar": 0.1, "camera": 0.6})
    assert (evidence.table_state, evidence.bayes_state) == (OCC, EMP)
    assert evidence.bayes_probability == pytest.approx(1.0 / 7.0)
    beside = cell_evidence(pair, 0.15, 0.05)
    assert beside.states == {"lidar": UNK, "camera": OCC}
    assert math.isnan(beside.probabilities["lidar"])
    outside = cell_evidence(pair, 5.0, -5.0)
    assert outside.table_state == outside.bayes_state == UNK
    assert math.isnan(outside.bayes_probability)


def test_undecided_is_neither_occupied_nor_empty() -> None:
    assert cell_states(np.array([1e-9, -1e-9, 0.0, math.nan])).tolist() == [OCC, EMP, UNK, UNK]
    # It is known all the same: the other grid decides the state, and the probability stays.
    fusion = fuse_grids({"a": _grid([[0.0, 0.0, 0.0]]), "b": _grid([[-1.0, 1.0, math.nan]])})
    assert fusion.table.log_odds.tolist() == fusion.bayes.log_odds.tolist() == [[-1.0, 1.0, 0.0]]


def test_each_cell_is_found_whatever_the_rounding_of_the_origins() -> None:
    values = np.arange(1.0, 101.0).reshape(10, 10)
    first, second = _grid(values.tolist(), -37, 23), _grid(values.tolist(), -34, 19)
    pair = {"a": first, "b": second}
    for (row, column), value in cells(second).items():
        evidence = cell_evidence(pair, (column + 0.5) * CELL_M, (row + 0.5) * CELL_M)
        assert evidence.log_odds["b"] == value


def test_what_cannot_be_fused_is_refused() -> None:
    one = _grid([[1.0]])
    with pytest.raises(ValueError, match="two grids are fused, got 3"):
        fuse_grids({"a": one, "b": one, "c": one})
    coarse = OccupancyGrid(resolution_m=0.2, origin_m=(0.0, 0.0), log_odds=np.zeros((1, 1)))
    with pytest.raises(ValueError, match="another resolution"):
        fuse_grids({"a": one, "b": coarse})
    with pytest.raises(ValueError, match="must be finite"):
        cell_evidence({"a": one, "b": one}, math.nan, 0.0)
    with pytest.raises(ValueError, match="on one canvas"):
        GridFusion(layers={"a": one}, table=one, bayes=one)
