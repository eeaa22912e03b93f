"""The octree map of Fu 2024 §3.1: occupancy in space from clouds at known poses, by OctoMap.

(7) should read L(n | M_1:t+1) = L(n | M_1:t) + L(n | M_t+1); (8) prints two increments without
their conditions: they are that of a hit and that of a miss, OctoMap's own (Hornung 2013), and the
sum is clamped.
"""

from typing import Any

import numpy as np

from fusion_core.mapping.octree_nodes import prune
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import MappingFailed, VolumeTooLarge
from fusion_core.model.octree import NODE_TYPE, TREE_DEPTH, OccupancyOctree
from fusion_core.settings import StageSettings, setting

_HALF_CELLS = 1 << (TREE_DEPTH - 1)
# What OctoMap writes before the nodes.
_HEADER_END = b"\ndata\n"


class OctreeSettings(StageSettings):
    """Octree map. The probabilities are OctoMap's (Hornung 2013)."""

    resolution_m: float = setting(0.05, "Side of the finest cell", unit="m", ge=0.005, le=10.0)
    p_hit: float = setting(0.7, "Probability of occupied given a hit", ge=0.5, le=0.999)
    p_miss: float = setting(0.4, "Probability of occupied given a pass", ge=0.001, le=0.5)
    p_lowest: float = setting(0.1192, "Lowest probability a cell can reach", ge=0.001, le=0.5)
    p_highest: float = setting(0.971, "Highest probability a cell can reach", ge=0.5, le=0.999)
    range_max_m: float = setting(
        5.0,
        "Points farther from the camera only free the way up to here",
        unit="m",
        ge=0.1,
        le=1000.0,
    )
    nodes_max: int = setting(
        8_000_000,
        "Largest tree, 16 to 32 bytes a node; where more are needed, resolution_m is doubled",
        unit="nodes",
        # A tree of the coarsest cells has about a hundred.
        ge=1_000,
        le=64_000_000,
    )


