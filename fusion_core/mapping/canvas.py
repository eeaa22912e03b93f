"""Grids of one place on one raster, each cut or padded to the canvas that covers all of them."""

from collections.abc import Mapping

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.grids import OccupancyGrid

# How far an origin may be from a whole cell before two maps have different rasters.
_RASTER_TOLERANCE_CELLS = 1e-3


def pad_to_common_canvas(grids: Mapping[str, OccupancyGrid]) -> dict[str, OccupancyGrid]:
    """The grids, of at least one name, with unknown cells around them, so that all have the shape
    and origin of the smallest canvas.

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


def merge_keeping_obstacles(plane: OccupancyGrid, heights: OccupancyGrid) -> OccupancyGrid:
    """Where either grid has rather an obstacle, the surer of it; elsewhere the surer to be free. A
    cell that one grid does not know is the other's.

    A beam that passes over a low box says nothing of it. Where a grid of the LiDAR's plane and one
    of all heights differ, neither is wrong, and a robot runs into what either of them shows.
    Raises ValueError as ``on_one_canvas`` does.
    """
    laid = pad_to_common_canvas({"plane": plane, "heights": heights})
    both = laid["plane"].log_odds, laid["heights"].log_odds
    highest: FloatArray = np.fmax(*both)
    # NaN compares false, and stays.
    return OccupancyGrid(
        resolution_m=plane.resolution_m,
        origin_m=laid["plane"].origin_m,
        log_odds=np.where(highest > 0.0, highest, np.fmin(*both)),
        frame_id=plane.frame_id,
    )
