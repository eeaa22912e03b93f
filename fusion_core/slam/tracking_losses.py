"""Breaks of the way: which parts of a trajectory hang together, by loops or by odometry.

Where odometry told the way over a break, that it told true is a hypothesis: scans that contradict
the map may be of a ramp, or of another room to which the robot was carried. A loop that is found
where odometry has the place confirms all breaks between its ends; one found elsewhere refutes them.
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import BoolArray, IntArray
from fusion_core.slam.local_trajectory import LocalTrajectory
from fusion_core.slam.pose_graph import Edge

# Key scans. Who sees the floor for a while begins a map of it.
_SEGMENT_KEY_SCANS_MIN = 10


class TrackingLosses:
    """The B breaks of a trajectory of P parts, and what is known of each.

    ``node``: (B,) the key scan after each break. ``is_told``: (B,) odometry told the way over it,
    and no loop has refuted that. ``is_confirmed``: (B,) one has confirmed it. Over a break that was
    not told, a loop says nothing of the others.
    """

    def __init__(self, local: LocalTrajectory) -> None:
        self._local, self._part = local, local.segment
        self._taken: list[tuple[Edge, bool | None]] = []
        self.node_after: IntArray = np.flatnonzero(np.diff(local.segment)) + 1
        self.is_bridged: BoolArray = local.is_bridged[self.node_after].copy()
        self.is_confirmed: BoolArray = np.zeros(self.node_after.size, dtype=np.bool_)
        self._joined: IntArray = np.arange(int(local.segment[-1]) + 1)

    def add_loop(self, edge: Edge, *, agrees_with_odometry: bool | None) -> None:
        """A loop joins the parts of its ends; ``is_as_told``: whether where odometry has them,
        None where it was not asked."""
        self._taken.append((edge, agrees_with_odometry))
        self._join(edge.first, edge.second)
        between = (self.node_after > edge.first) & (self.node_after <= edge.second)
        if agrees_with_odometry is None or not self.is_bridged[between].all():
            return
        if agrees_with_odometry:
            self.is_confirmed |= between
            for node in self.node_after[between].tolist():
                self._join(node - 1, node)
        else:
            self.is_bridged &= ~between | self.is_confirmed

    def _join(self, first: int, second: int) -> None:
        low, high = sorted(int(self._joined[self._part[node]]) for node in (first, second))
        self._joined[self._joined == high] = low

    def are_connected(self, nodes: IntArray, node: int) -> BoolArray:
        """(n,) whether key scans hang together with another by more than a hypothesis."""
        joined: BoolArray = self._joined[self._part[nodes]] == self._joined[self._part[node]]
        return joined

    def connected_by(self, loops: Sequence[Edge]) -> BoolArray:
        """(K,) whether key scans hang together with the first by those of the loops alone.

        A short part does not on odometry's word alone: its scans may be the false ones.
        """
        again = TrackingLosses(self._local)
        kept = {id(edge) for edge in loops}
        for edge, is_as_told in self._taken:
            if id(edge) in kept:
                again.add_loop(edge, agrees_with_odometry=is_as_told)
        is_short = np.bincount(self._part) < _SEGMENT_KEY_SCANS_MIN
        is_short[[self._part[node] for edge in loops for node in (edge.first, edge.second)]] = False
        is_short[0] = False
        return again.are_connected(np.arange(len(self._part)), 0) & ~is_short[self._part]

    def unbridged_segments(self) -> IntArray:
        """(K,) a number that grows by one at each break over which odometry told nothing."""
        blocks = np.zeros(len(self._part), dtype=np.int64)
        blocks[self.node_after[~self.is_bridged]] = 1
        return np.cumsum(blocks)
