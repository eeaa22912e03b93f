"""A recording's topics when its messages are compressed, of new types or unusable."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from fusion_core.model.sensors import ColorImage, DepthImage, JointSample, PointCloud
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.info import describe_recording
from fusion_core.recordings.topics import choose_streams

STORE = get_typestore(Stores.ROS2_HUMBLE)


def ros(kind: str, **values: Any) -> Any:
    return STORE.types[kind](**values)


def header() -> Any:
    stamp = ros("builtin_interfaces/msg/Time", sec=1, nanosec=0)
    return ros("std_msgs/msg/Header", stamp=stamp, frame_id="camera")


def packed(format: str, pixels: np.ndarray | None) -> Any:
    """A PNG image, or four bytes that are none."""
    data = np.zeros(4, np.uint8) if pixels is None else cv2.imencode(".png", pixels)[1].ravel()
    return ros("sensor_msgs/msg/CompressedImage", header=header(), format=format, data=data)


def camera_info(focal: float) -> Any:
    return ros(
        "sensor_msgs/msg/CameraInfo",
        header=header(),
        height=24,
        width=32,
        distortion_model="",
        d=np.zeros(0),
        k=np.array([focal, 0.0, 16.0, 0.0, focal, 12.0, 0.0, 0.0, 1.0]),
        r=np.eye(3).ravel(),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=ros(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        ),
    )


def written(path: Path, topics: dict[str, list[Any]]) -> Path:
    file = path / "a.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__
            definition = STORE.generate_msgdef(kind, ros_version=2)[0].encode()
            schema = writer.register_schema(kind, "ros2msg", definition)
            channel = writer.register_channel(topic, "cdr", schema)
            for message in messages:
                data = bytes(STORE.serialize_cdr(message, kind))
                writer.add_message(channel, log_time=1, publish_time=1, data=data)
        writer.finish()
    return file


DEPTH = np.full((24, 32), 1500, np.uint16)
RGB = np.full((24, 32, 3), 100, np.uint8)


def test_packed_copies_of_an_image_are_the_same_camera(tmp_path: Path) -> None:
    color, copy, other = (f"/cam/{name}" for name in ("color/compressed", "depth/compressed", "x"))
    depth = "/cam/depth/compressedDepth"
    topics = {
        # A broken first message does not decide what the topic is.
        color: [packed("jpeg", None), packed("jpeg", RGB)],
        copy: [packed("16UC1; png compressed", DEPTH)],
        depth: [packed("16UC1; compressedDepth png", DEPTH)],
        other: [packed("h264", None)],
        "/cam/camera_info": [camera_info(30.0)],
    }
    with open_recording(written(tmp_path, topics)) as recording:
        roles = {topic.name: topic.role for topic in recording.topics}
        streams = choose_streams(recording)
        found = list(recording.messages([color, depth]))
        warnings = " ".join(recording.warnings)
    assert roles == {
        color: "color",
        copy: "depth",
        depth: "depth",
        other: "other",
        "/cam/camera_info": "camera_info",
    }
    assert streams.depth == (copy,)
    assert streams.color == (color,)
    assert streams.camera_info == ("/cam/camera_info",)
    assert streams.notes == (f"{depth} repeats the images of {copy}.",)
    assert [type(m.value) for m in found] == [ColorImage, DepthImage]
    assert f"{color}: 1 of 2 messages are left out" in warnings
    assert f"{other} is left out" in warnings


def test_points_and_joints(tmp_path: Path) -> None:
    fields = [
        ros("sensor_msgs/msg/PointField", name=name, offset=4 * place, datatype=7, count=1)
        for place, name in enumerate(["x", "y", "z", "intensity"])
    ]
    cloud = ros(
        "sensor_msgs/msg/PointCloud2",
        header=header(),
        height=1,
        width=2,
        fields=fields,
        is_bigendian=False,
        point_step=16,
        row_step=32,
        data=np.arange(1, 9, dtype="<f4").view(np.uint8),
        is_dense=True,
    )
    joints = ros(
        "sensor_msgs/msg/JointState",
        header=header(),
        name=["left_wheel", "right_wheel"],
        position=np.array([0.5, 1.5]),
        velocity=np.zeros(0),
        effort=np.zeros(0),
    )
    topics = {"/joint_states": [joints], "/velodyne_points": [cloud]}
    with open_recording(written(tmp_path, topics)) as recording:
        assert [topic.role for topic in recording.topics] == ["joints", "points"]
        found = [message.value for message in recording.messages()]
        assert recording.warnings == []
    assert isinstance(found[0], JointSample)
    assert found[0].names == ("left_wheel", "right_wheel")
    assert found[0].positions.tolist() == [0.5, 1.5]
    assert found[0].velocities is None
    assert isinstance(found[1], PointCloud)
    assert found[1].xyz_m.tolist() == [[1, 2, 3], [5, 6, 7]]
    assert found[1].intensity.tolist() == [4, 8]


@pytest.mark.parametrize("focal", [np.nan, np.inf, -30.0])
def test_a_camera_whose_intrinsics_cannot_be_used(tmp_path: Path, focal: float) -> None:
    """It counts as one without intrinsics, and the description says why."""
    topics = {
        "/cam/depth": [packed("16UC1; png compressed", DEPTH)],
        "/cam/camera_info": [camera_info(focal)] * 7,
    }
    with open_recording(written(tmp_path, topics)) as recording:
        streams = choose_streams(recording)
        can = describe_recording(recording)["can"]
        assert list(recording.messages(["/cam/camera_info"])) == []
        assert "7 of 7 messages are left out" in recording.warnings[0]
    assert streams.depth == ("/cam/depth",)
    assert streams.camera_info == (None,)
    assert len(streams.notes) == 1
    assert streams.notes[0].startswith("/cam/camera_info is not used: ")
    assert f"{focal:g}" in streams.notes[0]
    assert streams.notes[0] in can


def test_an_unusable_camera_info_loses_only_itself(tmp_path: Path) -> None:
    topics = {
        "/cam/depth": [packed("16UC1; png compressed", DEPTH)],
        "/cam/camera_info": [camera_info(np.nan), camera_info(30.0)],
    }
    with open_recording(written(tmp_path, topics)) as recording:
        streams = choose_streams(recording)
        [message] = recording.messages(["/cam/camera_info"])
    assert streams.camera_info == ("/cam/camera_info",)
    assert streams.notes == ()
    assert message.index == 1
    assert message.value.intrinsics.fx == 30.0
