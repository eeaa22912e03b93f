"""Cell by cell fusion of two occupancy grids of one place (Fu 2024 §3.2).

Table 3 gives the fused state of a cell: occupied where either grid has it occupied, else empty
where either has it empty, else unknown. Unknown is a state of its own and no probability of 1/2.

By Bayes' rule (9) each beam adds its own log-odds to the cells of a grid
(``growing_grid.GrowingGrid``; prior 1/2). What two independent grids say of a cell joins in the
same way, which is (10):

    P = P_s P_m / (P_s P_m + (1 - P_s) (1 - P_m)),  or  l = l_s + l_m with l = log(P / (1 - P)).

A grid to which a cell is unknown adds nothing. (10) holds for grids that share no beam: a return
that is in both would count twice. Table 3 adds nothing up, so there it does no harm.

The two disagree where one grid has a cell occupied and the other has it empty: by Table 3 an
obstacle wins, by (10) the larger evidence. A beam that passes over a low box says nothing of the
box, so the sensors of different heights are fused by Table 3 and (10)'s probability is shown.
"""

import math
from collections.abc import Mapping

import numpy as np

from fusion_core.mapping.canvas import pad_to_common_canvas
from fusion_core.model.conventions import FloatArray
from fusion_core.model.grid_fusion import CellEvidence, FusionRule, GridFusion
from fusion_core.model.grids import OccupancyGrid


def fuse_grids(grids: Mapping[str, OccupancyGrid]) -> GridFusion:
    """Two grids by name fused by both rules.

    Raises ValueError unless there are two, of one resolution, in one frame, on one raster.
    """
    layers = _pad_two(grids)
    return GridFusion(
        layers=layers,
        table=_fused_on_canvas(layers, "table"),
        bayes=_fused_on_canvas(layers, "bayes"),
    )


def fuse_grids_by(rule: FusionRule, grids: Mapping[str, OccupancyGrid]) -> OccupancyGrid:
    """Two grids by name fused by one rule, on the smallest canvas that covers both.

    "table": each cell has the log-odds of the grid that decides its state: the higher ones where
    either has it occupied, else the lower. Raises ValueError as ``fuse_grids``.
    """
    return _fused_on_canvas(_pad_two(grids), rule)


def cell_evidence(grids: Mapping[str, OccupancyGrid], x_m: float, y_m: float) -> CellEvidence:
    """What two grids by name, on one raster, know of the cell at (x, y) in the map frame.

    Raises ValueError unless there are two of one resolution, and for a place that is not finite.
    """
    if not (math.isfinite(x_m) and math.isfinite(y_m)):
        raise ValueError(f"a place must be finite, got {x_m}, {y_m}")
    first = next(iter(grids.values()))
    # Cells are counted from the first grid, so that rounding cannot part one place in two cells.
    column, row = (
        math.floor((value - low) / first.resolution_m)
        for value, low in zip((x_m, y_m), first.origin_m, strict=True)
    )
    corner_m = (
        first.origin_m[0] + column * first.resolution_m,
        first.origin_m[1] + row * first.resolution_m,
    )
    cells = {name: _cut_cell(grid, corner_m) for name, grid in grids.items()}
    fusion = fuse_grids(cells)
    return CellEvidence(
        centre_m=(corner_m[0] + 0.5 * first.resolution_m, corner_m[1] + 0.5 * first.resolution_m),
        log_odds={name: float(cell.log_odds[0, 0]) for name, cell in cells.items()},
        table_log_odds=float(fusion.table.log_odds[0, 0]),
        bayes_log_odds=float(fusion.bayes.log_odds[0, 0]),
    )


def _cut_cell(grid: OccupancyGrid, corner_m: tuple[float, float]) -> OccupancyGrid:
    """The one cell with that outer corner; unknown outside of the grid."""
    column, row = (
        round((value - low) / grid.resolution_m)
        for value, low in zip(corner_m, grid.origin_m, strict=True)
    )
    rows, columns = grid.log_odds.shape
    inside = 0 <= row < rows and 0 <= column < columns
    value = grid.log_odds[row, column] if inside else math.nan
    return OccupancyGrid(
        resolution_m=grid.resolution_m,
        origin_m=corner_m,
        log_odds=np.array([[value]], dtype=np.float64),
        frame_id=grid.frame_id,
    )


def _pad_two(grids: Mapping[str, OccupancyGrid]) -> dict[str, OccupancyGrid]:
    if len(grids) != 2:
        raise ValueError(f"two grids are fused, got {len(grids)}")
    return pad_to_common_canvas(grids)


def _fused_on_canvas(layers: Mapping[str, OccupancyGrid], rule: FusionRule) -> OccupancyGrid:
    first, second = layers.values()
    combine = _decide_by_table if rule == "table" else _add_log_odds
    return OccupancyGrid(
        resolution_m=first.resolution_m,
        origin_m=first.origin_m,
        log_odds=combine(first.log_odds, second.log_odds),
        frame_id=first.frame_id,
    )


def _decide_by_table(first: FloatArray, second: FloatArray) -> FloatArray:
    """Table 3. NaN compares false, and stays where both are."""
    highest: FloatArray = np.fmax(first, second)
    return np.where(highest > 0.0, highest, np.fmin(first, second))


def _add_log_odds(first: FloatArray, second: FloatArray) -> FloatArray:
    """(10), with what is unknown to one taken from the other."""
    only_second = np.where(np.isnan(first), second, first + second)
    return np.where(np.isnan(second), first, only_second)
