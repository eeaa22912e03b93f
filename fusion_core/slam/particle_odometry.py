"""Odometry that all particles share: each scan matched with the few before it.

Scan matching over short ways is far more exact than wheels, so that few particles cover what is
left open. It is local SLAM (local_slam.py) without its memory: submaps and points of key scans
are for loop closure, which is the particles' work here.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.sensors import LaserScan
from fusion_core.slam.local_slam import LocalSlam


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalPose:
    """A scan by local SLAM.

    ``pose_local_scan``: (3,). ``is_sure``: whether the scan fits those before it, or is the first
    one. ``points_m``: (n, 2) its end points. ``wall_points_m``: (n', 2) them and, a cell apart,
    the walls between neighbours.
    """

    pose_local_scan: FloatArray
    is_sure: bool
    points_m: FloatArray
    wall_points_m: FloatArray


class ScanMatchedOdometry(LocalSlam):
    """Local SLAM that tells each scan's pose at once and keeps a pose for each scan only."""

    def place(self, scan: LaserScan, prior: FloatArray | None) -> LocalPose:
        """Take the next scan; arguments and errors as ``LocalSlam.add_scan``."""
        self.add_scan(scan, prior)
        self._finished.clear()
        if self._key_points_m:
            self._key_points_m[-1] = np.empty((0, 2))
        points_m = self._points(scan)
        # NaN compares false.
        is_sure = self._occupancy[-1] >= self._settings.occupancy_min
        if len(self._poses) == 1:
            is_sure = points_m.size > 0
        return LocalPose(
            pose_local_scan=self._poses[-1],
            is_sure=bool(is_sure),
            points_m=points_m,
            wall_points_m=self._wall_points(points_m),
        )
