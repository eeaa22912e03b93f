"""Which points of a cloud a camera sees: one behind a nearer surface is hidden by it."""

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray

# The four pairs of opposite neighbours of a cell.
_OPPOSITE = ((0, 1), (1, 0), (1, 1), (1, -1))


def visible_points(
    pixels: FloatArray, depth_m: FloatArray, *, cell_px: float, tolerance: float
) -> BoolArray:
    """(N,) whether each point is seen past the others.

    ``pixels``: (N, 2), finite. ``depth_m``: (N,) along the view. The image is cut into cells of
    ``cell_px``, wider than the gaps between neighbouring points, and each keeps its nearest depth
    (a z-buffer). A cell lies behind a surface where its own points do, or those of two opposite
    neighbours: with one neighbour alone, the ground would hide what lies farther on it. Points
    deeper than the surface by more than the ``tolerance`` (relative) are hidden.
    """
    if pixels.shape[0] == 0:
        return np.zeros(0, dtype=np.bool_)
    cells = np.floor(pixels / cell_px).astype(np.int64)
    cells -= cells.min(axis=0) - 1
    columns, rows = cells.max(axis=0) + 2
    nearest_m = np.full((rows, columns), np.inf)
    np.minimum.at(nearest_m, (cells[:, 1], cells[:, 0]), depth_m)
    surface_m = nearest_m.copy()
    for step in _OPPOSITE:
        before = np.roll(nearest_m, step, axis=(0, 1))
        after = np.roll(nearest_m, (-step[0], -step[1]), axis=(0, 1))
        np.minimum(surface_m, np.maximum(before, after), out=surface_m)
    seen: BoolArray = depth_m <= surface_m[cells[:, 1], cells[:, 0]] * (1.0 + tolerance)
    return seen
