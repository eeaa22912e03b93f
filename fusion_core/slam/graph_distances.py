"""How far it is from a key scan to each submap along the graph: what drift grows with.

The graph's nodes here are submaps, in the order of their first key scan. One follows the other
along the way that the robot went, and a loop joins two by hardly any way.
"""

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.slam.local_trajectory import LocalTrajectory
from fusion_core.slam.tracking_losses import TrackingLosses

# A way of so many metres stands for one of which nothing is known.
LOSS_DISTANCE_M = 1e5
# One that odometry told has a doubt, and a wide window, as a way of so many.
BRIDGED_LOSS_DISTANCE_M = 80.0
# Ways that two places have between them when a loop joins them: it is not exact.
_LOOP_DISTANCE_M = 1.0
_DISTANCE_MIN_M = 1e-3


class GraphDistances:
    """The ways of a local trajectory of K key scans and S submaps, shorter with each loop."""

    def __init__(self, local: LocalTrajectory, breaks: TrackingLosses) -> None:
        self._steps_m = np.hypot(*np.diff(local.poses_local_node[:, :2], axis=0).T)
        self._first: IntArray = np.array([submap.first for submap in local.submaps])
        self._ties_m: dict[tuple[int, int], float] = {}
        self._joined: csr_array | None = None
        # (S,) ways from each submap that was asked for since the last change.
        self._from_m: dict[int, FloatArray] = {}
        self.set_losses(breaks)

    def set_losses(self, breaks: TrackingLosses) -> None:
        """What is known of the breaks has changed, and the ways over them with it."""
        steps_m = self._steps_m.copy()
        steps_m[breaks.node_after - 1] += np.where(
            breaks.is_bridged, BRIDGED_LOSS_DISTANCE_M, LOSS_DISTANCE_M
        )
        self._way_m: FloatArray = np.concatenate([[0.0], np.cumsum(steps_m)])
        self._joined = None

    def add_loop(self, number: int, node: int) -> None:
        """A loop joins submap ``number`` and key scan ``node``."""
        other = self._submap_of(node)
        pair = (min(number, other), max(number, other))
        way_m = _LOOP_DISTANCE_M + abs(float(self._way_m[node] - self._way_m[self._first[other]]))
        if number != other and way_m < self._ties_m.get(pair, np.inf):
            self._ties_m[pair] = way_m
            self._joined = None

    def to_submaps(self, node: int) -> FloatArray:
        """(S,) the shortest way from a key scan to each submap's first one, in metres."""
        if self._joined is None:
            self._joined = self._graph()
            self._from_m.clear()
        own = self._submap_of(node)
        if own not in self._from_m:
            self._from_m[own] = dijkstra(self._joined, directed=False, indices=np.array([own]))[0]
        return self._from_m[own] + float(self._way_m[node] - self._way_m[self._first[own]])

    def _submap_of(self, node: int) -> int:
        return int(np.searchsorted(self._first, node, side="right")) - 1

    def _graph(self) -> csr_array:
        """(S, S) the shortest way of each pair that is joined, the upper triangle alone."""
        chain_m = np.maximum(np.diff(self._way_m[self._first]), _DISTANCE_MIN_M)
        shortest = dict(self._ties_m)
        for number, way_m in enumerate(chain_m.tolist()):
            pair = (number, number + 1)
            shortest[pair] = min(way_m, shortest.get(pair, np.inf))
        pairs = np.array(list(shortest), dtype=np.int32).reshape(-1, 2)
        size = self._first.size
        return csr_array(
            (np.array(list(shortest.values())), (pairs[:, 0], pairs[:, 1])), shape=(size, size)
        )
