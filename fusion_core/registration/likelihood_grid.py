"""How well points fit a map, cell by cell, with upper bounds over blocks of cells.

A cell's value is the log-likelihood of a point in its middle, truncated so that a point without a
counterpart costs a fixed amount: 255 at a point of the map, 0 at ``reach_m`` from all of them,
a parabola in between (Olson 2009 rasterises the same way). Level h of the pyramid holds, for each
cell, the largest value of the 2ʰ x 2ʰ cells from there on (Hess et al. 2016, eq. 16-18).
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import ByteArray, FloatArray, read_only

FULL = 255

# A grid much larger than this is a wrong coordinate, not a map.
_CELLS_MAX = 400_000_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LikelihoodPyramid:
    """The values of a map's cells and their block maxima; one serves any number of matches.

    ``levels``: (L, rows, columns) uint8; row 0 is the smallest y, column 0 the smallest x.
    ``levels[h, r, c]`` is the maximum of ``levels[0, r : r + 2**h, c : c + 2**h]``, what is
    outside of the grid being 0. ``corner_m``: (x, y) of the outer corner of ``levels[0, 0, 0]``
    in the map's frame; level h starts 2**h - 1 cells before the map's own cells, so that every
    block that meets a cell has an entry. ``reach_m``: where the likelihood ends.
    """

    levels: ByteArray
    corner_m: tuple[float, float]
    resolution_m: float
    reach_m: float

    def __post_init__(self) -> None:
        if self.levels.ndim != 3 or self.levels.dtype != np.uint8:
            raise ValueError(f"levels must be (L, rows, columns) uint8, got {self.levels.shape}")
        read_only(self.levels)


def likelihood_pyramid(
    points_m: FloatArray, *, resolution_m: float, reach_m: float, levels: int
) -> LikelihoodPyramid:
    """The pyramid of a map given as points (n, 2) in its frame; NaN points are left out.

    ``levels``: at least 1; the blocks of the top are 2**(levels - 1) cells wide.
    Raises ValueError for no points at all and for a grid of more than 400 million bytes.
    """
    points_m = np.asarray(points_m, dtype=np.float64)
    if points_m.ndim != 2 or points_m.shape[1] != 2:
        raise ValueError(f"points_m must be (n, 2), got {points_m.shape}")
    if not (resolution_m > 0.0 and reach_m > 0.0 and levels >= 1):
        raise ValueError(
            f"resolution, reach and levels must be positive, got {resolution_m:g} m, "
            f"{reach_m:g} m, {levels}"
        )
    given = points_m[np.isfinite(points_m).all(axis=1)]
    if given.size == 0:
        raise ValueError("a map needs at least one point")
    # Whole cells of a lattice through the origin, so that equal points give equal cells.
    margin = int(np.ceil(reach_m / resolution_m))
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
    _draw(grids[0], given, corner_m[0], corner_m[1], resolution_m, reach_m)
    for level in range(1, levels):
        _block_maxima(grids[level - 1], grids[level], 2 ** (level - 1))
    return LikelihoodPyramid(
        levels=grids,
        corner_m=(float(corner_m[0]), float(corner_m[1])),
        resolution_m=resolution_m,
        reach_m=reach_m,
    )


@compiled(error_model="numpy")
def _draw(
    grid: ByteArray,
    points_m: FloatArray,
    left_m: float,
    bottom_m: float,
    resolution_m: float,
    reach_m: float,
) -> None:
    """Raise the cells about each point to the value of their own middle's distance."""
    margin = int(np.ceil(reach_m / resolution_m))
    falling = FULL / (reach_m * reach_m)
    for k in range(points_m.shape[0]):
        x, y = points_m[k, 0] - left_m, points_m[k, 1] - bottom_m
        column, row = int(np.floor(x / resolution_m)), int(np.floor(y / resolution_m))
        for r in range(row - margin, row + margin + 1):
            dy = (r + 0.5) * resolution_m - y
            for c in range(column - margin, column + margin + 1):
                dx = (c + 0.5) * resolution_m - x
                value = int(FULL - falling * (dx * dx + dy * dy) + 0.5)
                if value > grid[r, c]:
                    grid[r, c] = value


@compiled()
def _block_maxima(below: ByteArray, grid: ByteArray, half: int) -> None:
    """A block of 2 half cells is four blocks of half as many."""
    rows, columns = grid.shape
    for r in range(rows):
        other = min(r + half, rows - 1)
        for c in range(columns):
            grid[r, c] = max(below[r, c], below[other, c])
        # Rightward neighbours are not yet overwritten when the left one reads them.
        for c in range(columns - half):
            grid[r, c] = max(grid[r, c], grid[r, c + half])
