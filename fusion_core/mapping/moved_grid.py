"""A grid moved in its plane, on the raster that it had."""

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.planar_poses import invert_pose, transform_planar_points


def move_grid(grid: OccupancyGrid, pose_map_grid: FloatArray) -> OccupancyGrid:
    """A grid moved by (3,) x, y, yaw onto the raster that it had.

    Each cell takes the log-odds of the cell that comes to lie under its centre, so that evidence is
    neither blurred nor counted twice; what comes from outside is unknown.
    """
    rows, columns = grid.log_odds.shape
    low_m = np.array(grid.origin_m)
    high_m = low_m + grid.resolution_m * np.array([columns, rows])
    corners_m = np.array([[x, y] for x in (low_m[0], high_m[0]) for y in (low_m[1], high_m[1])])
    moved_m = transform_planar_points(pose_map_grid, corners_m)
    before = np.floor((moved_m.min(axis=0) - low_m) / grid.resolution_m).astype(np.int64)
    after = np.ceil((moved_m.max(axis=0) - low_m) / grid.resolution_m).astype(np.int64)
    size = after - before
    origin_m = low_m + before * grid.resolution_m
    pose_grid_map = invert_pose(pose_map_grid)
    log_odds = np.full((int(size[1]), int(size[0])), np.nan)
    x_m = origin_m[0] + (np.arange(size[0]) + 0.5) * grid.resolution_m
    # Row by row: coordinates of all cells would be several times the map.
    for i, row in enumerate(log_odds):
        y_m = origin_m[1] + (i + 0.5) * grid.resolution_m
        source_m = transform_planar_points(
            pose_grid_map, np.column_stack([x_m, np.full_like(x_m, y_m)])
        )
        column, line = np.floor((source_m - low_m) / grid.resolution_m).astype(np.int64).T
        inside = (line >= 0) & (line < rows) & (column >= 0) & (column < columns)
        row[inside] = grid.log_odds[line[inside], column[inside]]
    return OccupancyGrid(
        resolution_m=grid.resolution_m,
        origin_m=(float(origin_m[0]), float(origin_m[1])),
        log_odds=log_odds,
        frame_id=grid.frame_id,
    )
