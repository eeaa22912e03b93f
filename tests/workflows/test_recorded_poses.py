"""Where the LiDAR was, by what the recording says of it."""

import numpy as np
import pytest

from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.errors import MissingStream
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.recorded_poses import recorded_poses

SPEED_M_S, TURN_RAD_S = 0.5, 0.4


def poses_of(log, *, pose=None):
    recording = log.open()
    return recorded_poses(recording, choose_streams(recording, pose=pose), "laser")


def x_and_yaw(at_ms):
    return SPEED_M_S * at_ms * 1e-3, TURN_RAD_S * at_ms * 1e-3


@pytest.fixture
def moving(log, pose_of):
    """A scan, an image, and a way to write a drive: 50 ms apart, for a second."""
    log.scan(0.0)
    log.image(0.0)

    def drive(write):
        for at_ms in np.arange(0.0, 1001.0, 50.0):
            x, yaw = x_and_yaw(at_ms)
            write(at_ms, pose_of(x, 0.0, 0.1, yaw=yaw))

    return log, drive


def at(poses, log, at_ms):
    return poses.at(log.start_ns + round(at_ms * NS_PER_MS))


def localised(moving, pose_of):
    """A log with map -> odom -> base -> laser, in which the localisation jumps by a metre."""
    log, drive = moving
    log.transform("base", "laser", pose_of(0.2, 0.0, 0.3, yaw=0.1))
    log.transform("map", "odom", pose_of(5.0), at_ms=0.0)
    log.transform("map", "odom", pose_of(6.0), at_ms=1000.0)
    drive(lambda at_ms, T: log.transform("/odom", "/base", T, at_ms=at_ms))
    drive(lambda at_ms, T: log.pose("/odom", at_ms, pose_of(99.0), child="base"))
    return log


def lidar_on_its_way(at_ms, from_x_m):
    x, yaw = x_and_yaw(at_ms)
    return [from_x_m + x + 0.2 * np.cos(yaw), 0.2 * np.sin(yaw), yaw + 0.1]


def test_odometry_is_read_from_the_odom_frame_and_not_from_the_map(moving, pose_of):
    log = localised(moving, pose_of)
    recording = log.open()
    poses = recorded_poses(recording, choose_streams(recording), "laser")
    assert poses.source == "/tf (odom to laser)"
    for at_ms in (0.0, 50.0, 475.0, 910.0):
        np.testing.assert_allclose(at(poses, log, at_ms), lidar_on_its_way(at_ms, 0.0), atol=1e-4)
    assert at(poses, log, -20.0) is None
    assert at(poses, log, 1020.0) is None
    (warning,) = [line for line in recording.warnings if "REP 105" in line]
    assert warning.startswith("/tf: poses in the frame map ")
    assert "--pose map" in warning


def test_a_map_frame_serves_where_it_is_named(moving, pose_of):
    log = localised(moving, pose_of)
    recording = log.open()
    poses = recorded_poses(recording, choose_streams(recording, pose="map"), "laser")
    assert poses.source == "/tf (map to laser)"
    assert not any("REP 105" in line for line in recording.warnings)
    for at_ms in (0.0, 475.0, 910.0):
        expected = lidar_on_its_way(at_ms, 5.0 + at_ms * 1e-3)
        np.testing.assert_allclose(at(poses, log, at_ms), expected, atol=1e-4)


@pytest.mark.parametrize("frame", ["map", "earth", "world"])
def test_localisation_alone_is_no_recorded_motion(moving, pose_of, frame):
    log, drive = moving
    log.transform("base", "laser", pose_of())
    drive(lambda at_ms, T: log.transform(frame, "base", T, at_ms=at_ms))
    recording = log.open()
    assert recorded_poses(recording, choose_streams(recording), "laser") is None
    assert any(f"--pose {frame}" in line for line in recording.warnings)
    named = poses_of(log, pose=frame)
    assert at(named, log, 500.0)[0] == pytest.approx(x_and_yaw(500.0)[0], abs=1e-4)


def test_a_chain_to_odom_by_way_of_the_map_is_the_localisations(moving, pose_of):
    log, drive = moving
    log.transform("base", "laser", pose_of())
    drive(lambda at_ms, T: log.transform("map", "base", T, at_ms=at_ms))
    for at_ms in (0.0, 1000.0):
        log.transform("odom", "map", pose_of(1.0), at_ms=at_ms)
    drive(lambda at_ms, T: log.pose("/odom", at_ms, pose_of(99.0), child="base"))
    assert poses_of(log).source == "/odom"


