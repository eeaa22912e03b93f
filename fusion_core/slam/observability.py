"""Whether a match constrains a scan's pose in every direction of the plane."""

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.slam.scan_to_grid import ProbabilityGrid

# Poses at this distance from the match, in this number of directions, must score less than this
# fraction of it. Empirical: 0.3 m is beyond the blur of a wall in a submap of 5 cm cells.
_OFFSET_M, _DIRECTIONS, _SCORE_RATIO_MAX = 0.3, 16, 0.9


def is_well_constrained(grid: ProbabilityGrid, points_m: FloatArray, pose: FloatArray) -> bool:
    """Whether a scan fits worse at every pose nearby: along a bare corridor it does not.

    The scores themselves are compared, since the information matrix of a match is misleading here:
    the roughness of a wall gives it spurious information along the wall. ``points_m``: (n, 2).
    ``pose``: (3,) of the scan in the grid's frame.
    """
    score = _score(grid, points_m, pose)
    offsets = np.zeros((_DIRECTIONS, 3))
    angle = 2.0 * np.pi / _DIRECTIONS * np.arange(_DIRECTIONS)
    offsets[:, 0], offsets[:, 1] = _OFFSET_M * np.cos(angle), _OFFSET_M * np.sin(angle)
    best = max(_score(grid, points_m, pose + offset) for offset in offsets)
    return best < _SCORE_RATIO_MAX * score


def _score(grid: ProbabilityGrid, points_m: FloatArray, pose: FloatArray) -> int:
    """Sum of the cells at the points that lie on the grid."""
    cells = np.floor(
        (transform_planar_points(pose, points_m) - np.array(grid.corner_m)) / grid.resolution_m
    ).astype(np.int64)
    cells = cells[((cells >= 0) & (cells < grid.cells.shape[::-1])).all(axis=1)]
    return int(grid.cells[cells[:, 1], cells[:, 0]].astype(np.int64).sum())
