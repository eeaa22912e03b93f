"""Laser odometry in a ray-cast room and corridor, with noise unknown to the method."""

from itertools import pairwise

import numpy as np
import pytest

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import MissingStream
from fusion_core.model.planar_poses import compose_poses, relative_pose
from fusion_core.model.sensors import LaserScan
from fusion_core.motion.laser import PUBLISHED, LaserOdometrySettings, laser_odometry
from fusion_core.motion.steps import integrate_steps, steps_between
from fusion_core.registration.pl_icp import PlIcpSettings, ReferenceScan, match_to_reference
from tests.benchmarks.scan_matching_room import WALLS, cast, full_turn, rectangle
from tests.motion.simulated_motion import STEP_NS, stamps, step_errors, weaving

COUNT = 100
BEAMS = 360
ANGLE_MIN, INCREMENT = full_turn(BEAMS)
NOISE_M = 0.01
POSES = integrate_steps(weaving(COUNT, speed_m_s=0.5), np.array([3.0, 4.0, 0.0]))
CORRIDOR = rectangle((0.0, 0.0), (200.0, 2.4), 0.0)


def sweeps(
    poses: FloatArray, walls: FloatArray = WALLS, *, reach_m: float = 30.0, blank: slice = slice(0)
) -> list[LaserScan]:
    """Scans at (N, 3) poses; those of ``blank`` see nothing."""
    angles = ANGLE_MIN + INCREMENT * np.arange(BEAMS)
    random = np.random.default_rng(7)
    scans = []
    for k, pose in enumerate(poses):
        ranges_m = cast(walls, pose, angles)[0]
        ranges_m = np.where(ranges_m < reach_m, ranges_m, np.nan) + random.normal(0, NOISE_M, BEAMS)
        if k in range(*blank.indices(len(poses))):
            ranges_m[:] = np.nan
        scans.append(
            LaserScan(
                stamp_ns=int(stamps(1)[0]) + k * STEP_NS,
                received_ns=None,
                frame_id="laser",
                angle_min_rad=ANGLE_MIN,
                angle_increment_rad=INCREMENT,
                range_min_m=0.1,
                range_max_m=reach_m,
                ranges_m=ranges_m,
            )
        )
    return scans


@pytest.fixture(scope="module")
def room() -> list[LaserScan]:
    return sweeps(POSES)


def test_it_follows_a_path_of_five_metres(room: list[LaserScan]) -> None:
    trajectory = laser_odometry(room)
    assert trajectory.measured.all()
    assert trajectory.notes == ()
    error = relative_pose(
        relative_pose(POSES[0], POSES[-1]), relative_pose(*trajectory.poses_odom_lidar[[0, -1]])
    )
    assert np.hypot(error[0], error[1]) < 0.015
    assert abs(error[2]) < np.deg2rad(0.3)


def test_its_covariances_are_those_of_its_errors(room: list[LaserScan]) -> None:
    """Of single steps, and of two seconds, in which what matches add does not grow with steps."""
    trajectory = laser_odometry(room)
    errors = step_errors(trajectory, steps_between(POSES))
    said = np.sqrt(np.diagonal(trajectory.step_covariance, axis1=1, axis2=2).mean(axis=0))
    ratio = np.sqrt((errors**2).mean(axis=0)) / said
    assert (ratio < 1.5).all()
    assert (ratio > 0.25).all()
    over = 20
    true = relative_pose(POSES[:-over], POSES[over:])
    made = relative_pose(trajectory.poses_odom_lidar[:-over], trajectory.poses_odom_lidar[over:])
    drift = trajectory.drift_covariance[:over].sum(axis=0) + trajectory.step_covariance[0]
    assert np.sqrt(((made - true)[:, 0] ** 2).mean()) < 2.0 * np.sqrt(drift[0, 0])
    # Steps added up as if they were independent would be several times that.
    assert trajectory.step_covariance[:over, 0, 0].sum() > 4.0 * drift[0, 0]


