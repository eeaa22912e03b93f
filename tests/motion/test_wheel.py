"""Recorded odometry at the scans' stamps: gaps, ends, and how it says that it errs."""

import numpy as np
import pytest

from fusion_core.model.conventions import FloatArray
from fusion_core.motion.steps import integrate_steps
from fusion_core.motion.wheel import WheelSettings, wheel_odometry
from tests.motion.simulated_motion import STEP_NS, stamps, weaving

COUNT = 30
STAMPS = stamps(COUNT)
POSES = integrate_steps(weaving(COUNT), np.array([3.0, -2.0, 1.0]))


def recorded(stamp_ns: int) -> FloatArray | None:
    """Known from the third scan to the last but one."""
    place = (stamp_ns - STAMPS[0]) / STEP_NS
    if not 2.0 <= place <= COUNT - 2:
        return None
    return np.array([np.interp(place, np.arange(COUNT), POSES[:, axis]) for axis in range(3)])


def test_outside_the_recording_poses_repeat_and_are_not_measured() -> None:
    trajectory = wheel_odometry(STAMPS, recorded, STAMPS)
    expected = np.ones(COUNT - 1, dtype=np.bool_)
    expected[:2] = expected[-1] = False
    np.testing.assert_array_equal(trajectory.measured, expected)
    np.testing.assert_allclose(trajectory.poses_odom_lidar[2:-1], POSES[2:-1], atol=1e-9)
    np.testing.assert_allclose(trajectory.poses_odom_lidar[0], POSES[2])
    assert trajectory.notes == ("wheel: scans without a pose: 3 outside the recorded odometry.",)


def test_a_gap_in_the_recording_is_not_bridged() -> None:
    """Samples halfway between the scans; from the 10th scan to the 20th there are none."""
    sampled = np.delete(STAMPS + STEP_NS // 2, slice(10, 20))
    trajectory = wheel_odometry(STAMPS, recorded, sampled)
    expected = np.ones(COUNT - 1, dtype=np.bool_)
    expected[:2] = expected[-1] = False
    expected[9 : 20 + 1] = False
    np.testing.assert_array_equal(trajectory.measured, expected)
    assert "11 in its gaps" in trajectory.notes[0]


def test_samples_at_the_scans_stamps_leave_no_gap() -> None:
    """Wheels count on between two scans: where both ends were sampled the step is known."""
    sparse = STAMPS[::10]
    trajectory = wheel_odometry(
        sparse, lambda stamp_ns: POSES[(stamp_ns - STAMPS[0]) // STEP_NS], sparse
    )
    assert trajectory.measured.all()


def test_scale_errors_stay_within_the_drift_covariance_of_a_long_path() -> None:
    """A wheel 3 % too large is off by 3 % of a metre after a metre, and drift says one sigma; its
    single steps are off by 3 % each, which is what their own covariance says."""
    steps = np.tile([0.02, 0.0, 0.0], (50, 1))
    poses = integrate_steps(steps)
    settings = WheelSettings(forward_sigma_per_m=0.03)
    trajectory = wheel_odometry(
        stamps(51), lambda s: poses[(s - STAMPS[0]) // STEP_NS], stamps(51), settings
    )
    assert np.sqrt(trajectory.drift_covariance[:, 0, 0].sum()) == pytest.approx(0.03, rel=1e-3)
    assert np.sqrt(trajectory.step_covariance[:, 0, 0]) == pytest.approx(0.03 * 0.02, rel=0.02)


def test_the_covariance_of_a_step_is_aligned_with_its_direction() -> None:
    """A LiDAR that moves sideways has its uncertainty sideways."""
    poses = integrate_steps(np.tile([0.0, 0.02, 0.0], (5, 1)))
    trajectory = wheel_odometry(stamps(6), lambda s: poses[(s - STAMPS[0]) // STEP_NS], stamps(6))
    assert trajectory.step_covariance[0, 1, 1] > 4.0 * trajectory.step_covariance[0, 0, 0]
