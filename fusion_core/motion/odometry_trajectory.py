"""The trajectory of the LiDAR by one odometry source, with the covariance of each step."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.planar_poses import interpolate_pose
from fusion_core.model.stamps import find_neighbours
from fusion_core.motion.steps import steps_between


@dataclass(frozen=True, kw_only=True, eq=False)
class OdometryTrajectory:
    """Poses of the LiDAR by one source, and the covariances of the steps between them.

    ``stamps_ns``: (N,) int64, N >= 1, strictly increasing. ``poses_odom_lidar``: (N, 3) x, y, yaw.
    ``measured``: (N - 1,) False where the source did not measure the step from pose k to k + 1;
    pose k + 1 is then extrapolated or repeated.
    ``step_covariance``: (N - 1, 3, 3) of that step alone, in the axes of pose k (m, rad).
    ``drift_covariance``: (N - 1, 3, 3) what the step adds to the covariance of a longer motion, in
    the same axes. The two differ since errors are correlated: the error of a match to a keyframe
    does not accumulate over the steps since, while that of a wrong wheel diameter is small in each
    step but always of one sign. Both are NaN where ``measured`` is False: unknown, not large.
    ``scale_sigma``: standard deviation in m/m of a scale that is common to all steps, where it is
    in neither covariance. ``notes``: messages to the user, such as why steps were not measured.
    """

    name: str
    stamps_ns: IntArray
    poses_odom_lidar: FloatArray
    step_covariance: FloatArray
    drift_covariance: FloatArray
    measured: BoolArray
    scale_sigma: float = 0.0
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        count = self.stamps_ns.size
        if count == 0 or self.stamps_ns.shape != (count,) or self.stamps_ns.dtype != np.int64:
            raise ValueError(f"stamps_ns must be (N,) int64, N >= 1, got {self.stamps_ns.shape}")
        if np.any(np.diff(self.stamps_ns) <= 0):
            raise ValueError("stamps_ns must be strictly increasing")
        if self.poses_odom_lidar.shape != (count, 3):
            raise ValueError(f"poses must be ({count}, 3), got {self.poses_odom_lidar.shape}")
        if not np.isfinite(self.poses_odom_lidar).all():
            raise ValueError("poses_odom_lidar must be finite")
        if self.measured.shape != (count - 1,) or self.measured.dtype != np.bool_:
            raise ValueError(f"measured must be ({count - 1},) bool, got {self.measured.shape}")
        for covariance in (self.step_covariance, self.drift_covariance):
            if covariance.shape != (count - 1, 3, 3):
                raise ValueError(f"covariances must be ({count - 1}, 3, 3)")
            if not np.array_equal(np.isfinite(covariance).all(axis=(1, 2)), self.measured):
                raise ValueError("covariances must be finite where measured, and NaN elsewhere")
            read_only(covariance)
        for array in (self.stamps_ns, self.poses_odom_lidar, self.measured):
            read_only(array)

    @cached_property
    def steps(self) -> FloatArray:
        """(N - 1, 3) the step from each pose to the next, in its axes."""
        return steps_between(self.poses_odom_lidar)

    @property
    def measured_fraction(self) -> float:
        """Fraction of the steps that were measured, 0 without steps."""
        return float(self.measured.mean()) if self.measured.size else 0.0

    def pose_at(self, stamp_ns: int) -> FloatArray | None:
        """(3,) pose at an instant, interpolated; None outside the stamps and in unmeasured steps.

        At one of the stamps it is the pose there, unless neither of its steps was measured.
        """
        neighbours = find_neighbours(self.stamps_ns, stamp_ns)
        if neighbours is None:
            return None
        before, after, _, fraction = neighbours
        if before == after:
            beside = self.measured[max(after - 1, 0) : after + 1]
            if beside.size and not beside.any():
                return None
            exact: FloatArray = self.poses_odom_lidar[after].copy()
            return exact
        if not self.measured[before]:
            return None
        poses = self.poses_odom_lidar
        return interpolate_pose(poses[before], poses[after], fraction)


def mask_unmeasured(covariance: FloatArray, measured: BoolArray) -> FloatArray:
    """(N - 1, 3, 3) with NaN where nothing was measured."""
    return np.where(measured[:, np.newaxis, np.newaxis], covariance, np.nan)
