"""Rows from the bytes of ROS 1 messages, which have no padding; ``rows`` explains why.

Every reader raises ValueError for bytes that do not fit.
"""

import struct
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

import numpy as np

from fusion_core.recordings.containers import Payload
from fusion_core.recordings.messages.rows import PoseRow, ScanRow

_LENGTH = struct.Struct("<I")
# Sequence number, seconds, nanoseconds, and the length of the frame's name.
_HEADER = struct.Struct("<IIII")
_POSE = struct.Struct("<7d")
# Angles, times and limits, and the number of ranges.
_SCAN = struct.Struct("<7fI")
_RANGE = np.dtype("<f4")
# In an Odometry: covariance of the pose, twist, and covariance of the twist.
_AFTER_POSE_BYTES = 8 * (36 + 6 + 36)

_Row = TypeVar("_Row")


def _require_whole_payload(
    read: Callable[[Payload], tuple[_Row, int]],
) -> Callable[[Payload], _Row]:
    """Wrap a reader that returns a row and its end; the row must fill the whole message."""

    @wraps(read)
    def read_whole(payload: Payload) -> _Row:
        try:
            row, end = read(payload)
        except (struct.error, ValueError) as error:
            raise ValueError(f"its bytes do not fit ({error})") from error
        if end != len(payload):
            raise ValueError(f"its bytes do not fit (it has {len(payload)} bytes, not {end})")
        return row

    return read_whole


@_require_whole_payload
def read_scan(payload: Payload) -> tuple[ScanRow, int]:
    """sensor_msgs/LaserScan."""
    seconds, nanoseconds, frame, offset = _header(payload, 0)
    angle_min, _, *numbers, count = _SCAN.unpack_from(payload, offset)
    offset += _SCAN.size
    ranges = np.frombuffer(payload, _RANGE, count, offset)
    offset += ranges.nbytes
    (count,) = _LENGTH.unpack_from(payload, offset)
    offset += _LENGTH.size
    intensities = np.frombuffer(payload, _RANGE, count, offset)
    row = ScanRow._make((seconds, nanoseconds, frame, angle_min, *numbers, ranges, intensities))
    return row, offset + intensities.nbytes


@_require_whole_payload
def read_odometry(payload: Payload) -> tuple[PoseRow, int]:
    """nav_msgs/Odometry."""
    seconds, nanoseconds, parent, offset = _header(payload, 0)
    child, offset = _name(payload, offset)
    numbers = _POSE.unpack_from(payload, offset)
    offset += _POSE.size + _AFTER_POSE_BYTES
    return (seconds, nanoseconds, parent, child, numbers), offset


@_require_whole_payload
def read_pose(payload: Payload) -> tuple[PoseRow, int]:
    """geometry_msgs/PoseStamped."""
    seconds, nanoseconds, parent, offset = _header(payload, 0)
    numbers = _POSE.unpack_from(payload, offset)
    return (seconds, nanoseconds, parent, "", numbers), offset + _POSE.size


@_require_whole_payload
def read_transforms(payload: Payload) -> tuple[list[PoseRow], int]:
    """tf2_msgs/TFMessage, and tf/tfMessage."""
    rows = []
    (count,) = _LENGTH.unpack_from(payload, 0)
    offset = _LENGTH.size
    for _ in range(count):
        seconds, nanoseconds, parent, offset = _header(payload, offset)
        child, offset = _name(payload, offset)
        rows.append((seconds, nanoseconds, parent, child, _POSE.unpack_from(payload, offset)))
        offset += _POSE.size
    return rows, offset


def _header(payload: Payload, offset: int) -> tuple[int, int, str, int]:
    """Seconds, nanoseconds and frame of the header at an offset, and the offset after it."""
    _, seconds, nanoseconds, size = _HEADER.unpack_from(payload, offset)
    offset += _HEADER.size + size
    return seconds, nanoseconds, str(payload[offset - size : offset], "utf-8"), offset


def _name(payload: Payload, offset: int) -> tuple[str, int]:
    (size,) = _LENGTH.unpack_from(payload, offset)
    offset += _LENGTH.size + size
    return str(payload[offset - size : offset], "utf-8"), offset


# By type and the MD5 sum of its definition, which identifies the layout.
READERS = {
    ("sensor_msgs/msg/LaserScan", "90c7ef2dc6895d81024acba2ac42f369"): read_scan,
    ("nav_msgs/msg/Odometry", "cd5e73d190d741a2f92e81eda573aca7"): read_odometry,
    ("geometry_msgs/msg/PoseStamped", "d3812c3cbc69362b77dc0b19b345f8f5"): read_pose,
    ("tf2_msgs/msg/TFMessage", "94810edda583a504dfda3829e70d7eec"): read_transforms,
    ("tf/msg/tfMessage", "94810edda583a504dfda3829e70d7eec"): read_transforms,
}
