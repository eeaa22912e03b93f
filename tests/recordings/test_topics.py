"""Roles of topics, and which are chosen where none is named."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.model.errors import MissingStream
from fusion_core.model.recording import Topic
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    LaserScan,
    PoseSample,
)
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.info import describe_recording
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.recordings.topics import choose_streams, role_from_encoding


def scan(at: int) -> LaserScan:
    return LaserScan(
        stamp_ns=at,
        received_ns=at,
        frame_id="laser",
        angle_min_rad=0.0,
        angle_increment_rad=0.5,
        range_min_m=0.0,
        range_max_m=9.0,
        ranges_m=np.ones(3),
    )


def depth(frame: str = "depth") -> DepthImage:
    return DepthImage(
        stamp_ns=1, received_ns=1, frame_id=frame, depth_m=np.ones((3, 4), np.float32)
    )


def color() -> ColorImage:
    rgb = np.zeros((3, 4, 3), np.uint8)
    return ColorImage(stamp_ns=1, received_ns=1, frame_id="color", rgb=rgb)


def info(frame: str, width: int = 4) -> CameraInfo:
    camera = CameraIntrinsics(width=width, height=3, fx=1.0, fy=1.0, cx=1.0, cy=1.0)
    return CameraInfo(stamp_ns=1, received_ns=1, frame_id=frame, intrinsics=camera)


def pose(child: str = "base") -> PoseSample:
    return PoseSample(
        stamp_ns=1, received_ns=1, parent="odom", child=child, T_parent_child=np.eye(4)
    )


@pytest.fixture
def record(tmp_path: Path) -> Callable[..., Any]:
    """Open a recording with the given values on the given topics."""

    def record(**topics: list[Any]) -> Any:
        with Ros2McapWriter(tmp_path / "r.mcap") as writer:
            for name, values in topics.items():
                topic = "/" + name.replace("__", "/")
                for value in values:
                    is_odometry = isinstance(value, PoseSample) and value.child != ""
                    writer.write(topic, value, odometry=is_odometry)
        return open_recording(tmp_path / "r.mcap")

    return record


def test_roles_of_the_sample(build: Callable[[str], Any]) -> None:
    with open_recording(build("mcap zstd").path) as recording:
        assert {topic.name: topic.role for topic in recording.topics} == {
            "/scan": "lidar",
            "/camera/depth/image_raw": "depth",
            "/camera/depth/camera_info": "camera_info",
            "/camera/color/image_raw": "color",
            "/odom": "odometry",
            "/tf": "tf",
            "/tf_static": "tf_static",
            "/ground_truth": "pose",
        }
        streams = choose_streams(recording)
    assert streams.lidar == "/scan"
    assert streams.depth == ("/camera/depth/image_raw",)
    assert streams.color == ("/camera/color/image_raw",)
    assert streams.camera_info == ("/camera/depth/camera_info",)
    assert (streams.odometry, streams.tf, streams.tf_static) == ("/odom", "/tf", "/tf_static")
    assert streams.pose is None
    assert streams.notes == ()


def test_the_encoding_decides_not_the_name(record: Callable[..., Any]) -> None:
    with record(camera__depth=[color()], camera__rgb=[depth()]) as recording:
        roles = {topic.name: topic.role for topic in recording.topics}
    assert roles == {"/camera/depth": "color", "/camera/rgb": "depth"}


@pytest.mark.parametrize(
    ("encoding", "name", "role"),
    [
        ("16UC1", "/anything", "depth"),
        ("32FC1", "/anything", "depth"),
        ("mono16", "/camera/Depth/image", "depth"),
        ("mono16", "/camera/ir/image", "other"),
        ("mono8", "/camera/depth/preview", "color"),
        ("rgb8", "/depth", "color"),
        ("bayer_rggb8", "/color", "other"),
    ],
)
def test_roles_of_images(encoding: str, name: str, role: str) -> None:
    assert role_from_encoding(encoding, name) == role


def test_the_lidar_with_most_messages_is_chosen_and_the_others_named(
    record: Callable[..., Any],
) -> None:
    with record(a_scan=[scan(1)], b_scan=[scan(1), scan(2)], c_scan=[scan(3)]) as recording:
        streams = choose_streams(recording)
        assert streams.lidar == "/b_scan"
        assert streams.notes == ("Of 3 LaserScan topics /b_scan is taken, not /a_scan, /c_scan.",)
        assert choose_streams(recording, lidar="/c_scan").lidar == "/c_scan"
        assert choose_streams(recording, lidar="/c_scan").notes == ()


@pytest.mark.parametrize("name", ["base_pose_ground_truth", "groundtruth__odom"])
def test_ground_truth_is_used_only_if_named(record: Callable[..., Any], name: str) -> None:
    truth = "/" + name.replace("__", "/")
    values = {name: [pose(), pose()], "odom": [pose()]}
    with record(scan=[scan(1)], pose=[pose("")], **values) as recording:
        streams = choose_streams(recording)
        assert streams.odometry == "/odom"
        assert streams.pose is None
        assert choose_streams(recording, odometry=truth).odometry == truth
        assert choose_streams(recording, pose=truth).pose == truth
        assert choose_streams(recording, pose="/pose").pose == "/pose"


def test_ground_truth_alone_is_no_odometry(record: Callable[..., Any]) -> None:
    with record(scan=[scan(1)], truth=[pose()]) as recording:
        assert choose_streams(recording).odometry is None


def test_each_depth_camera_has_its_own_colour_and_intrinsics(record: Callable[..., Any]) -> None:
    with record(
        left__depth__image=[depth()],
        left__depth__camera_info=[info("x")],
        left__color__image=[color()],
        right__depth__image=[depth()],
        right__color__image=[color()],
        right__color__camera_info=[info("color")],
    ) as recording:
        streams = choose_streams(recording)
    assert streams.depth == ("/left/depth/image", "/right/depth/image")
    assert streams.color == ("/left/color/image", "/right/color/image")
    # The right camera's only CameraInfo is of its colour sensor.
    assert streams.camera_info == ("/left/depth/camera_info", None)


@pytest.mark.parametrize(
    ("frame", "width", "found"), [("depth", 4, True), ("depth", 8, False), ("color", 4, False)]
)
def test_intrinsics_elsewhere_must_be_of_the_same_frame_and_size(
    record: Callable[..., Any], frame: str, width: int, found: bool
) -> None:
    with record(image=[depth()], elsewhere__info=[info(frame, width)]) as recording:
        streams = choose_streams(recording)
    assert streams.camera_info == (("/elsewhere/info",) if found else (None,))


def test_a_name_that_is_not_there(record: Callable[..., Any]) -> None:
    with (
        record(scan=[scan(1)], odom=[pose()]) as recording,
        pytest.raises(MissingStream, match="/odom, /scan"),
    ):
        choose_streams(recording, lidar="/laser")


def test_a_name_of_another_kind(record: Callable[..., Any]) -> None:
    with (
        record(scan=[scan(1)], odom=[pose()]) as recording,
        pytest.raises(MissingStream, match="Topics that can: /scan"),
    ):
        choose_streams(recording, lidar="/odom")


def test_as_many_colours_as_depths(record: Callable[..., Any]) -> None:
    with (
        record(a=[depth()], b=[depth()], c=[color()]) as recording,
        pytest.raises(MissingStream, match="1 colour topics are named for 2"),
    ):
        choose_streams(recording, color="/c")


def test_a_depth_topic_is_named_once(record: Callable[..., Any]) -> None:
    with (
        record(a=[depth()]) as recording,
        pytest.raises(MissingStream, match=r"/a is named twice\. Name each depth topic once\."),
    ):
        choose_streams(recording, depth=("/a", "/a"))


def test_depth_topics_can_be_named(record: Callable[..., Any]) -> None:
    with record(a=[depth()], b=[depth()], c=[color()]) as recording:
        assert choose_streams(recording, depth="/b").depth == ("/b",)
        assert choose_streams(recording, depth=["/b", "/a"]).depth == ("/b", "/a")


@pytest.mark.parametrize(
    ("topics", "said"),
    [
        ({"scan": [scan(1)], "d__image": [depth()]}, "can be fused: /scan with /d/image"),
        ({"scan": [scan(1)]}, "cannot be fused: there is /scan, but no depth camera"),
        ({"d__image": [depth()], "d__info": [info("depth")]}, "a virtual LiDAR"),
        ({"d__image": [depth()]}, "a virtual one needs intrinsics"),
        ({"odom": [pose()]}, "neither a 2D LiDAR nor a depth camera"),
        ({"scan": [scan(1)], "odom": [pose()]}, "mapped with the poses of /odom"),
        ({"scan": [scan(1)], "p": [pose("")]}, "only if a pose topic is named: /p"),
    ],
)
def test_capabilities_of_recordings(
    record: Callable[..., Any], topics: dict[str, Any], said: str
) -> None:
    with record(**topics) as recording:
        assert any(said in sentence for sentence in describe_recording(recording)["can"])


def test_rate_needs_two_stamps(record: Callable[..., Any]) -> None:
    with record(a=[scan(0), scan(10**8), scan(2 * 10**8)], b=[scan(0)]) as recording:
        rates = {topic.name: topic.rate_hz for topic in recording.topics}
    assert rates == {"/a": 10.0, "/b": None}
    assert isinstance(recording.topics[0], Topic)
