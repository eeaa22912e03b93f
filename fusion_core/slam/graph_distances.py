"""Path lengths along the pose graph from a keyframe to each submap, with which drift grows.

The nodes of this graph are submaps, in the order of their first keyframe. Each is connected with
the next by the length of the trajectory between them, and the two of a loop by a short edge.
"""

from typing import TYPE_CHECKING

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.slam.identifiers import NodeId, SubmapId
from fusion_core.slam.local_trajectory import LocalTrajectory
from fusion_core.slam.tracking_losses import TrackingLosses

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Length of a tracking loss with unknown motion: longer than any trajectory.
LOSS_DISTANCE_M = 1e5
# Length of a tracking loss that odometry bridges, so that its search is wide. Empirical.
BRIDGED_LOSS_DISTANCE_M = 80.0
# Length of a loop, since its match is not exact. Empirical.
_LOOP_DISTANCE_M = 1.0
# An entry of zero would be no edge in the sparse matrix.
_DISTANCE_MIN_M = 1e-3


class GraphDistances:
    """Path lengths of a trajectory of K keyframes and S submaps; loops make them shorter."""

    def __init__(self, local: LocalTrajectory, losses: TrackingLosses) -> None:
        self._steps_m = np.hypot(*np.diff(local.poses_local_node[:, :2], axis=0).T)
        self._first: IntArray = np.array([submap.first for submap in local.submaps])
        self._loops_m: dict[tuple[int, int], float] = {}
        self._graph_m: csr_array | None = None
        # (S,) distances from each submap that was queried since the last change.
        self._from_m: dict[int, FloatArray] = {}
        self.set_losses(losses)

    def set_losses(self, losses: TrackingLosses) -> None:
        """Recompute the lengths after tracking losses were confirmed or refuted."""
        steps_m = self._steps_m.copy()
        steps_m[losses.node_after - 1] += np.where(
            losses.is_bridged, BRIDGED_LOSS_DISTANCE_M, LOSS_DISTANCE_M
        )
        self._path_m: FloatArray = np.concatenate([[0.0], np.cumsum(steps_m)])
        self._graph_m = None

    def add_loop(self, submap: SubmapId, node: NodeId) -> None:
        """Connect a submap and a keyframe by a loop."""
        other = self._submap_of(node)
        pair = (min(submap, other), max(submap, other))
        length_m = _LOOP_DISTANCE_M + abs(
            float(self._path_m[node] - self._path_m[self._first[other]])
        )
        if submap != other and length_m < self._loops_m.get(pair, np.inf):
            self._loops_m[pair] = length_m
            self._graph_m = None

    def to_submaps(self, node: NodeId) -> FloatArray:
        """(S,) the shortest path from a keyframe to each submap's first one, in metres."""
        from scipy.sparse.csgraph import dijkstra

        if self._graph_m is None:
            self._graph_m = self._adjacency()
            self._from_m.clear()
        own = self._submap_of(node)
        if own not in self._from_m:
            self._from_m[own] = dijkstra(self._graph_m, directed=False, indices=np.array([own]))[0]
        return self._from_m[own] + float(self._path_m[node] - self._path_m[self._first[own]])

    def _submap_of(self, node: NodeId) -> SubmapId:
        return SubmapId(int(np.searchsorted(self._first, node, side="right")) - 1)

    def _adjacency(self) -> "csr_array":
        """(S, S) edge lengths, in the upper triangle only."""
        from scipy.sparse import csr_array

        chain_m = np.maximum(np.diff(self._path_m[self._first]), _DISTANCE_MIN_M)
        shortest = dict(self._loops_m)
        for number, length_m in enumerate(chain_m.tolist()):
            pair = (number, number + 1)
            shortest[pair] = min(length_m, shortest.get(pair, np.inf))
        pairs = np.array(list(shortest), dtype=np.int32).reshape(-1, 2)
        size = self._first.size
        return csr_array(
            (np.array(list(shortest.values())), (pairs[:, 0], pairs[:, 1])), shape=(size, size)
        )
