"""What a trajectory says at an instant, and what it refuses to be."""

import numpy as np
import pytest

from fusion_core.model.planar_poses import compose_poses
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.motion.resample import resample_odometry
from tests.motion.simulated_motion import STEP_NS, stamps, track_of, weaving

SIGMA = (0.01, 0.02, 0.005)


def test_between_two_stamps_it_is_interpolated_along_the_shorter_arc() -> None:
    steps = np.array([[1.0, 0.0, 3.0], [1.0, 0.0, 0.4]])
    trajectory = track_of("wheel", steps, SIGMA)
    at = trajectory.pose_at(int(trajectory.stamps_ns[1]) + STEP_NS // 2)
    assert at is not None
    end = compose_poses(compose_poses(np.zeros(3), steps[0]), steps[1])
    np.testing.assert_allclose(at[:2], 0.5 * (np.array([1.0, 0.0]) + end[:2]))
    assert at[2] == pytest.approx(3.2 - 2.0 * np.pi)


def test_outside_and_across_a_dropout_it_is_unknown() -> None:
    trajectory = track_of("laser", weaving(10), SIGMA, unmeasured=slice(3, 5))
    begin = trajectory.stamps_ns
    assert trajectory.pose_at(int(begin[0]) - 1) is None
    assert trajectory.pose_at(int(begin[-1]) + 1) is None
    for step, known in ((2, True), (3, False), (4, False), (5, True)):
        assert (trajectory.pose_at(int(begin[step]) + 1) is not None) == known, step
    # Pose 4 lies between two steps that were not measured; 3 and 5 end and begin one that was.
    assert trajectory.pose_at(int(begin[4])) is None
    for pose in (3, 5):
        at = trajectory.pose_at(int(begin[pose]))
        assert at is not None
        np.testing.assert_array_equal(at, trajectory.poses_odom_lidar[pose])


def test_it_checks_itself() -> None:
    good = track_of("wheel", weaving(4), SIGMA)
    with pytest.raises(ValueError, match="strictly increasing"):
        OdometryTrajectory(**{**_fields(good), "stamps_ns": good.stamps_ns[::-1].copy()})
    with pytest.raises(ValueError, match="finite where measured"):
        OdometryTrajectory(**{**_fields(good), "measured": np.zeros(3, dtype=np.bool_)})
    with pytest.raises(ValueError, match="read-only"):
        good.poses_odom_lidar[0, 0] = 1.0


def _fields(trajectory: OdometryTrajectory) -> dict:
    names = ("stamps_ns", "poses_odom_lidar", "step_covariance", "drift_covariance", "measured")
    return {"name": trajectory.name, **{name: getattr(trajectory, name).copy() for name in names}}


def test_resampled_at_its_own_stamps_it_is_itself() -> None:
    trajectory = track_of("visual", weaving(20), SIGMA, seed=1, unmeasured=slice(8, 10))
    again = resample_odometry(trajectory, trajectory.stamps_ns)
    np.testing.assert_allclose(again.poses_odom_lidar, trajectory.poses_odom_lidar, atol=1e-12)
    np.testing.assert_allclose(again.drift_covariance, trajectory.drift_covariance)
    np.testing.assert_array_equal(again.measured, trajectory.measured)


def test_resampled_steps_that_overlap_a_dropout_are_not_measured() -> None:
    """Known in [0, 3] and [5, 9] tenths of a second; steps are [0.5, 2.5], [2.5, 4.5], ..."""
    trajectory = track_of("visual", weaving(10), SIGMA, unmeasured=slice(3, 5))
    at = np.array([-0.5, 0.5, 2.5, 4.5, 6.5, 8.5, 9.5])
    chosen = stamps(1)[0] + np.round(at * STEP_NS).astype(np.int64)
    again = resample_odometry(trajectory, chosen)
    np.testing.assert_array_equal(again.measured, [False, True, False, False, True, False])
    # Two steps' worth of drift, whatever they were cut into.
    np.testing.assert_allclose(again.drift_covariance[1], 2.0 * np.diag(np.square(SIGMA)))
    for k in (1, 2, 4, 5):
        at_k = trajectory.pose_at(int(chosen[k]))
        if at_k is not None:
            np.testing.assert_allclose(again.poses_odom_lidar[k], at_k, atol=1e-12)


def test_resampled_a_step_that_ends_inside_a_dropout_is_not_measured() -> None:
    trajectory = track_of("visual", weaving(10), SIGMA, unmeasured=slice(3, 4))
    at = stamps(1)[0] + np.array([1, 5, 7, 9, 11]) * (STEP_NS // 2)
    np.testing.assert_array_equal(
        resample_odometry(trajectory, at).measured, [True, False, False, True]
    )
