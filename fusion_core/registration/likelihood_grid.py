"""A likelihood grid of a map of points, with upper bounds over blocks of cells.

A cell's value is the truncated log-likelihood of a point at its centre: 255 on a point of the map,
0 at ``truncation_m`` from all of them, a parabola in between (as in Olson 2009). Level h of the
pyramid holds, for each cell, the largest value of the 2ʰ x 2ʰ cells from there on (Hess et al.
2016, eq. 16-18).
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import ByteArray, FloatArray, read_only

CELL_VALUE_MAX = 255

# Set by hand: 400 MB, or 1 km² in cells of 5 cm, so that a stray coordinate cannot exhaust memory.
_CELLS_MAX = 400_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LikelihoodPyramid:
    """The values of a map's cells and their block maxima; one serves any number of matches.

    ``levels``: (L, rows, columns) uint8; row 0 is the smallest y, column 0 the smallest x.
    ``levels[h, r, c]`` is the maximum of ``levels[0, r : r + 2**h, c : c + 2**h]``, and 0
    outside of the grid. ``corner_m``: (x, y) of the outer corner of ``levels[0, 0, 0]``
    in the map's frame; level h starts 2**h - 1 cells before the map's own cells, so that every
    block that meets a cell has an entry. ``truncation_m``: distance at which the
    likelihood is truncated.
    """

    levels: ByteArray
    corner_m: tuple[float, float]
    resolution_m: float
    truncation_m: float

    def __post_init__(self) -> None:
        if self.levels.ndim != 3 or self.levels.dtype != np.uint8:
            raise ValueError(f"levels must be (L, rows, columns) uint8, got {self.levels.shape}")
        read_only(self.levels)


def make_likelihood_pyramid(
    points_m: FloatArray, *, resolution_m: float, truncation_m: float, levels: int
) -> LikelihoodPyramid:
    """The pyramid of a map given as points (n, 2) in its frame; NaN points are left out.

    ``levels``: at least 1; the blocks of the top are 2**(levels - 1) cells wide.
    Raises ValueError for no points at all and for a grid of more than 400 million bytes.
    """
    points_m = np.asarray(points_m, dtype=np.float64)
    if points_m.ndim != 2 or points_m.shape[1] != 2:
        raise ValueError(f"points_m must be (n, 2), got {points_m.shape}")
    if not (resolution_m > 0.0 and truncation_m > 0.0 and levels >= 1):
        raise ValueError(
            f"resolution, truncation and levels must be positive, got {resolution_m:g} m, "
            f"{truncation_m:g} m, {levels}"
        )
    given = points_m[np.isfinite(points_m).all(axis=1)]
    if given.size == 0:
        raise ValueError("a map needs at least one point")
    # Cells are aligned to the origin, so that equal points give equal cells.
    margin = int(np.ceil(truncation_m / resolution_m))
    before = 2 ** (levels - 1) - 1
    low = np.floor(given.min(axis=0) / resolution_m).astype(np.int64) - margin - before
    high = np.floor(given.max(axis=0) / resolution_m).astype(np.int64) + margin
    columns, rows = (int(size) for size in high - low + 1)
    if rows * columns * levels > _CELLS_MAX:
        raise ValueError(
            f"{rows} x {columns} cells of {resolution_m:g} m in {levels} levels are too many"
        )
    grids = np.zeros((levels, rows, columns), dtype=np.uint8)
    corner_m = low * resolution_m
    _rasterise_points(grids[0], given, corner_m[0], corner_m[1], resolution_m, truncation_m)
    for level in range(1, levels):
        _fill_block_maxima(grids[level - 1], grids[level], 2 ** (level - 1))
    return LikelihoodPyramid(
        levels=grids,
        corner_m=(float(corner_m[0]), float(corner_m[1])),
        resolution_m=resolution_m,
        truncation_m=truncation_m,
    )


@compiled(error_model="numpy")
def _rasterise_points(
    grid: ByteArray,
    points_m: FloatArray,
    left_m: float,
    bottom_m: float,
    resolution_m: float,
    truncation_m: float,
) -> None:
    """Raise the cells around each point to the value at their centre's distance from it."""
    margin = int(np.ceil(truncation_m / resolution_m))
    value_per_m2 = CELL_VALUE_MAX / (truncation_m * truncation_m)
    for k in range(points_m.shape[0]):
        x, y = points_m[k, 0] - left_m, points_m[k, 1] - bottom_m
        column, row = int(np.floor(x / resolution_m)), int(np.floor(y / resolution_m))
        for r in range(row - margin, row + margin + 1):
            dy = (r + 0.5) * resolution_m - y
            for c in range(column - margin, column + margin + 1):
                dx = (c + 0.5) * resolution_m - x
                value = int(CELL_VALUE_MAX - value_per_m2 * (dx * dx + dy * dy) + 0.5)
                if value > grid[r, c]:
                    grid[r, c] = value


@compiled()
def _fill_block_maxima(below: ByteArray, grid: ByteArray, half: int) -> None:
    """Each block is the maximum of the four blocks of half its width on the level below."""
    rows, columns = grid.shape
    for r in range(rows):
        other = min(r + half, rows - 1)
        for c in range(columns):
            grid[r, c] = max(below[r, c], below[other, c])
        # Rightward neighbours are not yet overwritten when the left one reads them.
        for c in range(columns - half):
            grid[r, c] = max(grid[r, c], grid[r, c + half])
