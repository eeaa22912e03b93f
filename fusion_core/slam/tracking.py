"""The tracking state: what determines each scan's pose in local SLAM.

A scan that fits its submap at a single pose is tracked. One that fits anywhere along a corridor
needs odometry to be placed along it. One that does not fit, or has no points, is dead-reckoned,
and its uncertainty grows. When the uncertainty is too large, or scan after scan contradicts the
map, tracking is lost: a new segment of the trajectory begins, with new submaps, until a loop
closure connects it with the others.
"""

from enum import Enum, auto

import numpy as np

from fusion_core.model.conventions import FloatArray

# Fewer scans in a row without a match do not end a segment: the next may fit again. Empirical.
_MISMATCHES_MIN = 3
# Without any points the uncertainty may grow this many times larger, since the next scan with
# points is matched in a wider search. Empirical.
_BLIND_FACTOR = 3.0


class TrackingState(Enum):
    """What determines a scan's pose.

    ``INITIALISING``: there is no submap yet, the scan begins one. ``TRACKING``: it fits its submap
    at a single pose. ``UNCONSTRAINED``: it fits, but not at a single pose. ``DEAD_RECKONING``:
    it fits badly or has no points; odometry or constant velocity has brought it here.
    ``CONTRADICTED``: unlike the scans just before, it does not fit, so that it is not inserted.
    ``LOST``: the uncertainty was too large, and no scan has been tracked since.
    """

    INITIALISING = auto()
    TRACKING = auto()
    UNCONSTRAINED = auto()
    DEAD_RECKONING = auto()
    CONTRADICTED = auto()
    LOST = auto()

    @property
    def is_located(self) -> bool:
        """Whether the pose is known, as far as the segment's first one is."""
        return self not in (TrackingState.CONTRADICTED, TrackingState.LOST)


class TrackingMonitor:
    """Gives each scan its tracking state, one after the other.

    In all methods ``uncertainty`` is (2,): what the scan's motion adds to the error of its pose
    without a match, in metres and radians.

    ``segment``: number of the trajectory's segment, one more after each tracking loss.
    ``is_bridged``: whether odometry has measured all motion since the last scan that was tracked.
    """

    def __init__(self, uncertainty_max_m: float, contradictions_max: int) -> None:
        self._uncertainty_max = uncertainty_max_m
        self._contradictions_max = contradictions_max
        self._uncertainty = np.zeros(2)
        self._contradictions = 0
        self._is_lost = False
        self.mismatches = 0
        """Scans with points in a row that did not fit."""
        self.segment = 0
        self.is_bridged = True

    @property
    def is_uncertain(self) -> bool:
        """Whether some motion was dead-reckoned since the last scan that was tracked."""
        return self._is_lost or bool(self._uncertainty.any())

    def on_match(
        self, uncertainty: FloatArray, *, is_well_constrained: bool, has_odometry: bool
    ) -> TrackingState:
        """The scan fits its submap; ``is_well_constrained``: at a single pose."""
        self._contradictions = self.mismatches = 0
        if is_well_constrained:
            self._uncertainty[:] = 0.0
            self._is_lost = False
            self.is_bridged = True
            return TrackingState.TRACKING
        self.is_bridged &= has_odometry
        if not has_odometry:
            self._uncertainty[0] += uncertainty[0]
        # A corridor's walls determine the heading.
        self._uncertainty[1] = 0.0
        self._lose_beyond(self._uncertainty_max)
        return TrackingState.LOST if self._is_lost else TrackingState.UNCONSTRAINED

    def on_mismatch(
        self, uncertainty: FloatArray, *, is_contradiction: bool, has_odometry: bool
    ) -> TrackingState:
        """The scan has points and does not fit; ``is_contradiction``: those before it did."""
        self.is_bridged &= has_odometry
        self._uncertainty += uncertainty
        self.mismatches += 1
        if is_contradiction:
            self._contradictions += 1
        if self._contradictions >= self._contradictions_max:
            self._begin_segment()
            self._uncertainty[:] = 0.0
            return TrackingState.LOST if self._is_lost else TrackingState.INITIALISING
        if self.mismatches >= _MISMATCHES_MIN and self._lose_beyond(self._uncertainty_max):
            return TrackingState.LOST
        if is_contradiction:
            return TrackingState.CONTRADICTED
        return TrackingState.LOST if self._is_lost else TrackingState.DEAD_RECKONING

    def on_no_match(
        self, uncertainty: FloatArray, *, has_submap: bool, has_odometry: bool
    ) -> TrackingState:
        """The scan has too few points, or there is no submap to match it with."""
        self.is_bridged &= has_odometry
        if has_submap:
            self._uncertainty += uncertainty
            self._lose_beyond(_BLIND_FACTOR * self._uncertainty_max)
        if self._is_lost:
            return TrackingState.LOST
        return TrackingState.DEAD_RECKONING if has_submap else TrackingState.INITIALISING

    def _lose_beyond(self, uncertainty_max: float) -> bool:
        """Whether tracking is lost with this scan; while it is lost, no further segment begins."""
        if self._is_lost or not (self._uncertainty > uncertainty_max).any():
            return False
        self._begin_segment()
        self._is_lost = True
        return True

    def _begin_segment(self) -> None:
        self.segment += 1
        self._contradictions = self.mismatches = 0