def test_at_standstill_nothing_accumulates() -> None:
    poses = np.tile(POSES[:1], (60, 1))
    trajectory = laser_odometry(sweeps(poses))
    assert np.abs(trajectory.poses_odom_lidar[-1, :2]).max() < 0.006
    assert np.sqrt(trajectory.drift_covariance.sum(axis=0)[0, 0]) < 0.01


def test_blank_scans_are_not_measured_and_counted() -> None:
    trajectory = laser_odometry(sweeps(POSES, blank=slice(40, 44)))
    np.testing.assert_array_equal(np.flatnonzero(~trajectory.measured), np.arange(39, 44))
    assert trajectory.notes == ("laser: 5 steps not measured: 4 too few beams.",)
    # The keyframe outlives them, so that what follows is right again.
    error = relative_pose(
        relative_pose(POSES[0], POSES[-1]), relative_pose(*trajectory.poses_odom_lidar[[0, -1]])
    )
    assert np.hypot(error[0], error[1]) < 0.02


def test_a_kidnapped_robot_starts_a_new_segment() -> None:
    """From one end of the room to a place in another house, which no scan before has shown."""
    elsewhere = rectangle((0.0, 0.0), (3.0, 40.0), 0.4)
    scans = sweeps(POSES[:20]) + sweeps(integrate_steps(weaving(20)), elsewhere)
    moved = [
        LaserScan(**{**_fields(scan), "stamp_ns": int(stamps(1)[0]) + k * STEP_NS})
        for k, scan in enumerate(scans)
    ]
    trajectory = laser_odometry(moved, LaserOdometrySettings(unmatched_scans_max=3))
    assert not trajectory.measured[19]
    assert 1 <= np.count_nonzero(~trajectory.measured) <= 5
    true = steps_between(integrate_steps(weaving(20)))[-5:]
    errors = (trajectory.steps[-5:] - true)[:, 2]
    assert np.abs(errors).max() < 0.01
    assert "not measured" in trajectory.notes[0]


def test_what_the_keyframe_no_longer_shows_the_scan_before_does() -> None:
    """From one room through a door into the next, with no other reason to change the keyframe."""
    walls = np.concatenate(
        [
            rectangle((6.0, 2.5), (12.0, 5.0), 0.0),
            rectangle((6.0, 0.9), (0.2, 1.8), 0.0),
            rectangle((6.0, 4.1), (0.2, 1.8), 0.0),
            rectangle((10.5, 4.2), (1.0, 0.8), 0.3),
        ]
    )
    poses = integrate_steps(np.tile([0.1, 0.0, 0.002], (80, 1)), np.array([1.5, 2.5, -0.05]))
    settings = LaserOdometrySettings(
        keyframe_distance_m=10.0, keyframe_rotation_rad=3.0, keyframe_inlier_ratio=0.0
    )
    trajectory = laser_odometry(sweeps(poses, walls), settings)
    assert trajectory.measured.all()
    error = relative_pose(
        relative_pose(poses[0], poses[-1]), relative_pose(*trajectory.poses_odom_lidar[[0, -1]])
    )
    assert np.hypot(error[0], error[1]) < 0.05


def _fields(scan: LaserScan) -> dict:
    return {name: getattr(scan, name) for name in LaserScan.__dataclass_fields__}


