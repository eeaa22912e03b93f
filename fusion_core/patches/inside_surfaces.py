"""Which patches of depth images lie inside a surface, so that nothing beside it bends them."""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.patches.depth_patches import DepthPatches

# The noise of depths is learned in bins of so many patches, from the quantile that is surely of
# clean planes; those count that spread up to so many times as much.
_PER_BIN = 500
_CLEAN = 0.3
_NOISE_FACTOR = 1.25
# Patches of one surface: cosine between their normals, and a step between them besides the noise.
_SAME_NORMAL = float(np.cos(np.deg2rad(10.0)))
_STEP_M = 0.005
# A hole or the image's border may stand for one of the four neighbours.
_LEAST_NEIGHBOURS = 3


def find_inside(images: Sequence[DepthPatches]) -> list[BoolArray]:
    """(N,) for each of some images of one camera, or of cameras alike: the noise is theirs."""
    sizes = [patches.pixel.size for patches in images]
    flat = is_flat(
        np.concatenate([patches.points_m[:, 2] for patches in images]),
        np.concatenate([patches.spread_m for patches in images]),
    )
    each = np.split(flat, np.cumsum(sizes)[:-1])
    return [is_interior(patches, own) for patches, own in zip(images, each, strict=True)]


def is_flat(depth_m: FloatArray, spread_m: FloatArray) -> BoolArray:
    """(N,) whether the pixels of patches spread no more than the depth's noise.

    At each depth the lower part of the patches is on clean planes, and shows the noise. What
    spreads more holds the edge of something, such as the foot of a wall, always on one side.
    """
    flat = np.zeros(depth_m.size, dtype=bool)
    order = np.argsort(depth_m, kind="stable")
    for part in np.array_split(order, max(1, depth_m.size // _PER_BIN)):
        if part.size:
            flat[part] = spread_m[part] <= _NOISE_FACTOR * np.quantile(spread_m[part], _CLEAN)
    return flat


def is_interior(patches: DepthPatches, flat: BoolArray) -> BoolArray:
    """(N,) whether a flat patch is inside a surface: those above, below and on both sides go
    on with it. At an edge the pixels beyond it bend a patch, always to the same side."""
    rows, columns = patches.cell.max(axis=0, initial=0) + 3
    number = np.full((rows, columns), -1)
    row, column = patches.cell.T + 1
    own = np.arange(flat.size)
    number[row, column] = own
    going_on = np.zeros(own.size, dtype=np.int64)
    ending = np.zeros(own.size, dtype=bool)
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        other = number[row + down, column + right]
        apart = patches.points_m[other] - patches.points_m[own]
        off = np.abs((patches.normals[own] * apart).sum(axis=1))
        turn = (patches.normals[own] * patches.normals[other]).sum(axis=1)
        is_same = (turn > _SAME_NORMAL) & (off < patches.spread_m[own] + _STEP_M)
        ending |= (other >= 0) & ~is_same
        going_on += (other >= 0) & is_same
    interior: BoolArray = flat & ~ending & (going_on >= _LEAST_NEIGHBOURS)
    return interior
