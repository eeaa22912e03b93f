"""A log-odds grid that grows with the mapped area, used by final maps and submaps.

A cell's log odds l = log(p / (1 - p)) start at 0, and a hit or a pass adds a constant (Moravec &
Elfes 1985; Hess et al. 2016, eqs. 2 and 3, in odds).
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fusion_core.mapping.height_bands import BeamHeights
from fusion_core.mapping.rays import update_cells, update_cells_in_view
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray

# Padding on each side when a grid grows: at least so many cells, else the largest of these
# fractions of its side that fits ``cells_max``. Set by hand.
_PADDING_MIN, _PADDING_DIVISORS = 60, (4, 16, 64)


def log_odds(probability: float) -> float:
    """log(p / (1 - p)), for p in (0, 1)."""
    return float(np.log(probability / (1.0 - probability)))


class LogOddsUpdate(NamedTuple):
    """What a hit and a pass add to a cell, and the limits of its log odds."""

    hit: float
    miss: float
    lowest: float
    highest: float


class CellBounds(NamedTuple):
    """Whole cells, (column, row) from ``low`` (included) to ``high`` (not included), (2,) each."""

    low: IntArray
    high: IntArray

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        columns, rows = (self.high - self.low).tolist()
        return rows, columns

    @property
    def size(self) -> int:
        """Number of cells."""
        rows, columns = self.shape
        return rows * columns

    def union(self, other: "CellBounds") -> "CellBounds":
        """The smallest bounds that hold both."""
        return CellBounds(np.minimum(self.low, other.low), np.maximum(self.high, other.high))

    def padded(self, cells: "int | IntArray") -> "CellBounds":
        """Extended by a number of cells on each side."""
        return CellBounds(self.low - cells, self.high + cells)

    def holds(self, other: "CellBounds") -> bool:
        """Whether all of the other cells are among these."""
        return bool((other.low >= self.low).all() and (other.high <= self.high).all())

    def slices_in(self, other: "CellBounds") -> tuple[slice, slice]:
        """Rows and columns of these cells in an array that covers ``other``."""
        column, row = (self.low - other.low).tolist()
        rows, columns = self.shape
        return slice(row, row + rows), slice(column, column + columns)


class GrowingGrid:
    """A grid of log odds, NaN where unknown. Memory follows the area, not the number of scans.

    ``bounds``: of the arrays. ``reached``: of the cells that were reserved, None before the first.
    ``log_odds``: (rows, columns). ``border``: cells that are kept about those that were reserved.
    ``cells_max``: no padding is added beyond this number of cells. ``seen_m``: (rows, columns, 2)
    the heights at which something was seen in each cell, None before a scan with heights.
    """

    def __init__(
        self, update: LogOddsUpdate, *, border: int = 0, cells_max: float = np.inf
    ) -> None:
        self._update, self._border, self._cells_max = update, border, cells_max
        self.bounds = CellBounds(np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64))
        self.reached: CellBounds | None = None
        self.log_odds: FloatArray = np.empty((0, 0))
        self.updated_in_scan: npt.NDArray[np.int32] = np.empty((0, 0), dtype=np.int32)
        self.seen_m: FloatArray | None = None
        self.scans = 0

    def reserve(self, needed: CellBounds) -> bool:
        """Make the arrays cover these cells, too; True if they were replaced by larger ones."""
        before = self.reached
        if before is not None:
            needed = needed.union(before)
        self.reached = needed
        if before is not None and self.bounds.holds(needed.padded(self._border)):
            return False
        side = needed.high - needed.low
        wider = (needed.padded(np.maximum(_PADDING_MIN, side // d)) for d in _PADDING_DIVISORS)
        bounds = next((b for b in wider if b.size <= self._cells_max), needed)
        cells = np.full(bounds.shape, np.nan)
        updated_in_scan = np.zeros(bounds.shape, dtype=np.int32)
        if before is not None:
            new, old = before.slices_in(bounds), before.slices_in(self.bounds)
            cells[new] = self.log_odds[old]
            updated_in_scan[new] = self.updated_in_scan[old]
            if self.seen_m is not None:
                seen_m = np.full((*bounds.shape, 2), np.nan)
                seen_m[new] = self.seen_m[old]
                self.seen_m = seen_m
        self.bounds, self.log_odds, self.updated_in_scan = bounds, cells, updated_in_scan
        return True

    def add_scan(self, origin: FloatArray, ends: FloatArray, is_hit: BoolArray) -> None:
        """Update the cells along a scan's rays; all of them lie in what was reserved.

        ``origin``: (2,) and ``ends``: (n, 2) x, y in cell units. ``is_hit``: (n,), False where a
        ray ends without an obstacle.
        """
        self.scans += 1
        column, row = self.bounds.low.tolist()
        update_cells(
            self.log_odds,
            self.updated_in_scan,
            (row, column),
            self.scans,
            origin,
            ends,
            is_hit,
            self._update,
        )

    def add_scan_with_heights(
        self,
        origin: FloatArray,
        ends: FloatArray,
        is_hit: BoolArray,
        heights: BeamHeights,
        behind: FloatArray,
        behind_surfaces_m: FloatArray,
        resolution_m: float,
    ) -> None:
        """The same; a beam frees only cells in which nothing was seen beyond the heights that it
        looks at. ``heights``: of the n rays. ``behind``: (m, 2) further points, in cell units, and
        (m, 2) their heights."""
        if self.seen_m is None:
            self.seen_m = np.full((*self.bounds.shape, 2), np.nan)
        self.scans += 1
        column, row = self.bounds.low.tolist()
        update_cells_in_view(
            self.log_odds,
            self.updated_in_scan,
            self.seen_m,
            (row, column),
            self.scans,
            origin,
            ends,
            is_hit,
            self._update,
            heights.surfaces_m,
            heights.lower,
            heights.upper,
            behind,
            behind_surfaces_m,
            resolution_m,
        )

    def mark_undecided(self, points: FloatArray) -> None:
        """Cells of (n, 2) points x, y in cell units, all reserved, become 0 where unknown."""
        column, row = (np.floor(points).astype(np.int64) - self.bounds.low).T
        self.log_odds[row, column] = np.nan_to_num(self.log_odds[row, column], nan=0.0)
