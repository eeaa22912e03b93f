"""Where two or three maps of one place differ."""

from collections.abc import Mapping

import numpy as np

from fusion_core.model.grids import MapDifference, OccupancyGrid

# How far an origin may be from a whole cell before two maps have different rasters.
_RASTER_TOLERANCE_CELLS = 1e-3


def map_difference(
    grids: Mapping[str, OccupancyGrid], *, occupied_probability: float = 0.65
) -> MapDifference:
    """Compare maps, given by name, on the smallest canvas that covers all of them.

    A cell is occupied in a map where its probability exceeds ``occupied_probability``. Raises
    ValueError unless there are two or three maps in one frame, on one raster.
    """
    if len(grids) not in (2, 3):
        raise ValueError(f"two or three maps are compared, got {len(grids)}")
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
    lowest = np.min(corners, axis=0)
    highest = np.max(
        [
            corner + grid.log_odds.shape
            for corner, grid in zip(corners, grids.values(), strict=True)
        ],
        axis=0,
    )
    known = np.zeros(highest - lowest, dtype=np.bool_)
    occupied_in = np.zeros(highest - lowest, dtype=np.uint8)
    for i, (corner, grid) in enumerate(zip(corners, grids.values(), strict=True)):
        (row, column), (rows, columns) = corner - lowest, grid.log_odds.shape
        part = np.s_[row : row + rows, column : column + columns]
        known[part] |= grid.known
        occupied_in[part] |= (grid.probability > occupied_probability).astype(np.uint8) << i
    return MapDifference(
        names=tuple(grids),
        resolution_m=first.resolution_m,
        origin_m=(
            first.origin_m[0] + float(lowest[1]) * first.resolution_m,
            first.origin_m[1] + float(lowest[0]) * first.resolution_m,
        ),
        states=np.where(known, MapDifference.FREE + occupied_in, MapDifference.UNKNOWN).astype(
            np.uint8
        ),
    )
