"""An odometry trajectory at other stamps, so that sources with their own clocks can be fused."""

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.planar_poses import interpolate_pose
from fusion_core.motion.odometry_trajectory import OdometryTrajectory, mask_unmeasured


def resample_odometry(trajectory: OdometryTrajectory, stamps_ns: IntArray) -> OdometryTrajectory:
    """A trajectory at (N,) other stamps, strictly increasing, interpolated between its own.

    A new step is measured where all steps that overlap it in time are. Its drift covariance is the
    sum over the overlaps, in proportion to time; its step covariance is the mean of theirs, or the
    drift where that is larger. Outside its own stamps the end poses repeat, not measured.
    """
    own_ns = trajectory.stamps_ns
    index = _fractional_indices(own_ns, stamps_ns)
    before = np.clip(np.floor(index).astype(np.int64), 0, max(own_ns.size - 2, 0))
    after = np.minimum(before + 1, own_ns.size - 1)
    poses = interpolate_pose(
        trajectory.poses_odom_lidar[before], trajectory.poses_odom_lidar[after], index - before
    )

    inside = (stamps_ns >= own_ns[0]) & (stamps_ns <= own_ns[-1])
    measured = inside[:-1] & inside[1:] & _all_measured(trajectory.measured, index)
    known = trajectory.measured[:, np.newaxis, np.newaxis]
    drift = _integrate_covariances(np.where(known, trajectory.drift_covariance, 0.0), index)
    single = _integrate_covariances(np.where(known, trajectory.step_covariance, 0.0), index)
    span = np.maximum(np.diff(index), 1e-12)[:, np.newaxis, np.newaxis]
    mean = single / span
    is_less = (np.trace(mean, axis1=1, axis2=2) < np.trace(drift, axis1=1, axis2=2))[:, None, None]
    return OdometryTrajectory(
        name=trajectory.name,
        stamps_ns=stamps_ns.copy(),
        poses_odom_lidar=poses,
        step_covariance=mask_unmeasured(np.where(is_less, drift, mean), measured),
        drift_covariance=mask_unmeasured(drift, measured),
        measured=measured,
        scale_sigma=trajectory.scale_sigma,
        notes=trajectory.notes,
    )


def _fractional_indices(own_ns: IntArray, stamps_ns: IntArray) -> FloatArray:
    """(N,) fractional indices of stamps among the trajectory's own, clipped to its ends."""
    # Differences first: an int64 of nanoseconds has more digits than a float64.
    indices: FloatArray = np.interp(
        stamps_ns - own_ns[0], own_ns - own_ns[0], np.arange(own_ns.size)
    )
    return indices


def _all_measured(measured: BoolArray, index: FloatArray) -> BoolArray:
    """(N - 1,) whether every step that overlaps the interval between two indices was measured."""
    missed = np.concatenate([[0], np.cumsum(~measured)])
    begin = np.floor(index[:-1]).astype(np.int64)
    end = np.ceil(index[1:]).astype(np.int64)
    whole: BoolArray = missed[np.minimum(end, measured.size)] == missed[begin]
    return whole


def _integrate_covariances(of_step: FloatArray, index: FloatArray) -> FloatArray:
    """(N - 1, 3, 3) sums of the steps' matrices between indices, parts of a step in proportion."""
    total = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(of_step, axis=0)])
    before = np.clip(np.floor(index).astype(np.int64), 0, max(len(of_step) - 1, 0))
    fraction = (index - before)[:, np.newaxis, np.newaxis]
    after = np.minimum(before + 1, len(of_step))
    at_index = (1.0 - fraction) * total[before] + fraction * total[after]
    sums: FloatArray = np.diff(at_index, axis=0)
    return sums
