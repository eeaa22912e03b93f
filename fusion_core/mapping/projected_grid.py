"""A grid for navigation from an octree, by projection of a band of heights (Fu 2024 §3.1).

The rule is that of octomap_server, which the paper uses: a cell is occupied where an occupied leaf
that reaches into the band lies over it, free where only free ones do, and unknown where none does.
"""

import numpy as np

from fusion_core.mapping.octree_nodes import leaves_of
from fusion_core.model.conventions import FloatArray, Int32Array
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.octree import OccupancyOctree, OctreeLeaves
from fusion_core.settings import StageSettings, setting

OCCUPIED_ABOVE, FREE_BELOW = float(np.nextafter(0.5, 0.0)), 0.5
"""The probabilities that make a cell occupied or free: OctoMap's, from one half on and below."""

# Heights are compared in cells; a band's end on a border of cells does not reach beyond it.
_BORDER_TOLERANCE_CELLS = 1e-6


class ProjectedGridSettings(StageSettings):
    """Grid by projection of the octree."""

    height_min_m: float = setting(
        0.05, "Lower end of the band, above the floor", unit="m", ge=-100.0, le=100.0
    )
    height_max_m: float = setting(
        1.5, "Upper end of the band, above the floor", unit="m", ge=-100.0, le=100.0
    )
    cells_max: int = setting(64_000_000, "Largest grid", unit="cells", ge=1, le=64_000_000)


def project_octree(
    octree: OccupancyOctree, floor_height_m: float, settings: ProjectedGridSettings
) -> OccupancyGrid:
    """The band of heights above the floor, seen from above.

    ``floor_height_m``: z of the floor in the map. A cell's log odds are the greatest of the leaves
    over it within the band: at least 0 where one is occupied.

    Raises MappingFailed where no leaf reaches into the band, and for a grid larger than
    ``cells_max``.
    """
    leaves = _leaves_in_band(
        leaves_of(octree),
        floor_height_m + settings.height_min_m,
        floor_height_m + settings.height_max_m,
    )
    if not len(leaves):
        raise MappingFailed(
            f"no leaf of the octree lies {settings.height_min_m:g} to {settings.height_max_m:g} m "
            "above the floor.",
            advice="Set another projected_grid.height_min_m or height_max_m.",
        )
    low = leaves.corners[:, :2].min(axis=0)
    high = (leaves.corners[:, :2] + leaves.sides[:, np.newaxis]).max(axis=0)
    columns, rows = (high - low).tolist()
    if columns * rows > settings.cells_max:
        raise MappingFailed(
            f"the projected grid has {columns} x {rows} cells of {octree.resolution_m:g} m, more "
            f"than {settings.cells_max}.",
            advice="Check the poses, or choose a coarser octree.resolution_m.",
        )
    return OccupancyGrid(
        resolution_m=octree.resolution_m,
        origin_m=(float(low[0] * octree.resolution_m), float(low[1] * octree.resolution_m)),
        log_odds=_greatest_over_cells(leaves, low, (rows, columns)),
    )


def _leaves_in_band(leaves: OctreeLeaves, low_m: float, high_m: float) -> OctreeLeaves:
    """Those that overlap heights; touching is not overlapping."""
    bottom = leaves.corners[:, 2]
    low, high = low_m / leaves.resolution_m, high_m / leaves.resolution_m
    return leaves.select(
        (bottom + leaves.sides > low + _BORDER_TOLERANCE_CELLS)
        & (bottom < high - _BORDER_TOLERANCE_CELLS)
    )


def _greatest_over_cells(
    leaves: OctreeLeaves, low: Int32Array, shape: tuple[int, int]
) -> FloatArray:
    """(rows, columns) the greatest log odds of the leaves over each cell, NaN where none is."""
    greatest = np.full(shape, np.nan)
    for side in np.unique(leaves.sides).tolist():
        alike = leaves.select(leaves.sides == side)
        # Leaves of one size lie on one raster: that of cells as large as they.
        places = alike.corners[:, :2] // side
        first = places.min(axis=0)
        places -= first
        coarse = np.full(places.max(axis=0)[::-1] + 1, -np.inf)
        np.maximum.at(coarse, (places[:, 1], places[:, 0]), alike.log_odds.astype(np.float64))
        coarse[np.isneginf(coarse)] = np.nan
        fine = coarse.repeat(side, axis=0).repeat(side, axis=1)
        column, row = (first * side - low).tolist()
        below = greatest[row : row + fine.shape[0], column : column + fine.shape[1]]
        np.fmax(below, fine, out=below)
    return greatest
