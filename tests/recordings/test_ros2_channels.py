"""Conversion of channels to ROS 2, with definitions and bytes written by hand."""

import struct

import pytest

from fusion_core.recordings.containers import Channel
from fusion_core.recordings.messages.ros2_channels import Ros2Channel, describe_ros2_channel
from fusion_core.recordings.messages.types import UnreadableType

LINE = "=" * 80 + "\n"
HEADER = f"{LINE}MSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
STAMP = struct.pack("<iI", 7, 8)


def channel(name: str, definition: str = "", serialization: str = "cdr") -> Ros2Channel:
    return describe_ros2_channel(
        Channel(topic="/t", message_type=name, serialization=serialization, definition=definition)
    )


@pytest.mark.parametrize(
    ("name", "cdr", "stamp_ns"),
    [
        ("sensor_msgs/msg/Imu", b"\0\1\0\0" + STAMP, 7_000_000_008),
        ("sensor_msgs/msg/Imu", b"\0\0\0\0" + struct.pack(">iI", 7, 8), 7_000_000_008),
        ("sensor_msgs/msg/Imu", b"\0\1\0\0" + struct.pack("<iI", -1, 8), -999_999_992),
        ("sensor_msgs/msg/Imu", b"\0\1\0\0" + STAMP[:-1], None),
        # Another encapsulation, XCDR2, may have a length before the fields.
        ("sensor_msgs/msg/Imu", b"\0\x09\0\0" + STAMP, None),
        ("sensor_msgs/msg/Imu", b"", None),
        ("tf2_msgs/msg/TFMessage", b"\0\1\0\0\1\0\0\0" + STAMP, 7_000_000_008),
        ("tf2_msgs/msg/TFMessage", b"\0\1\0\0\0\0\0\0", None),
        ("geometry_msgs/msg/Twist", b"\0\1\0\0" + STAMP * 6, None),
        ("lab_msgs/msg/Unknown", b"\0\1\0\0" + STAMP, None),
    ],
)
def test_stamps_in_cdr(name: str, cdr: bytes, stamp_ns: int | None) -> None:
    copied = channel(name)
    assert copied.stamp_ns(cdr) == stamp_ns
    assert copied.to_cdr(cdr) is cdr


def test_ros1_header_without_seq_and_with_alignment() -> None:
    rewritten = channel("lab/msg/Odd", f"Header header\nfloat64 x\n{HEADER}", "ros1")
    ros1 = struct.pack("<III", 99, 7, 8) + struct.pack("<I", 2) + b"ab" + struct.pack("<d", 1.5)
    # A string ends in a zero; numbers are aligned to their size, from behind the encapsulation on.
    string = struct.pack("<I", 3) + b"ab\0" + b"\0"
    expected = b"\0\1\0\0" + STAMP + string + struct.pack("<d", 1.5)
    assert bytes(rewritten.to_cdr(ros1)) == expected
    assert rewritten.stamp_ns(expected) == 7_000_000_008
    for broken in (ros1[:-1], ros1 + b"\0", b"", ros1[:12] + b"\xff" * 4 + ros1[16:]):
        with pytest.raises(ValueError, match="lab/msg/Odd"):
            rewritten.to_cdr(broken)


@pytest.mark.parametrize(
    ("definition", "is_kept"),
    [
        ("geometry_msgs/Pose pose\nfloat64[36] covariance\n", False),
        ("geometry_msgs/Pose pose\nfloat64[9] covariance\n", True),
        ("geometry_msgs/Pose pose\nfloat64[] covariance\n", True),
        ("geometry_msgs/Pose pose\nfloat64[36] covariance\nint8 quality\n", True),
    ],
)
def test_a_definition_that_ros2_cannot_hold_is_kept(definition: str, is_kept: bool) -> None:
    parts = (
        f"{LINE}MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n"
        f"{LINE}MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
        f"{LINE}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    )
    name = "geometry_msgs/msg/PoseWithCovariance"
    rewritten = channel(name, definition + parts, "ros1")
    assert rewritten.message_type == name
    assert ("its own definition is kept" in rewritten.note) is is_kept
    assert definition.splitlines()[-1] in rewritten.definition


def test_tf_of_early_ros1_is_that_of_ros2() -> None:
    text = (
        f"geometry_msgs/TransformStamped[] transforms\n"
        f"{LINE}MSG: geometry_msgs/TransformStamped\n"
        f"Header header\nstring child_frame_id\nTransform transform\n{HEADER}"
        f"{LINE}MSG: geometry_msgs/Transform\nVector3 translation\nQuaternion rotation\n"
        f"{LINE}MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
        f"{LINE}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    )
    rewritten = channel("tf/msg/tfMessage", text, "ros1")
    assert (rewritten.message_type, rewritten.note) == ("tf2_msgs/msg/TFMessage", "")
    assert bytes(rewritten.to_cdr(b"\0\0\0\0")) == b"\0\1\0\0\0\0\0\0"


@pytest.mark.parametrize(
    ("name", "definition", "serialization"),
    [
        ("lab/Log", "", "json"),
        ("", "", "cdr"),
        ("lab/msg/Odd", "lab/Missing x\n", "ros1"),
        ("lab/msg/Odd", "no definition at all", "ros1"),
    ],
)
def test_what_cannot_be_cdr(name: str, definition: str, serialization: str) -> None:
    with pytest.raises(UnreadableType):
        channel(name, definition, serialization)
