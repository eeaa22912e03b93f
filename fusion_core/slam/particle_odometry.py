"""Odometry that all particles share: each scan matched with the few before it.

Scan matching over short ways is far more exact than wheels, so that few particles cover what is
left open. It is local SLAM (local_slam.py) without its memory: submaps and points of key scans
are for loop closure, which is the particles' work here.
"""

from dataclasses import dataclass

from fusion_core.model.conventions import FloatArray
from fusion_core.model.sensors import LaserScan
from fusion_core.slam.local_slam import LocalSlam, LocalSlamSettings, LocalTrajectory
from fusion_core.slam.scan_points import densified_points
from fusion_core.slam.submaps import SubmapSettings


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


class ScanMatchedOdometry:
    """Local SLAM that tells each scan's pose at once and keeps a pose for each scan only."""

    def __init__(self, settings: LocalSlamSettings, submaps: SubmapSettings) -> None:
        self._slam = LocalSlam(settings, submaps)
        self._resolution_m = submaps.resolution_m

    def place(self, scan: LaserScan, prior: FloatArray | None) -> LocalPose:
        """Take the next scan; arguments and errors as ``LocalSlam.add_scan``."""
        self._slam.add_scan(scan, prior)
        self._slam.drop_finished()
        points_m = self._slam.points(scan)
        return LocalPose(
            pose_local_scan=self._slam.last_pose,
            is_sure=self._slam.fits_last,
            points_m=points_m,
            wall_points_m=densified_points(points_m, self._resolution_m),
        )

    def finish(self) -> LocalTrajectory:
        """``LocalSlam.finish``, with the submaps that still grow and no points."""
        return self._slam.finish()
