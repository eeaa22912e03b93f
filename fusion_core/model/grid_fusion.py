"""Two occupancy grids of one place fused cell by cell (Fu 2024, Table 3 and (10)), as values."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray
from fusion_core.model.grids import OccupancyGrid

FusionRule = Literal["table", "bayes"]


class CellState(IntEnum):
    """The three states of Table 3. ``UNKNOWN``: no beam has reached the cell, or what is known of
    it is undecided (P = 1/2, log-odds of 0)."""

    UNKNOWN = 0
    EMPTY = 1
    OCCUPIED = 2


def cell_states(log_odds: FloatArray) -> ByteArray:
    """The ``CellState`` of each cell, uint8 of the same shape: the more probable of the two, and
    ``UNKNOWN`` where the log-odds are NaN or 0."""
    # NaN compares false.
    decided = np.where(log_odds > 0.0, CellState.OCCUPIED, CellState.UNKNOWN)
    states: ByteArray = np.where(log_odds < 0.0, CellState.EMPTY, decided).astype(np.uint8)
    return states


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GridFusion:
    """Two grids and both fusions of them, all four on one canvas.

    ``layers``: the two grids by name. ``table``: each cell with the log-odds of the grid that
    decides its state by Table 3. ``bayes``: the probability of (10).
    """

    layers: Mapping[str, OccupancyGrid]
    table: OccupancyGrid
    bayes: OccupancyGrid

    def __post_init__(self) -> None:
        canvases = {
            (grid.log_odds.shape, grid.origin_m, grid.resolution_m)
            for grid in (*self.layers.values(), self.table, self.bayes)
        }
        if len(self.layers) != 2 or len(canvases) != 1:
            raise ValueError("two grids on one canvas are fused")

    @property
    def names(self) -> tuple[str, str]:
        """Of the two grids."""
        first, second = self.layers
        return first, second

    def fused(self, rule: FusionRule) -> OccupancyGrid:
        """The grid by a rule."""
        return self.table if rule == "table" else self.bayes

    @property
    def rules_differ(self) -> BoolArray:
        """(rows, columns): cells whose state by Table 3 is another than by (10)."""
        differ: BoolArray = cell_states(self.table.log_odds) != cell_states(self.bayes.log_odds)
        return differ

    def count_states(self) -> dict[str, int]:
        """The number of cells for each pair of states of the two grids, ``"occupied empty"`` where
        the first has an obstacle and the second has none; all nine, in the order of Table 3."""
        first, second = (cell_states(grid.log_odds) for grid in self.layers.values())
        counts = np.bincount((3 * first.astype(np.int64) + second).ravel(), minlength=9)
        by_priority = sorted(CellState, reverse=True)
        return {
            f"{a.name.lower()} {b.name.lower()}": int(counts[3 * a + b])
            for a in by_priority
            for b in by_priority
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class CellEvidence:
    """What two grids know of one cell, and what follows from it.

    ``centre_m``: (x, y) of the cell in the map frame. ``log_odds``: of each grid by name; NaN where
    unknown, also outside of the grid. ``table_log_odds``: of the grid that decides by Table 3.
    ``bayes_log_odds``: by (10).
    """

    centre_m: tuple[float, float]
    log_odds: Mapping[str, float]
    table_log_odds: float
    bayes_log_odds: float

    @property
    def states(self) -> dict[str, CellState]:
        """Of each grid by name."""
        return {name: _state(value) for name, value in self.log_odds.items()}

    @property
    def probabilities(self) -> dict[str, float]:
        """Of being occupied, by name; NaN where unknown."""
        return {name: _probability(value) for name, value in self.log_odds.items()}

    @property
    def table_state(self) -> CellState:
        """By Table 3."""
        return _state(self.table_log_odds)

    @property
    def bayes_state(self) -> CellState:
        """The more probable state by (10)."""
        return _state(self.bayes_log_odds)

    @property
    def bayes_probability(self) -> float:
        """Of being occupied by (10); NaN where unknown."""
        return _probability(self.bayes_log_odds)


def _state(log_odds: float) -> CellState:
    return CellState(int(cell_states(np.array(log_odds))))


def _probability(log_odds: float) -> float:
    return float(1.0 / (1.0 + np.exp(-log_odds)))
