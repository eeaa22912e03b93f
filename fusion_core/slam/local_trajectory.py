"""What local SLAM gives: each scan as it was placed, and the trajectory of all."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.slam.submaps import Submap
from fusion_core.slam.tracking import TrackingState


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrackedScan:
    """A scan as local SLAM has placed it.

    ``pose_local_scan``: (3,). ``points_m``: (n, 2) in the scan's frame. ``state``: what determines
    its pose. ``segment``: of the trajectory, one more after each tracking loss. ``fits``: whether
    it fits its submap, or is the very first and has points.
    """

    pose_local_scan: FloatArray
    points_m: FloatArray
    state: TrackingState
    segment: int
    fits: bool

    @property
    def is_trusted(self) -> bool:
        """Whether it fits, and its place is known within the segment."""
        return self.fits and self.state.is_located


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalTrajectory:
    """N scans as local SLAM has placed them. K of them are keyframes, the nodes of the pose graph.

    ``stamps_ns``: (N,) strictly increasing. ``poses_local_scan``: (N, 3). ``is_trusted``: (N,) the
    scan fits its submap, and its place is known within the segment. ``keyframes``: (K,) numbers of
    their scans, the first being 0. ``node_points_m``: K arrays (n, 2). ``segment``: (K,) 0, 1,
    ...: no scan determines the motion from one segment to the next. ``is_bridged``: (K,) odometry
    has measured all motion since the last scan that was tracked. ``submaps``: in the order of their
    first keyframe; each is of one segment. ``poses_local_node``: (K, 3) of the keyframes.
    """

    stamps_ns: IntArray
    poses_local_scan: FloatArray
    is_trusted: BoolArray
    keyframes: IntArray
    node_points_m: Sequence[FloatArray]
    segment: IntArray
    is_bridged: BoolArray
    submaps: Sequence[Submap]
    poses_local_node: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "poses_local_node", self.poses_local_scan[self.keyframes])
        for array in (
            self.stamps_ns,
            self.poses_local_scan,
            self.is_trusted,
            self.keyframes,
            self.segment,
            self.is_bridged,
            self.poses_local_node,
        ):
            read_only(array)

    def nodes_before(self, scans: IntArray) -> IntArray:
        """(n,) the last keyframe, as a node, at or before each scan (n,)."""
        nodes: IntArray = np.searchsorted(self.keyframes, scans, side="right") - 1
        return nodes