def test_odometry_in_the_map_frame_is_a_localisations_too(moving):
    log, drive = moving
    drive(lambda at_ms, T: log.pose("/filtered", at_ms, T, child="laser", parent="map"))
    recording = log.open()
    assert recorded_poses(recording, choose_streams(recording), "laser") is None
    assert any("--pose /filtered" in line for line in recording.warnings)
    assert poses_of(log, pose="/filtered").source == "/filtered"


@pytest.mark.parametrize("frame", ["mapp", "island"])
def test_a_named_frame_must_lead_to_the_lidar(moving, pose_of, frame):
    log = localised(moving, pose_of)
    log.transform("island", "tree", pose_of(), at_ms=0.0)
    with pytest.raises(MissingStream, match=f"'{frame}' is no topic, and no frame"):
        poses_of(log, pose=frame)


def test_tf_without_a_map_hangs_on_the_odometry_frame(moving, pose_of):
    log, drive = moving
    drive(lambda at_ms, T: log.transform("/odom", "/base", T, at_ms=at_ms))
    log.transform("/base", "/laser", pose_of(0.2))
    poses = poses_of(log)
    assert poses.source == "/tf (odom to laser)"
    np.testing.assert_allclose(at(poses, log, 0.0), [0.2, 0.0, 0.0], atol=1e-12)


def test_odometry_is_carried_to_the_lidar_by_static_transforms(moving, pose_of):
    log, drive = moving
    log.transform("base", "laser", pose_of(0.2, 0.1, yaw=0.5))
    drive(lambda at_ms, T: log.pose("/odom", at_ms, T, child="base"))
    poses = poses_of(log)
    assert poses.source == "/odom"
    x, yaw = x_and_yaw(300.0)
    cos, sin = np.cos(yaw), np.sin(yaw)
    expected = [x + 0.2 * cos - 0.1 * sin, 0.2 * sin + 0.1 * cos, yaw + 0.5]
    np.testing.assert_allclose(at(poses, log, 300.0), expected, atol=1e-12)


def test_odometry_of_a_body_that_nothing_joins_says_what_it_is_taken_for(moving):
    log, drive = moving
    drive(lambda at_ms, T: log.pose("/odom", at_ms, T, child="base"))
    poses = poses_of(log)
    assert "/odom" in poses.source
    assert "base, taken as laser" in poses.source
    x, yaw = x_and_yaw(300.0)
    np.testing.assert_allclose(at(poses, log, 300.0), [x, 0.0, yaw], atol=1e-12)


def test_a_tf_that_never_reaches_the_lidar_leaves_the_work_to_odometry(moving, pose_of):
    log, drive = moving
    drive(lambda at_ms, T: log.transform("odom", "base", T, at_ms=at_ms))
    drive(lambda at_ms, T: log.pose("/odom", at_ms, T, child="base"))
    assert poses_of(log).source.startswith("/odom")


@pytest.mark.parametrize("child", ["", "laser"])
def test_a_truth_is_never_used_unless_named(moving, child):
    log, drive = moving
    drive(lambda at_ms, T: log.pose("/ground_truth", at_ms, T, child=child))
    assert poses_of(log) is None
    poses = poses_of(log, pose="/ground_truth")
    assert poses.source == "/ground_truth"
    x, yaw = x_and_yaw(425.0)
    np.testing.assert_allclose(at(poses, log, 425.0), [x, 0.0, yaw], atol=1e-4)


def test_a_named_topic_goes_before_tf_and_odometry(moving, pose_of):
    log, drive = moving
    log.transform("base", "laser", pose_of())
    drive(lambda at_ms, T: log.transform("odom", "base", pose_of(7.0), at_ms=at_ms))
    drive(lambda at_ms, T: log.pose("/odom", at_ms, pose_of(8.0), child="base"))
    drive(lambda at_ms, T: log.pose("/slam/pose", at_ms, T))
    assert at(poses_of(log), log, 500.0)[0] == pytest.approx(7.0)
    named = poses_of(log, pose="/slam/pose")
    assert named.source == "/slam/pose"
    assert at(named, log, 500.0)[0] == pytest.approx(x_and_yaw(500.0)[0])


def test_a_recording_without_motion_has_no_poses(moving):
    log, _ = moving
    assert poses_of(log) is None


def test_a_topic_that_is_not_there_is_named(moving):
    log, _ = moving
    with pytest.raises(MissingStream, match="/nowhere"):
        poses_of(log, pose="/nowhere")
    # Without TF there is no frame to name.
    with pytest.raises(MissingStream, match="has no topic 'nowhere'"):
        poses_of(log, pose="nowhere")
