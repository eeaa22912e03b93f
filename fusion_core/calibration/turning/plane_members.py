"""Which points of a cloud lie on which plane, without those that something else may own.

Where a table stands on a floor, or two walls meet, points within the tolerance of a plane belong to
something else, all on one side of it: they would pull it there. A cell of a plane is therefore used
only where nearly all that is close to it is on it.
"""

import numpy as np

from fusion_core.calibration.turning.planes import Plane
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray

_CELL_M = 0.15
# In multiples of the tolerance: how close another surface must be to cast doubt on a cell.
_CLOSE = 3.0
_PURITY_MIN = 0.95
_CELL_POINTS_MIN = 4


def assign_planes(points_m: FloatArray, planes: tuple[Plane, ...], tolerance_m: float) -> IntArray:
    """(N,) index of each point's plane, -1 for none: within the tolerance of that plane alone, in
    a cell of it where nothing else is close."""
    normals = np.stack([plane.normal for plane in planes])
    offsets = np.array([plane.offset_m for plane in planes])
    distances = np.abs(points_m @ normals.T - offsets)
    close = distances < _CLOSE * tolerance_m
    nearest = distances.argmin(axis=1)
    alone = close.sum(axis=1) == 1
    plane_of = np.full(len(points_m), -1, dtype=np.int64)
    for index, plane in enumerate(planes):
        candidates = np.flatnonzero(close[:, index])
        if candidates.size == 0:
            continue
        on_plane = (distances[candidates, index] < tolerance_m) & (nearest[candidates] == index)
        on_plane &= alone[candidates]
        pure = _in_pure_cell(points_m[candidates], plane.normal, on_plane)
        plane_of[candidates[on_plane & pure]] = index
    return plane_of


def _in_pure_cell(points_m: FloatArray, normal: FloatArray, on_plane: BoolArray) -> BoolArray:
    """(M,) whether nearly all points of a point's cell are on the plane."""
    least = np.eye(3)[np.abs(normal).argmin()]
    first = np.cross(normal, least)
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first)], axis=1)
    cells = np.floor(points_m @ axes / _CELL_M).astype(np.int64)
    cells -= cells.min(axis=0)
    key = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
    _, cell = np.unique(key, return_inverse=True)
    total = np.bincount(cell)
    on = np.bincount(cell, on_plane, minlength=total.size)
    pure = (on >= _PURITY_MIN * total) & (on >= _CELL_POINTS_MIN)
    result: BoolArray = pure[cell]
    return result
