"""The maps of all particles, in tiles that are shared until one is changed (copy on write).

A particle's map is a table of tile numbers; the tiles lie in one pool. Particles that resampling
has made of one parent refer to the same tiles, and a tile is copied when one of them changes it.
So memory follows the mapped area times how much the particles differ, not time.

A cell is one byte: 0 unknown, else its log odds in integer steps, 128 being even odds.
``OCCUPANCY`` gives the probability as ``scan_to_grid`` takes it. (``mapping.growing_grid`` has the
same rule in floats and without sharing, at thirteen times the memory.)
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fusion_core.compiled import compiled
from fusion_core.mapping.growing_grid import log_odds
from fusion_core.mapping.rays import trace_ray
from fusion_core.model.conventions import ByteArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import MappingFailed
from fusion_core.slam.submaps import SubmapSettings

# Cells on a side, set by hand: a tile is 4 kB, cheap to copy, and tables stay short.
TILE = 64
# 1 GB, set by hand for a small computer.
_TILES_MAX = 2**30 // TILE**2
# The encoding of a cell in a byte.
UNKNOWN, _LOWEST, _EVEN_ODDS, _HIGHEST = 0, 1, 128, 255
# The log odds of one step: the highest byte is the highest probability of a submap. A hit and a
# pass are those of a submap, rounded to whole steps.
_DEFAULTS = SubmapSettings()
_STEP = log_odds(_DEFAULTS.p_limit) / (_HIGHEST - _EVEN_ODDS)
_HIT, _MISS = (round(log_odds(p) / _STEP) for p in (_DEFAULTS.p_hit, _DEFAULTS.p_miss))

Int32Array = npt.NDArray[np.int32]


def _occupancy_table() -> ByteArray:
    odds = np.exp(_STEP * (np.arange(256) - _EVEN_ODDS))
    table: ByteArray = np.round(255.0 * odds / (1.0 + odds)).astype(np.uint8)
    table[UNKNOWN] = 0
    read_only(table)
    return table


OCCUPANCY: ByteArray = _occupancy_table()
"""(256,) cell to probability, 255 for a sure obstacle; unknown is 0, as it attracts no point."""


@dataclass(frozen=True, slots=True, eq=False)
class MapWindow:
    """Whole tiles of one particle's map, copied side by side.

    ``cells``: (rows, columns) bytes, writable until they are written back. ``occupancy``: the
    same, as probabilities. ``first_row``, ``first_column``: the cell of element (0, 0), multiples
    of ``TILE``.
    """

    cells: ByteArray
    occupancy: ByteArray
    first_row: int
    first_column: int


class ParticleMaps:
    """P maps, all unknown at first."""

    def __init__(self, particles: int) -> None:
        self._tables: Int32Array = np.full((particles, 1, 1), -1, dtype=np.int32)
        self._first_row, self._first_column = 0, 0  # in tiles
        self._pool: ByteArray = np.zeros((16, TILE, TILE), dtype=np.uint8)
        self._reference_counts: IntArray = np.zeros(16, dtype=np.int64)
        self._free: list[int] = list(range(15, -1, -1))

    @property
    def tiles(self) -> int:
        """Tiles in use by at least one particle."""
        return len(self._pool) - len(self._free)

    @property
    def capacity(self) -> int:
        """Tiles that the pool has memory for."""
        return len(self._pool)

    def window(self, particle: int, low: tuple[int, int], high: tuple[int, int]) -> MapWindow:
        """The tiles that hold the cells from ``low`` to ``high`` (row, column; both included)."""
        row, column = low[0] // TILE, low[1] // TILE
        rows, columns = high[0] // TILE + 1 - row, high[1] // TILE + 1 - column
        cells = np.empty((rows * TILE, columns * TILE), dtype=np.uint8)
        occupancy = np.empty_like(cells)
        _gather_tiles(
            self._pool,
            self._tables[particle],
            row - self._first_row,
            column - self._first_column,
            OCCUPANCY,
            cells,
            occupancy,
        )
        return MapWindow(cells, occupancy, row * TILE, column * TILE)

    def write(self, particle: int, window: MapWindow) -> None:
        """Make a window the particle's own map; tiles that are as before stay shared."""
        row, column = window.first_row // TILE, window.first_column // TILE
        rows, columns = (size // TILE for size in window.cells.shape)
        self._make_room(row, column, row + rows, column + columns)
        table = self._tables[particle]
        at = (row - self._first_row, column - self._first_column)
        changed = np.empty((rows * columns, 2), dtype=np.int64)
        count = _changed_tiles(self._pool, table, *at, window.cells, changed)
        for r, c in changed[:count]:
            place = (at[0] + r, at[1] + c)
            number = table[place]
            if number < 0 or self._reference_counts[number] > 1:
                own = self._allocate_tile()
                if number >= 0:
                    self._reference_counts[number] -= 1
                self._reference_counts[own] = 1
                table[place] = number = own
            self._pool[number] = window.cells[r * TILE : (r + 1) * TILE, c * TILE : (c + 1) * TILE]

    def resample(self, parents: IntArray) -> None:
        """Particle i becomes a copy of particle ``parents[i]``; no tile is copied."""
        self._tables = self._tables[parents]
        used = self._tables[self._tables >= 0]
        self._reference_counts = np.bincount(used, minlength=len(self._pool))
        self._free = [int(number) for number in np.flatnonzero(self._reference_counts == 0)[::-1]]

    def _allocate_tile(self) -> int:
        if not self._free:
            size = len(self._pool)
            if size >= _TILES_MAX:
                raise MappingFailed(
                    f"the maps of {len(self._tables)} particles take more than 1 GB.",
                    advice="Set fewer particles.particles, or a coarser particles.resolution_m.",
                )
            # By a half, so that copying the pool stays a small part of the work.
            more = min(max(size // 2, 16), _TILES_MAX - size)
            self._pool = np.concatenate([self._pool, np.zeros((more, TILE, TILE), dtype=np.uint8)])
            self._reference_counts = np.concatenate(
                [self._reference_counts, np.zeros(more, dtype=np.int64)]
            )
            self._free = list(range(size + more - 1, size - 1, -1))
        return self._free.pop()

    def _make_room(self, row: int, column: int, row_end: int, column_end: int) -> None:
        """Widen the tables to hold the tiles from (row, column) to (row_end, column_end)."""
        particles, rows, columns = self._tables.shape
        first_row, first_column = min(row, self._first_row), min(column, self._first_column)
        rows_end = max(row_end, self._first_row + rows)
        columns_end = max(column_end, self._first_column + columns)
        shape = (rows_end - first_row, columns_end - first_column)
        if shape == (rows, columns):
            return
        tables = np.full((particles, *shape), -1, dtype=np.int32)
        r, c = self._first_row - first_row, self._first_column - first_column
        tables[:, r : r + rows, c : c + columns] = self._tables
        self._tables = tables
        self._first_row, self._first_column = first_row, first_column


@compiled()
def _gather_tiles(
    pool: ByteArray,
    table: Int32Array,
    first_row: int,
    first_column: int,
    values: ByteArray,
    cells: ByteArray,
    occupancy: ByteArray,
) -> None:
    """Fill ``cells`` from the tiles beginning at (first_row, first_column) of the table.

    ``values``: (256,) what a cell is in ``occupancy``; of an unknown one that is 0.
    """
    for i in range(cells.shape[0] // TILE):
        for j in range(cells.shape[1] // TILE):
            r, c = first_row + i, first_column + j
            number = -1
            if 0 <= r < table.shape[0] and 0 <= c < table.shape[1]:
                number = table[r, c]
            for k in range(TILE):
                row = i * TILE + k
                for m in range(TILE):
                    column = j * TILE + m
                    cell = pool[number, k, m] if number >= 0 else UNKNOWN
                    cells[row, column] = cell
                    occupancy[row, column] = values[cell]


@compiled()
def _changed_tiles(
    pool: ByteArray,
    table: Int32Array,
    first_row: int,
    first_column: int,
    cells: ByteArray,
    changed: IntArray,
) -> int:
    """Count of the window's tiles (row, column) that differ from the map, listed in ``changed``."""
    rows, columns = cells.shape[0] // TILE, cells.shape[1] // TILE
    count = 0
    for i in range(rows):
        for j in range(columns):
            number = table[first_row + i, first_column + j]
            differs = False
            for r in range(TILE):
                for c in range(TILE):
                    before = pool[number, r, c] if number >= 0 else UNKNOWN
                    if cells[i * TILE + r, j * TILE + c] != before:
                        differs = True
                        break
                if differs:
                    break
            if differs:
                changed[count, 0], changed[count, 1] = i, j
                count += 1
    return count


def add_scan(cells: ByteArray, origin: FloatArray, hits: FloatArray, ends: FloatArray) -> None:
    """Add a scan to a window: occupied at ``hits``, free on the rays to ``ends``.

    Each cell changes at most once, and a hit has precedence. ``origin``: (2,), ``hits``: (h, 2),
    ``ends``: (n, 2) x, y in cells from the window's corner, all inside of it. A ray does not free
    the cell in which it ends.
    """
    _add_scan(cells, origin, hits, ends, _HIT, _MISS)


@compiled()
def _add_scan(
    cells: ByteArray,
    origin: FloatArray,
    hits: FloatArray,
    ends: FloatArray,
    hit: int,
    miss: int,
) -> None:
    """``add_scan`` with the steps of a hit and of a pass."""
    is_done = np.zeros(cells.shape, dtype=np.bool_)
    for i in range(hits.shape[0]):
        row, column = int(np.floor(hits[i, 1])), int(np.floor(hits[i, 0]))
        if not is_done[row, column]:
            is_done[row, column] = True
            cells[row, column] = _updated_cell(cells[row, column], hit)
    ray = np.empty((cells.shape[0] + cells.shape[1], 2), dtype=np.int64)
    for i in range(ends.shape[0]):
        count = trace_ray(origin[0], origin[1], ends[i, 0], ends[i, 1], ray)
        for k in range(count - 1):
            row, column = ray[k, 0], ray[k, 1]
            if not is_done[row, column]:
                is_done[row, column] = True
                cells[row, column] = _updated_cell(cells[row, column], miss)


@compiled()
def _updated_cell(cell: int, steps: int) -> int:
    before = _EVEN_ODDS if cell == UNKNOWN else int(cell)
    return min(max(before + steps, _LOWEST), _HIGHEST)
