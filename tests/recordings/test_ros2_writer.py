"""The written file as other readers see it. The contract test reads it back with our own."""

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from fusion_core.model.errors import ExportError
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.sensors import (
    DepthImage,
    JointSample,
    LaserScan,
    PointCloud,
    PoseSample,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.messages.bad_message import BadMessage
from fusion_core.recordings.ros2_writer import Ros2McapWriter


def depth(depth_m: np.ndarray, encoding: str) -> DepthImage:
    return DepthImage(
        stamp_ns=7,
        received_ns=None,
        frame_id="camera",
        depth_m=depth_m.astype(np.float32),
        encoding=encoding,
    )


def pose(yaw_rad: float) -> PoseSample:
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    return PoseSample(stamp_ns=1, received_ns=None, parent="odom", child="base", T_parent_child=T)


def rosbags_messages(path: Path) -> list[tuple[str, int, Any]]:
    with AnyReader([path]) as reader:
        return [
            (connection.topic, stamp, reader.deserialize(raw, connection.msgtype))
            for connection, stamp, raw in reader.messages()
        ]


def test_other_readers_see_the_same(build: Callable[[str], Any]) -> None:
    sample = build("mcap of this project")
    expected = [(m.topic, m.received_ns) for m in sample.expected]
    # rosbags orders ties by chunk, not by file: compare as sets of equal times.
    assert sorted((t, at) for t, at, _ in rosbags_messages(sample.path)) == sorted(expected)
    with sample.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        found = [
            (channel.topic, message.log_time, message.publish_time)
            for _, channel, message in reader.iter_messages()
        ]
        summary = reader.get_summary()
    stamps = [(m.topic, m.received_ns, m.stamp_ns) for m in sample.expected]
    assert sorted(found) == sorted(stamps)
    assert summary is not None
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    latched = {
        channel.topic
        for channel in summary.channels.values()
        if "durability: 1" in channel.metadata.get("offered_qos_profiles", "")
    }
    assert latched == {"/tf_static"}


def test_the_same_calls_give_the_same_bytes(build: Callable[[str], Any], tmp_path: Path) -> None:
    first = build("mcap of this project").path.read_bytes()
    (tmp_path / "a.mcap").unlink()
    assert build("mcap of this project").path.read_bytes() == first


@given(
    npst.arrays(
        np.float32,
        (2, 3),
        elements=st.one_of(st.just(np.nan), st.floats(2.0**-10, 65.0, width=32)),
    )
)
def test_depth_round_trip(tmp_path_factory: pytest.TempPathFactory, depth_m: np.ndarray) -> None:
    path = tmp_path_factory.mktemp("depth") / "d.mcap"
    with Ros2McapWriter(path) as writer:
        writer.write_depth("/mm", depth(depth_m, "16UC1"))
        writer.write_depth("/m", depth(depth_m, "32FC1"))
    with open_recording(path) as recording:
        exact, rounded = recording.read("/m", 0).value, recording.read("/mm", 0).value
    np.testing.assert_array_equal(exact.depth_m, depth_m)
    assert exact.encoding == "32FC1"
    assert rounded.encoding == "16UC1"
    # Half a millimetre and the rounding of float32.
    np.testing.assert_allclose(rounded.depth_m, depth_m, atol=0.000505)


@pytest.mark.parametrize("yaw_rad", [0.0, 1.0, -1.0, np.pi / 2, np.pi, -3.1])
def test_odometry_by_rosbags(tmp_path: Path, yaw_rad: float) -> None:
    with Ros2McapWriter(tmp_path / "o.mcap") as writer:
        writer.write_odometry("/odom", pose(yaw_rad))
    _, stamp, message = rosbags_messages(tmp_path / "o.mcap")[0]
    q = message.pose.pose.orientation
    assert 2.0 * np.arctan2(q.z, q.w) == pytest.approx(yaw_rad, abs=1e-12)
    assert q.w >= 0.0
    assert (message.header.frame_id, message.child_frame_id, stamp) == ("odom", "base", 1)


def test_occupancy_grid_by_rosbags(tmp_path: Path) -> None:
    odds = np.array([[0.0, np.nan, 50.0], [-50.0, np.log(3.0), np.nan]])
    grid = OccupancyGrid(resolution_m=0.05, origin_m=(-1.5, 2.0), log_odds=odds)
    with Ros2McapWriter(tmp_path / "g.mcap") as writer:
        writer.write_occupancy_grid("/map", grid, 5_000_000_001)
    _, stamp, message = rosbags_messages(tmp_path / "g.mcap")[0]
    assert stamp == 5_000_000_001
    assert message.data.tolist() == [50, -1, 100, 0, 75, -1]
    assert (message.info.width, message.info.height) == (3, 2)
    assert message.info.resolution == pytest.approx(0.05)
    assert (message.info.origin.position.x, message.info.origin.position.y) == (-1.5, 2.0)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (5, 1)


def test_missing_ranges_are_nan_for_others(tmp_path: Path) -> None:
    scan = LaserScan(
        stamp_ns=1,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=-1.0,
        angle_increment_rad=0.5,
        range_min_m=0.1,
        range_max_m=5.0,
        ranges_m=np.array([1.0, np.nan, 2.0]),
    )
    with Ros2McapWriter(tmp_path / "s.mcap") as writer:
        writer.write_laser_scan("/scan", scan)
    _, _, message = rosbags_messages(tmp_path / "s.mcap")[0]
    np.testing.assert_array_equal(message.ranges, np.array([1.0, np.nan, 2.0], np.float32))
    assert message.angle_max == 0.0
    assert message.intensities.size == 0


@pytest.mark.parametrize("with_intensity", [True, False])
def test_point_clouds(tmp_path: Path, with_intensity: bool) -> None:
    xyz = np.array([[1.0, 2.0, 3.0], [np.nan] * 3, [-4.0, 0.5, 0.0]], np.float32)
    intensity = np.array([7.0, 8.0, np.nan], np.float32) if with_intensity else None
    cloud = PointCloud(stamp_ns=5, received_ns=9, frame_id="lidar", xyz_m=xyz, intensity=intensity)
    with Ros2McapWriter(tmp_path / "p.mcap") as writer:
        writer.write_point_cloud("/points", cloud)
    _, logged, message = rosbags_messages(tmp_path / "p.mcap")[0]
    names = ["x", "y", "z", "intensity"][: 3 + with_intensity]
    assert (logged, message.header.stamp.nanosec, message.header.frame_id) == (9, 5, "lidar")
    assert [(f.name, f.offset, f.datatype) for f in message.fields] == [
        (name, 4 * i, 7) for i, name in enumerate(names)
    ]
    assert (message.height, message.width, message.point_step) == (1, 3, 4 * len(names))
    assert (message.row_step, message.is_dense) == (12 * len(names), False)
    columns = np.frombuffer(message.data, "<f4").reshape(3, -1)
    np.testing.assert_array_equal(columns[:, :3], xyz)
    with open_recording(tmp_path / "p.mcap") as recording:
        value = recording.read("/points", 0).value
    np.testing.assert_array_equal(value.xyz_m, xyz)
    assert (value.intensity is not None) is with_intensity
    if with_intensity:
        np.testing.assert_array_equal(value.intensity, intensity)


@pytest.mark.parametrize("positions", [np.array([1.0, np.nan]), None])
def test_joints(tmp_path: Path, positions: np.ndarray | None) -> None:
    velocities = np.array([0.5, -0.5])
    sample = JointSample(
        stamp_ns=5,
        received_ns=9,
        names=("left", "right"),
        positions=positions,
        velocities=velocities,
    )
    with Ros2McapWriter(tmp_path / "j.mcap") as writer:
        writer.write_joint_state("/joints", sample)
    _, _, message = rosbags_messages(tmp_path / "j.mcap")[0]
    assert (message.name, message.velocity.tolist()) == (["left", "right"], [0.5, -0.5])
    np.testing.assert_array_equal(message.position, [] if positions is None else positions)
    with open_recording(tmp_path / "j.mcap") as recording:
        value = recording.read("/joints", 0).value
    assert (value.positions is None) is (positions is None)
    assert (value.names, value.stamp_ns) == (sample.names, 5)


def test_a_value_that_its_message_cannot_hold_loses_only_itself(tmp_path: Path) -> None:
    def at(stamp_ns: int, received_ns: int | None, child: str = "b") -> TransformBatch:
        entry = Transform(stamp_ns=stamp_ns, parent="a", child=child, T_parent_child=np.eye(4))
        return TransformBatch(received_ns=received_ns, transforms=(entry,))

    with Ros2McapWriter(tmp_path / "t.mcap") as writer:
        for bad in (at(1 << 62, None), at(-1, None), at(1, -1), at(1, 1, "\udc80")):
            with pytest.raises(BadMessage):
                writer.write_transforms("/tf", bad)
        writer.write_transforms("/tf", at(-1, 7))
    with (tmp_path / "t.mcap").open("rb") as stream:
        ((_, _, message),) = make_reader(stream).iter_messages()
    # The message has its stamp before 1970, which the file cannot hold.
    assert (message.log_time, message.publish_time) == (7, 7)
    _, _, seen = rosbags_messages(tmp_path / "t.mcap")[0]
    stamp = seen.transforms[0].header.stamp
    assert (stamp.sec, stamp.nanosec) == (-1, 999_999_999)


def test_the_file_appears_only_when_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"before")
    with Ros2McapWriter(path) as writer:
        writer.write_odometry("/odom", pose(0.0))
        assert path.read_bytes() == b"before"
    assert path.read_bytes() != b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_an_error_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"before")

    def fail() -> None:
        with Ros2McapWriter(path) as writer:
            writer.write_odometry("/odom", pose(0.0))
            raise KeyError("fault of the caller")

    with pytest.raises(KeyError):
        fail()
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    writer = Ros2McapWriter(tmp_path / "a.mcap")
    writer.write_odometry("/odom", pose(0.0))
    with pytest.raises(ExportError, match="No space left"):
        writer.close()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="No such file"):
        Ros2McapWriter(tmp_path / "nowhere" / "a.mcap")


def test_wrong_use(tmp_path: Path) -> None:
    with Ros2McapWriter(tmp_path / "a.mcap") as writer:
        writer.write_odometry("/odom", pose(0.0))
        with pytest.raises(ValueError, match="holds nav_msgs/msg/Odometry"):
            writer.write_pose_stamped("/odom", pose(0.0))
        with pytest.raises(ValueError, match="8UC1"):
            writer.write_depth("/d", depth(np.ones((1, 1)), "8UC1"))
    with pytest.raises(ValueError, match="closed"):
        writer.write_odometry("/odom", pose(0.0))


def test_an_empty_file_and_an_empty_batch(tmp_path: Path) -> None:
    with Ros2McapWriter(tmp_path / "none.mcap"):
        pass
    with open_recording(tmp_path / "none.mcap") as recording:
        assert (recording.topics, recording.start_ns, recording.end_ns) == ((), None, None)
        assert list(recording.messages()) == []
    with Ros2McapWriter(tmp_path / "tf.mcap") as writer:
        writer.write_transforms("/tf", TransformBatch(received_ns=9, transforms=()))
    with open_recording(tmp_path / "tf.mcap") as recording:
        assert recording.read("/tf", 0).stamp_ns == 9
