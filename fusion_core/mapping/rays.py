"""Which cells a ray passes (Amanatides & Woo 1987), and one scan's update of the cells it meets.

Cell (row, column) covers ``column <= x < column + 1`` and ``row <= y < row + 1`` in cell units.
"""

import math

import numpy as np
import numpy.typing as npt

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray


@compiled()
def trace_ray(x0: float, y0: float, x1: float, y1: float, cells: IntArray) -> int:
    """Write the cells on the segment (x0, y0)-(x1, y1) to ``cells`` in order, return their count.

    All in cell units. ``cells``: (at least the count, 2) int64 rows and columns; the first holds
    the start, the last the end. A segment through a corner goes straight to the cell across it.
    Each crossing is computed from the segment itself and not by adding steps, so that rounding
    errors do not add up along a long ray.
    """
    column, row = math.floor(x0), math.floor(y0)
    column_end, row_end = math.floor(x1), math.floor(y1)
    column_step = 1 if column_end > column else -1
    row_step = 1 if row_end > row else -1
    dx, dy = x1 - x0, y1 - y0
    cells[0, 0], cells[0, 1] = row, column
    count = 1
    while column != column_end or row != row_end:
        t_column = math.inf
        if column != column_end:
            t_column = (column + (column_step > 0) - x0) / dx
        t_row = math.inf
        if row != row_end:
            t_row = (row + (row_step > 0) - y0) / dy
        if t_column <= t_row:
            column += column_step
        if t_row <= t_column:
            row += row_step
        cells[count, 0], cells[count, 1] = row, column
        count += 1
    return count


@compiled()
def _raised(log_odds: float, hit: float, highest: float) -> float:
    """Log odds after a hit; NaN is unknown, which begins at 0."""
    return min((0.0 if math.isnan(log_odds) else log_odds) + hit, highest)


@compiled()
def _lowered(log_odds: float, miss: float, lowest: float) -> float:
    """Log odds after a pass."""
    return max((0.0 if math.isnan(log_odds) else log_odds) + miss, lowest)


@compiled()
def _note_heights(seen_m: FloatArray, surface_m: FloatArray) -> None:
    """Widen (2,) lowest and highest seen, in place, by those of a surface, (2,)."""
    # A NaN compares false both ways.
    if not seen_m[0] <= surface_m[0]:
        seen_m[0] = surface_m[0]
    if not seen_m[1] >= surface_m[1]:
        seen_m[1] = surface_m[1]


@compiled()
def update_cells(
    log_odds: FloatArray,
    updated_in_scan: npt.NDArray[np.int32],
    first: tuple[int, int],
    scan: int,
    origin: FloatArray,
    ends: FloatArray,
    is_hit: BoolArray,
    update: tuple[float, float, float, float],
) -> None:
    """Update a map in place by the rays of one scan, each cell at most once.

    A cell in which a beam hit is occupied even where another beam of the scan passes it
    (the discretised insertion of OctoMap; Hornung 2013).

    ``log_odds``: (rows, columns), NaN unknown; its element (0, 0) is the cell ``first`` (row,
    column). ``updated_in_scan``: the same shape, the number of the scan that last changed a
    cell. ``origin``: (2,) and ``ends``: (N, 2) x, y in cell units, inside the map. ``is_hit``:
    (N,), False where the ray was cut short. The cell in which a ray ends is never freed by it.
    ``update``: what a hit and a pass add, and the lowest and highest log odds.
    """
    hit, miss, lowest, highest = update
    first_row, first_column = first
    for i in range(ends.shape[0]):
        column = math.floor(ends[i, 0]) - first_column
        row = math.floor(ends[i, 1]) - first_row
        if is_hit[i] and updated_in_scan[row, column] != scan:
            updated_in_scan[row, column] = scan
            log_odds[row, column] = _raised(log_odds[row, column], hit, highest)
    cells = np.empty((log_odds.shape[0] + log_odds.shape[1], 2), dtype=np.int64)
    for i in range(ends.shape[0]):
        count = trace_ray(origin[0], origin[1], ends[i, 0], ends[i, 1], cells)
        for k in range(count - 1):
            row, column = cells[k, 0] - first_row, cells[k, 1] - first_column
            if updated_in_scan[row, column] != scan:
                updated_in_scan[row, column] = scan
                log_odds[row, column] = _lowered(log_odds[row, column], miss, lowest)


@compiled()
def update_cells_in_view(
    log_odds: FloatArray,
    updated_in_scan: npt.NDArray[np.int32],
    seen_m: FloatArray,
    first: tuple[int, int],
    scan: int,
    origin: FloatArray,
    ends: FloatArray,
    is_hit: BoolArray,
    update: tuple[float, float, float, float],
    surfaces_m: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    behind: FloatArray,
    behind_surfaces_m: FloatArray,
    resolution_m: float,
) -> None:
    """``update_cells`` by beams that look at a band of heights: a cell in which something was seen
    is freed only by a beam that looks at one of the heights at which it was.

    ``seen_m``: (rows, columns, 2) the lowest and the highest point seen in each cell, NaN where
    none was; updated in place. ``surfaces_m``, ``lower``, ``upper``: those of ``BeamHeights``.
    ``behind``: (M, 2) further points hit, to which no ray frees anything, and (M, 2) their heights.
    """
    hit, miss, lowest, highest = update
    first_row, first_column = first
    for i in range(behind.shape[0]):
        column = math.floor(behind[i, 0]) - first_column
        row = math.floor(behind[i, 1]) - first_row
        if updated_in_scan[row, column] != scan:
            updated_in_scan[row, column] = scan
            log_odds[row, column] = _raised(log_odds[row, column], hit, highest)
        _note_heights(seen_m[row, column], behind_surfaces_m[i])
    for i in range(ends.shape[0]):
        column = math.floor(ends[i, 0]) - first_column
        row = math.floor(ends[i, 1]) - first_row
        if is_hit[i]:
            if updated_in_scan[row, column] != scan:
                updated_in_scan[row, column] = scan
                log_odds[row, column] = _raised(log_odds[row, column], hit, highest)
            _note_heights(seen_m[row, column], surfaces_m[i])
    cells = np.empty((log_odds.shape[0] + log_odds.shape[1], 2), dtype=np.int64)
    for i in range(ends.shape[0]):
        count = trace_ray(origin[0], origin[1], ends[i, 0], ends[i, 1], cells)
        for k in range(count - 1):
            row, column = cells[k, 0] - first_row, cells[k, 1] - first_column
            if updated_in_scan[row, column] == scan:
                continue
            away_m = resolution_m * math.hypot(
                cells[k, 1] + 0.5 - origin[0], cells[k, 0] + 0.5 - origin[1]
            )
            low_m = max(
                lower[i, 0, 0] + lower[i, 0, 1] * away_m, lower[i, 1, 0] + lower[i, 1, 1] * away_m
            )
            high_m = min(
                upper[i, 0, 0] + upper[i, 0, 1] * away_m, upper[i, 1, 0] + upper[i, 1, 1] * away_m
            )
            if seen_m[row, column, 1] < low_m or seen_m[row, column, 0] > high_m:
                continue
            updated_in_scan[row, column] = scan
            log_odds[row, column] = _lowered(log_odds[row, column], miss, lowest)
