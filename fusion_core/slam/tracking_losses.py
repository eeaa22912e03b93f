"""Tracking losses: which segments of a trajectory are connected, by loops or by odometry.

Odometry that bridges a tracking loss is a hypothesis: scans that contradict the map may be of a
ramp, or of another room to which the robot was moved. A loop that is found where odometry
predicts it confirms the odometry over all losses between its ends; one found elsewhere refutes it.
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import BoolArray, IntArray
from fusion_core.slam.local_trajectory import LocalTrajectory
from fusion_core.slam.pose_graph import Edge

# A shorter segment may consist of false scans, such as the floor on a ramp. Empirical.
_SEGMENT_KEYFRAMES_MIN = 10


class TrackingLosses:
    """The L tracking losses of a trajectory of L + 1 segments, and whether odometry bridges each.

    ``node_after``: (L,) the first keyframe after each loss. ``is_bridged``: (L,) odometry has
    measured the motion over it, and no loop has refuted that. ``is_confirmed``: (L,) a loop has
    confirmed it. A loop over a loss that is not bridged says nothing about the others.
    """

    def __init__(self, local: LocalTrajectory) -> None:
        self._local, self._segment = local, local.segment
        self._loops: list[tuple[Edge, bool | None]] = []
        self.node_after: IntArray = np.flatnonzero(np.diff(local.segment)) + 1
        self.is_bridged: BoolArray = local.is_bridged[self.node_after].copy()
        self.is_confirmed: BoolArray = np.zeros(self.node_after.size, dtype=np.bool_)
        self._component: IntArray = np.arange(int(local.segment[-1]) + 1)

    def add_loop(self, edge: Edge, *, agrees_with_odometry: bool | None) -> None:
        """Connect the segments of a loop's ends.

        ``agrees_with_odometry``: whether odometry predicted the loop, None where that is not known.
        """
        self._loops.append((edge, agrees_with_odometry))
        self._connect(edge.first, edge.second)
        between = (self.node_after > edge.first) & (self.node_after <= edge.second)
        if agrees_with_odometry is None or not self.is_bridged[between].all():
            return
        if agrees_with_odometry:
            self.is_confirmed |= between
            for node in self.node_after[between].tolist():
                self._connect(node - 1, node)
        else:
            self.is_bridged &= ~between | self.is_confirmed

    def _connect(self, first: int, second: int) -> None:
        low, high = sorted(int(self._component[self._segment[node]]) for node in (first, second))
        self._component[self._component == high] = low

    def are_connected(self, nodes: IntArray, node: int) -> BoolArray:
        """(n,) whether loops or confirmed odometry connect keyframes with another one."""
        connected: BoolArray = (
            self._component[self._segment[nodes]] == self._component[self._segment[node]]
        )
        return connected

    def connected_by(self, loops: Sequence[Edge]) -> BoolArray:
        """(K,) whether these loops, and odometry they confirm, connect keyframes with the first.

        Odometry alone does not connect a short segment: its scans may be the false ones.
        """
        kept_alone = TrackingLosses(self._local)
        kept = {id(edge) for edge in loops}
        for edge, agrees in self._loops:
            if id(edge) in kept:
                kept_alone.add_loop(edge, agrees_with_odometry=agrees)
        is_short = np.bincount(self._segment) < _SEGMENT_KEYFRAMES_MIN
        is_short[[self._segment[node] for edge in loops for node in (edge.first, edge.second)]] = (
            False
        )
        is_short[0] = False
        return kept_alone.are_connected(np.arange(len(self._segment)), 0) & ~is_short[self._segment]

    def unbridged_segments(self) -> IntArray:
        """(K,) a number that grows by one at each loss that odometry does not bridge."""
        numbers = np.zeros(len(self._segment), dtype=np.int64)
        numbers[self.node_after[~self.is_bridged]] = 1
        return np.cumsum(numbers)
