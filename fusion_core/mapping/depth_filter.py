"""Which pixels of a depth image maps in space are built from: off depth edges, and within range."""

import numpy as np

from fusion_core.model.conventions import BoolArray, Float32Array
from fusion_core.settings import StageSettings, setting


class DepthFilterSettings(StageSettings):
    """Which depth the cloud, the surface and the octree are built from.

    The octree has a range of its own: depth beyond it still tells that the way there is free.
    """

    depth_min_m: float = setting(0.3, "Least depth", unit="m", ge=0.0, le=100.0)
    depth_max_m: float = setting(
        4.0,
        "Greatest depth of the cloud and the surface; its error grows with its square",
        unit="m",
        ge=0.1,
        le=1000.0,
    )
    edge_step: float = setting(
        0.03,
        "Neighbouring pixels of one surface differ by at most this fraction of their depth",
        ge=0.001,
        le=1.0,
    )
    edge_neighbours_min: int = setting(
        4,
        "A pixel with fewer such neighbours, of 8, lies between two surfaces (0: all remain)",
        ge=0,
        le=8,
    )


def depth_off_edges(depth_m: Float32Array, settings: DepthFilterSettings) -> Float32Array:
    """(H, W) depth with NaN where it is too small or hangs between two surfaces.

    A camera gives a pixel on an outline a depth between those of the surfaces on both sides (a
    mixed or flying pixel). Such a pixel has few neighbours of its own depth; one on a surface has
    five of eight at a straight edge and three at a convex corner.
    """
    is_usable = (depth_m >= settings.depth_min_m) & np.isfinite(depth_m)
    usable: Float32Array = np.where(is_usable, depth_m, np.float32(np.nan)).astype(np.float32)
    if settings.edge_neighbours_min == 0:
        return usable
    step = np.float32(settings.edge_step)
    height, width = usable.shape
    support = np.zeros((height, width), dtype=np.uint8)
    # Half of the directions: the relation is symmetric.
    for down, right in ((0, 1), (1, -1), (1, 0), (1, 1)):
        here = (slice(0, height - down), slice(max(0, -right), width - max(0, right)))
        there = (slice(down, height), slice(max(0, right), width - max(0, -right)))
        alike: BoolArray = np.abs(usable[here] - usable[there]) <= step * np.minimum(
            usable[here], usable[there]
        )
        support[here] += alike
        support[there] += alike
    usable[support < settings.edge_neighbours_min] = np.nan
    return usable


def depth_within_range(depth_m: Float32Array, settings: DepthFilterSettings) -> Float32Array:
    """(H, W) depth with NaN where it is greater than ``depth_max_m``."""
    within: Float32Array = np.where(depth_m <= settings.depth_max_m, depth_m, np.float32(np.nan))
    return within