def test_a_corridor_shows_in_the_covariance() -> None:
    """Walls 2.4 m from each other, longer than the range: the pose along them is unobservable."""
    poses = np.tile([0.05, 0.0, 0.0], (COUNT, 1)).cumsum(axis=0) * np.array([1.0, 0.0, 0.0])
    scans = sweeps(poses[:40], CORRIDOR, reach_m=8.0)
    trajectory = laser_odometry(scans)
    sigma = np.sqrt(np.diagonal(trajectory.step_covariance, axis1=1, axis2=2))
    assert np.median(sigma[:, 0]) > 10.0
    assert np.median(sigma[:, 1]) < 0.02
    assert np.median(sigma[:, 2]) < 0.03
    # With the wheels' steps it goes along as they say.
    driven = laser_odometry(
        scans, predicted=lambda stamp_ns: poses[(stamp_ns - scans[0].stamp_ns) // STEP_NS]
    )
    np.testing.assert_allclose(driven.steps[:, 0], 0.05, atol=0.02)


def test_a_prediction_that_is_wrong_does_not_mislead_it(room: list[LaserScan]) -> None:
    """Wheels that spin: 20 cm ahead and 6 degrees too far in each scan."""
    spin = np.array([0.2, 0.0, 0.1])
    wrong = integrate_steps(steps_between(POSES) + spin)
    trajectory = laser_odometry(
        room[:40], predicted=lambda stamp_ns: wrong[(stamp_ns - room[0].stamp_ns) // STEP_NS]
    )
    errors = step_errors(trajectory, steps_between(POSES[:40]))
    assert np.abs(errors[trajectory.measured]).max() < 0.03
    assert trajectory.measured_fraction > 0.9


def test_without_a_scan_there_is_no_odometry() -> None:
    with pytest.raises(MissingStream, match="needs a scan"):
        laser_odometry([])


def test_where_the_first_scan_was_does_not_matter(room: list[LaserScan]) -> None:
    """Steps are in the axes of their poses: a second chain begun later gives the same."""
    early, late = laser_odometry(room[:60]), laser_odometry(room[20:60])
    between = relative_pose(early.poses_odom_lidar[20], early.poses_odom_lidar[-1])
    again = compose_poses(np.zeros(3), late.poses_odom_lidar[-1])
    np.testing.assert_allclose(between, again, atol=0.015)


def test_as_published_each_scan_is_matched_with_the_one_before(room: list[LaserScan]) -> None:
    """Against a loop of matches of neighbours, each from its own guess, chained."""
    pose = np.zeros(3)
    poses = [pose]
    for before, after in pairwise(room[:40]):
        angles = {"angle_min_rad": ANGLE_MIN, "angle_increment_rad": INCREMENT}
        reference = ReferenceScan.of(before.ranges_m, settings=PlIcpSettings(), **angles)
        match = match_to_reference(reference, after.ranges_m, guess=np.zeros(3), **angles)
        pose = compose_poses(pose, match.pose_first_second)
        poses.append(pose)
    chained = np.array(poses)
    published = laser_odometry(room[:40], PUBLISHED).poses_odom_lidar
    # The match depends a little on its guess: which points are paired.
    np.testing.assert_allclose(published, chained, atol=1e-3)
    by_keyframes = laser_odometry(room[:40]).poses_odom_lidar
    assert np.abs(by_keyframes - chained).max() > 3e-3


def test_as_published_its_covariances_are_those_of_its_errors(room: list[LaserScan]) -> None:
    trajectory = laser_odometry(room, PUBLISHED)
    errors = step_errors(trajectory, steps_between(POSES))
    said = np.sqrt(np.diagonal(trajectory.step_covariance, axis1=1, axis2=2).mean(axis=0))
    ratio = np.sqrt((errors**2).mean(axis=0)) / said
    assert (ratio < 1.5).all()
    assert (ratio > 0.25).all()
    # Each match accumulates, so that the drift is far greater than by keyframes.
    np.testing.assert_array_equal(trajectory.drift_covariance, trajectory.step_covariance)
    drift, by_keyframes = (
        of.drift_covariance.sum(axis=0)[0, 0] for of in (trajectory, laser_odometry(room))
    )
    assert drift > 4.0 * by_keyframes


def test_as_published_a_blank_scan_is_bridged_by_the_last_that_saw_something() -> None:
    trajectory = laser_odometry(sweeps(POSES, blank=slice(40, 44)), PUBLISHED)
    np.testing.assert_array_equal(np.flatnonzero(~trajectory.measured), np.arange(39, 44))
    error = relative_pose(
        relative_pose(POSES[0], POSES[-1]), relative_pose(*trajectory.poses_odom_lidar[[0, -1]])
    )
    assert np.hypot(error[0], error[1]) < 0.06
