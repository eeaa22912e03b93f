"""Rows straight from the bytes of ROS 1, whose fields stand side by side without padding.

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
# Of an Odometry: the pose's covariance, the twist, and the twist's covariance.
_AFTER_POSE_BYTES = 8 * (36 + 6 + 36)

_Row = TypeVar("_Row")


def _require_whole_payload(
    read: Callable[[Payload], tuple[_Row, int]],
) -> Callable[[Payload], _Row]:
    """Of a reader that gives a row and its end, one whose row fills the message."""

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
    seconds, nanoseconds, frame, at = _header(payload, 0)
    angle_min, _, *numbers, count = _SCAN.unpack_from(payload, at)
    at += _SCAN.size
    ranges = np.frombuffer(payload, _RANGE, count, at)
    at += ranges.nbytes
    (count,) = _LENGTH.unpack_from(payload, at)
    at += _LENGTH.size
    intensities = np.frombuffer(payload, _RANGE, count, at)
    row = ScanRow._make((seconds, nanoseconds, frame, angle_min, *numbers, ranges, intensities))
    return row, at + intensities.nbytes


@_require_whole_payload
def read_odometry(payload: Payload) -> tuple[PoseRow, int]:
    """nav_msgs/Odometry."""
    seconds, nanoseconds, parent, at = _header(payload, 0)
    child, at = _name(payload, at)
    numbers = _POSE.unpack_from(payload, at)
    at += _POSE.size + _AFTER_POSE_BYTES
    return (seconds, nanoseconds, parent, child, numbers), at


@_require_whole_payload
def read_pose(payload: Payload) -> tuple[PoseRow, int]:
    """geometry_msgs/PoseStamped."""
    seconds, nanoseconds, parent, at = _header(payload, 0)
    numbers = _POSE.unpack_from(payload, at)
    return (seconds, nanoseconds, parent, "", numbers), at + _POSE.size


@_require_whole_payload
def read_transforms(payload: Payload) -> tuple[list[PoseRow], int]:
    """tf2_msgs/TFMessage, and tf/tfMessage."""
    rows = []
    (count,) = _LENGTH.unpack_from(payload, 0)
    at = _LENGTH.size
    for _ in range(count):
        seconds, nanoseconds, parent, at = _header(payload, at)
        child, at = _name(payload, at)
        rows.append((seconds, nanoseconds, parent, child, _POSE.unpack_from(payload, at)))
        at += _POSE.size
    return rows, at


def _header(payload: Payload, at: int) -> tuple[int, int, str, int]:
    """Seconds, nanoseconds and frame of the header at a place, and the place behind it."""
    _, seconds, nanoseconds, size = _HEADER.unpack_from(payload, at)
    at += _HEADER.size + size
    return seconds, nanoseconds, str(payload[at - size : at], "utf-8"), at


def _name(payload: Payload, at: int) -> tuple[str, int]:
    (size,) = _LENGTH.unpack_from(payload, at)
    at += _LENGTH.size + size
    return str(payload[at - size : at], "utf-8"), at


# By type and the MD5 sum of its definition, which only this layout has.
READERS = {
    ("sensor_msgs/msg/LaserScan", "90c7ef2dc6895d81024acba2ac42f369"): read_scan,
    ("nav_msgs/msg/Odometry", "cd5e73d190d741a2f92e81eda573aca7"): read_odometry,
    ("geometry_msgs/msg/PoseStamped", "d3812c3cbc69362b77dc0b19b345f8f5"): read_pose,
    ("tf2_msgs/msg/TFMessage", "94810edda583a504dfda3829e70d7eec"): read_transforms,
    ("tf/msg/tfMessage", "94810edda583a504dfda3829e70d7eec"): read_transforms,
}