class OctreeBuilder:
    """Adds clouds, each seen from one place, to an octree.

    Poses must be final: a tree cannot be moved, it is built anew.
    """

    def __init__(self, settings: OctreeSettings) -> None:
        # Imported here: what only reads and displays does not wait for it.
        import pyoctomap

        self._settings = settings
        self._tree: Any = pyoctomap.OcTree(settings.resolution_m)
        self._tree.setProbHit(settings.p_hit)
        self._tree.setProbMiss(settings.p_miss)
        self._tree.setClampingThresMin(settings.p_lowest)
        self._tree.setClampingThresMax(settings.p_highest)

    @property
    def memory_bytes(self) -> int:
        """What the tree takes while it is built, by OctoMap's own count."""
        return int(self._tree.memoryUsage())

    def add(self, points_in_map_m: FloatArray, origin_in_map_m: FloatArray) -> None:
        """Add a cloud.

        ``points_in_map_m``: (N, 3), finite. ``origin_in_map_m``: (3,) where the sensor was. Each
        cell that holds a point is hit once; each that a ray from the origin to the centre of a hit
        cell crosses, and that is not hit itself, is missed once. A ray to a point beyond
        ``range_max_m`` misses the cells up to there and hits none.

        Raises VolumeTooLarge where the tree becomes too large, MappingFailed for a point too far
        from the map's origin.
        """
        if points_in_map_m.ndim != 2 or points_in_map_m.shape[1] != 3:
            raise ValueError(f"points_in_map_m must be (N, 3), got {points_in_map_m.shape}")
        if not np.isfinite(points_in_map_m).all() or not np.isfinite(origin_in_map_m).all():
            raise ValueError("points_in_map_m and origin_in_map_m must be finite")
        self._cells_of(origin_in_map_m[np.newaxis])
        ends_m, reach_m = self._ends_within_reach(points_in_map_m, origin_in_map_m)
        if not len(ends_m):
            return
        centres_m = self._centres_m(self._distinct_cells(ends_m))
        # Inner nodes wait until the end: the binding's alternative is to update all of the tree
        # after each cloud.
        self._tree.insertPointCloud(
            centres_m,
            np.asarray(origin_in_map_m, dtype=np.float64),
            max_range=reach_m,
            lazy_eval=True,
        )
        if self._tree.size() > self._settings.nodes_max:
            raise VolumeTooLarge(
                f"the octree exceeds {self._settings.nodes_max} nodes of "
                f"{self._settings.resolution_m:g} m.",
                advice="Choose a coarser octree.resolution_m, or a larger octree.nodes_max.",
            )

    def build(self) -> OccupancyOctree:
        """The tree so far, pruned. Raises MappingFailed where no point was added."""
        content = bytes(self._tree.write()) if self._tree.size() else b""
        start = content.find(_HEADER_END)
        if start < 0:
            raise MappingFailed("no cell of the octree is known: there are no points.")
        nodes = np.frombuffer(content, dtype=NODE_TYPE, offset=start + len(_HEADER_END))
        return OccupancyOctree(resolution_m=self._settings.resolution_m, nodes=prune(nodes))

    def _ends_within_reach(
        self, points_in_map_m: FloatArray, origin_in_map_m: FloatArray
    ) -> tuple[FloatArray, float]:
        """(M, 3) ends of the rays, and the range within which OctoMap takes the centre of an end's
        cell for a hit: it holds all cells with a point within ``range_max_m``, and none with an end
        that was moved nearer."""
        settings = self._settings
        along_m = points_in_map_m - origin_in_map_m
        ranges_m = np.sqrt(np.einsum("ij,ij->i", along_m, along_m))
        # A point lies within 0.87 sides of its cell's centre.
        reach_m = settings.range_max_m + settings.resolution_m
        beyond_m = reach_m + settings.resolution_m
        is_hit, is_far = ranges_m <= settings.range_max_m, ranges_m > beyond_m
        # Far points share few cells once they are moved. Those between both are left out: the ray
        # would run through their surface.
        moved_m = origin_in_map_m + along_m[is_far] * (beyond_m / ranges_m[is_far])[:, np.newaxis]
        # A quarter of the time of points_in_map_m[is_hit].
        hits_m = np.compress(is_hit, points_in_map_m, axis=0)
        return np.concatenate([hits_m, moved_m]), reach_m

    def _cells_of(self, points_in_map_m: FloatArray) -> IntArray:
        """(N, 3) the finest cell of each point, as OctoMap numbers them."""
        cells = np.floor(points_in_map_m * (1.0 / self._settings.resolution_m))
        if not (np.abs(cells) < _HALF_CELLS).all():
            raise MappingFailed(
                f"a point lies {np.abs(points_in_map_m).max():.4g} m from the map's origin, too "
                f"far for an octree of {self._settings.resolution_m:g} m.",
                advice="Check the poses, or choose a coarser octree.resolution_m.",
            )
        return cells.astype(np.int64) + _HALF_CELLS

    def _distinct_cells(self, points_in_map_m: FloatArray) -> IntArray:
        """(M,) one key for each cell with a point, in ascending order."""
        cells = self._cells_of(points_in_map_m)
        keys = (cells[:, 2] << 2 * TREE_DEPTH) | (cells[:, 1] << TREE_DEPTH) | cells[:, 0]
        # Neighbours in an image mostly share a cell: few are left to sort.
        is_new = np.append(True, keys[1:] != keys[:-1])
        return np.unique(keys[is_new])

    def _centres_m(self, keys: IntArray) -> FloatArray:
        """(M, 3) the centres of cells."""
        last = (1 << TREE_DEPTH) - 1
        cells = np.column_stack([keys & last, (keys >> TREE_DEPTH) & last, keys >> 2 * TREE_DEPTH])
        centres: FloatArray = (cells - _HALF_CELLS + 0.5) * self._settings.resolution_m
        return centres
