"""Radius outlier filter of point clouds (Li 2022 §2.2, step 5; Song 2022 §2.2.1)."""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray

# Three cell indices of 21 bits fit the key, an int64.
_INDEX_BITS = 21
_INDEX_MAX = (1 << _INDEX_BITS) - 2


def has_neighbours(
    points_m: FloatArray, cloud_m: FloatArray, radius_m: float, neighbours_min: int
) -> BoolArray:
    """(N,) which of (N, 3) points have at least ``neighbours_min`` others within ``radius_m``.

    ``cloud_m``: (M, 3) the cloud of possible neighbours, which contains the points themselves; a
    point is not its own neighbour. The same array as ``points_m`` is sorted once.

    Raises ValueError for points that are not finite or lie too far apart for the radius.
    """
    if neighbours_min == 0 or not len(points_m):
        return np.ones(len(points_m), dtype=np.bool_)
    lowest_m = cloud_m.min(axis=0)
    spread = (cloud_m.max(axis=0) - lowest_m).max() / radius_m
    if not spread < _INDEX_MAX:
        raise ValueError("points must be finite and within two million radii of each other")
    # Cells as wide as the radius: all neighbours lie in the 27 around. Index 0 stays empty.
    key = _cell_keys(cloud_m, lowest_m, radius_m)
    order = np.argsort(key, kind="stable")
    key, in_order_m = key[order], cloud_m[order]
    # In the order of the cells, what one point looks at the next one finds in the cache.
    asked, asked_m = order, in_order_m
    if points_m is not cloud_m:
        asked = np.argsort(_cell_keys(points_m, lowest_m, radius_m), kind="stable")
        asked_m = points_m[asked]
    found = np.empty(len(points_m), dtype=np.bool_)
    found[asked] = _has_neighbours(asked_m, in_order_m, key, lowest_m, radius_m, neighbours_min)
    return found


def _cell_keys(points_m: FloatArray, lowest_m: FloatArray, radius_m: float) -> IntArray:
    cell = np.floor((points_m - lowest_m) / radius_m).astype(np.int64) + 1
    return (cell[:, 2] << 2 * _INDEX_BITS) | (cell[:, 1] << _INDEX_BITS) | cell[:, 0]


@compiled(nogil=True, error_model="numpy")
def _has_neighbours(
    points_m: FloatArray,
    cloud_m: FloatArray,
    keys: IntArray,
    lowest_m: FloatArray,
    radius_m: float,
    neighbours_min: int,
) -> BoolArray:
    found = np.zeros(points_m.shape[0], dtype=np.bool_)
    squared_m2 = radius_m * radius_m
    for i in range(points_m.shape[0]):
        x, y, z = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        column = int(np.floor((x - lowest_m[0]) / radius_m)) + 1
        row = int(np.floor((y - lowest_m[1]) / radius_m)) + 1
        layer = int(np.floor((z - lowest_m[2]) / radius_m)) + 1
        # One more, since the point itself is in the cloud.
        missing = neighbours_min + 1
        for turn in range(9):
            # The point's own row first: in a dense cloud it suffices.
            beside = (turn + 4) % 9
            base = ((layer + beside // 3 - 1) << 2 * _INDEX_BITS) | (
                (row + beside % 3 - 1) << _INDEX_BITS
            )
            # Three cells of a row follow each other.
            place = np.searchsorted(keys, base | (column - 1))
            while missing > 0 and place < keys.size and keys[place] <= (base | (column + 1)):
                dx = cloud_m[place, 0] - x
                dy = cloud_m[place, 1] - y
                dz = cloud_m[place, 2] - z
                if dx * dx + dy * dy + dz * dz <= squared_m2:
                    missing -= 1
                place += 1
            if missing == 0:
                found[i] = True
                break
    return found
