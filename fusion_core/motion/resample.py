"""A track at other stamps: what sources with clocks of their own need before they can be fused."""

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, wrap_angle
from fusion_core.motion.odometry_trajectory import OdometryTrajectory, mask_unmeasured


def resample_odometry(track: OdometryTrajectory, stamps_ns: IntArray) -> OdometryTrajectory:
    """A track at (N,) other stamps, strictly increasing, interpolated between its own.

    A step is measured where all the steps are that share time with it, and its drift is that of the
    time it takes. Its own covariance is the mean of theirs, or the drift where that is more. Beyond
    its ends the track stands still, not measured.
    """
    own_ns = track.stamps_ns
    place = _fractional_indices(own_ns, stamps_ns)
    before = np.clip(np.floor(place).astype(np.int64), 0, max(own_ns.size - 2, 0))
    after = np.minimum(before + 1, own_ns.size - 1)
    share = (place - before)[:, np.newaxis]
    begin, end = track.poses_odom_lidar[before], track.poses_odom_lidar[after]
    away = end - begin
    away[:, 2] = wrap_angle(away[:, 2])
    poses = begin + share * away
    poses[:, 2] = wrap_angle(poses[:, 2])

    inside = (stamps_ns >= own_ns[0]) & (stamps_ns <= own_ns[-1])
    measured = inside[:-1] & inside[1:] & _all_measured(track.measured, place)
    known = track.measured[:, np.newaxis, np.newaxis]
    drift = _integrate_covariances(np.where(known, track.drift_covariance, 0.0), place)
    single = _integrate_covariances(np.where(known, track.step_covariance, 0.0), place)
    span = np.maximum(np.diff(place), 1e-12)[:, np.newaxis, np.newaxis]
    mean = single / span
    is_less = (np.trace(mean, axis1=1, axis2=2) < np.trace(drift, axis1=1, axis2=2))[:, None, None]
    return OdometryTrajectory(
        name=track.name,
        stamps_ns=stamps_ns.copy(),
        poses_odom_lidar=poses,
        step_covariance=mask_unmeasured(np.where(is_less, drift, mean), measured),
        drift_covariance=mask_unmeasured(drift, measured),
        measured=measured,
        notes=track.notes,
    )


def _fractional_indices(own_ns: IntArray, stamps_ns: IntArray) -> FloatArray:
    """(N,) where stamps lie among a track's own, counted in its steps, from 0 to their number."""
    # Differences first: an int64 of nanoseconds has more digits than a float64.
    places: FloatArray = np.interp(
        stamps_ns - own_ns[0], own_ns - own_ns[0], np.arange(own_ns.size)
    )
    return places


def _all_measured(measured: BoolArray, place: FloatArray) -> BoolArray:
    """(N - 1,) whether every step that lies between two places, even in part, was measured."""
    missed = np.concatenate([[0], np.cumsum(~measured)])
    begin = np.floor(place[:-1]).astype(np.int64)
    end = np.ceil(place[1:]).astype(np.int64)
    whole: BoolArray = missed[np.minimum(end, measured.size)] == missed[begin]
    return whole


def _integrate_covariances(of_step: FloatArray, place: FloatArray) -> FloatArray:
    """(N - 1, 3, 3) of the steps' matrices between places, parts of a step in proportion."""
    total = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(of_step, axis=0)])
    before = np.clip(np.floor(place).astype(np.int64), 0, max(len(of_step) - 1, 0))
    share = (place - before)[:, np.newaxis, np.newaxis]
    after = np.minimum(before + 1, len(of_step))
    at_place = (1.0 - share) * total[before] + share * total[after]
    sums: FloatArray = np.diff(at_place, axis=0)
    return sums
