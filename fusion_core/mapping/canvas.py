"""Aligned occupancy grids padded to one common extent."""

from collections.abc import Mapping

import numpy as np

from fusion_core.model.grids import OccupancyGrid

# In cells: rounding of an origin in a YAML file is far below, another raster far above.
_RASTER_TOLERANCE_CELLS = 1e-3


def pad_to_common_canvas(grids: Mapping[str, OccupancyGrid]) -> dict[str, OccupancyGrid]:
    """One or more grids padded with unknown cells to the shape and origin of their union.

    Raises ValueError where one has another resolution, frame or raster than the first.
    """
    first = next(iter(grids.values()))
    corners = []
    for name, grid in grids.items():
        if (grid.resolution_m, grid.frame_id) != (first.resolution_m, first.frame_id):
            raise ValueError(f"map {name!r} has another resolution or frame than the first")
        offset = (np.array(grid.origin_m) - first.origin_m)[::-1] / first.resolution_m
        corner = np.round(offset).astype(np.int64)
        if np.abs(offset - corner).max() > _RASTER_TOLERANCE_CELLS:
            raise ValueError(f"the cells of map {name!r} do not lie on those of the first")
        corners.append(corner)
    shapes = [grid.log_odds.shape for grid in grids.values()]
    lowest = np.min(corners, axis=0)
    highest = np.max(np.array(corners) + np.array(shapes), axis=0)
    origin_m = (
        first.origin_m[0] + float(lowest[1]) * first.resolution_m,
        first.origin_m[1] + float(lowest[0]) * first.resolution_m,
    )
    laid = {}
    for (name, grid), corner in zip(grids.items(), corners, strict=True):
        canvas = np.full(highest - lowest, np.nan)
        (row, column), (rows, columns) = corner - lowest, grid.log_odds.shape
        canvas[row : row + rows, column : column + columns] = grid.log_odds
        laid[name] = OccupancyGrid(
            resolution_m=first.resolution_m,
            origin_m=origin_m,
            log_odds=canvas,
            frame_id=first.frame_id,
        )
    return laid
