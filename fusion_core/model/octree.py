"""Occupancy in space as an octree: OctoMap's nodes, and its leaves as arrays."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fusion_core.model.conventions import (
    BoolArray,
    Float32Array,
    FloatArray,
    Int32Array,
    read_only,
)

NODE_TYPE = np.dtype([("log_odds", "<f4"), ("children", "u1")])
"""A node as an .ot file has it: its log odds, and a bit for each of its children (bit 0 of a
child's number: the greater x, bit 1: y, bit 2: z)."""

TREE_DEPTH = 16
"""The root's side is 2^16 of the finest cells; its centre is the map's origin."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OccupancyOctree:
    """An octree of occupancy.

    ``resolution_m``: side of the finest cell. ``nodes``: (N,) of ``NODE_TYPE``, depth first, the
    root first and children in the order of their bits. A place under no leaf is unknown. A node
    without children is a leaf: all that it covers has its log odds; a node with children has the
    greatest log odds among them.
    """

    resolution_m: float
    nodes: NDArray[np.void]

    def __post_init__(self) -> None:
        if not self.resolution_m > 0.0:
            raise ValueError(f"resolution_m must be positive, got {self.resolution_m}")
        if self.nodes.ndim != 1 or self.nodes.dtype != NODE_TYPE:
            raise ValueError(f"nodes must be (N,) of {NODE_TYPE}, got {self.nodes.dtype}")
        read_only(self.nodes)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OctreeLeaves:
    """The leaves of an octree as boxes.

    ``corners``: (N, 3) int32 the finest cell at each box's lowest corner; cell (0, 0, 0) begins at
    the map's origin. ``sides``: (N,) int32 sides in finest cells, powers of two. ``log_odds``:
    (N,) float32.
    """

    # OctoMap's: a probability of one half counts as occupied.
    OCCUPIED_LOG_ODDS: ClassVar[float] = 0.0

    resolution_m: float
    corners: Int32Array
    sides: Int32Array
    log_odds: Float32Array

    def __post_init__(self) -> None:
        count = len(self.corners)
        if self.corners.shape != (count, 3) or not (
            self.sides.shape == self.log_odds.shape == (count,)
        ):
            raise ValueError(
                f"(N, 3) corners with (N,) sides and log odds, got {self.corners.shape}, "
                f"{self.sides.shape}, {self.log_odds.shape}"
            )
        for array in (self.corners, self.sides, self.log_odds):
            read_only(array)

    def __len__(self) -> int:
        return len(self.sides)

    @property
    def centres_in_map_m(self) -> FloatArray:
        """(N, 3)"""
        centres: FloatArray = self.corners + 0.5 * self.sides[:, np.newaxis].astype(np.float64)
        return self.resolution_m * centres

    @property
    def sides_m(self) -> FloatArray:
        """(N,)"""
        return self.resolution_m * self.sides.astype(np.float64)

    @property
    def occupied(self) -> BoolArray:
        """(N,)"""
        return self.log_odds >= self.OCCUPIED_LOG_ODDS

    def select(self, wanted: BoolArray) -> "OctreeLeaves":
        """Those for which (N,) ``wanted`` is true."""
        return OctreeLeaves(
            resolution_m=self.resolution_m,
            corners=self.corners[wanted],
            sides=self.sides[wanted],
            log_odds=self.log_odds[wanted],
        )
