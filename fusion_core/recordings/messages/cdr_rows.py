"""Rows from the CDR bytes of ROS 2 messages; ``rows`` explains why.

CDR aligns a number to a multiple of its size, counted from the end of the encapsulation header.
Every reader raises ValueError for bytes that do not fit.
"""

import struct
from collections.abc import Callable
from functools import wraps
from typing import NamedTuple, TypeVar

import numpy as np

from fusion_core.recordings.containers import Payload
from fusion_core.recordings.messages.rows import PoseRow, ScanRow

_ENCAPSULATION_BYTES = 4
_COUNT_BYTES = 4
_NUMBER_BYTES = 8
# In an Odometry: covariance of the pose, twist, and covariance of the twist.
_AFTER_POSE_BYTES = 8 * (36 + 6 + 36)
# DDS pads a message to a multiple of four bytes.
_MAX_PADDING = 3


class _ByteOrder(NamedTuple):
    """Formats of numbers in one byte order."""

    length: struct.Struct
    # Seconds, nanoseconds, and the length of the frame's name with its terminating zero.
    header: struct.Struct
    pose: struct.Struct
    # Angles, times and limits, and the number of ranges.
    scan: struct.Struct
    range: np.dtype[np.float32]


# Indexed by the second byte of the encapsulation; the first is zero in plain CDR.
_BYTE_ORDERS = [
    _ByteOrder(
        length=struct.Struct(f"{sign}I"),
        header=struct.Struct(f"{sign}iII"),
        pose=struct.Struct(f"{sign}7d"),
        scan=struct.Struct(f"{sign}7fI"),
        range=np.dtype(f"{sign}f4"),
    )
    for sign in "><"
]

_Row = TypeVar("_Row")


def _require_whole_payload(
    read: Callable[[Payload, _ByteOrder], tuple[_Row, int]],
) -> Callable[[Payload], _Row]:
    """Wrap a reader that returns a row and its end; the row must fill the whole message."""

    @wraps(read)
    def read_whole(payload: Payload) -> _Row:
        if (
            len(payload) < _ENCAPSULATION_BYTES
            or payload[0] != 0
            or payload[1] >= len(_BYTE_ORDERS)
        ):
            raise ValueError("its bytes do not fit (their encapsulation is not plain CDR)")
        try:
            row, end = read(payload, _BYTE_ORDERS[payload[1]])
        except (struct.error, ValueError) as error:
            raise ValueError(f"its bytes do not fit ({error})") from error
        if not 0 <= len(payload) - end <= _MAX_PADDING:
            raise ValueError(f"its bytes do not fit (it has {len(payload)} bytes, not {end})")
        return row

    return read_whole


@_require_whole_payload
def read_scan(payload: Payload, order: _ByteOrder) -> tuple[ScanRow, int]:
    """sensor_msgs/msg/LaserScan."""
    seconds, nanoseconds, frame, offset = _header(payload, _ENCAPSULATION_BYTES, order)
    offset += -offset % _COUNT_BYTES
    angle_min, _, *numbers, count = order.scan.unpack_from(payload, offset)
    offset += order.scan.size
    ranges = np.frombuffer(payload, order.range, count, offset)
    offset += ranges.nbytes
    (count,) = order.length.unpack_from(payload, offset)
    offset += order.length.size
    intensities = np.frombuffer(payload, order.range, count, offset)
    row = ScanRow._make((seconds, nanoseconds, frame, angle_min, *numbers, ranges, intensities))
    return row, offset + intensities.nbytes


@_require_whole_payload
def read_odometry(payload: Payload, order: _ByteOrder) -> tuple[PoseRow, int]:
    """nav_msgs/msg/Odometry."""
    seconds, nanoseconds, parent, offset = _header(payload, _ENCAPSULATION_BYTES, order)
    child, offset = _name(payload, offset, order)
    numbers, offset = _pose(payload, offset, order)
    return (seconds, nanoseconds, parent, child, numbers), offset + _AFTER_POSE_BYTES


@_require_whole_payload
def read_pose(payload: Payload, order: _ByteOrder) -> tuple[PoseRow, int]:
    """geometry_msgs/msg/PoseStamped."""
    seconds, nanoseconds, parent, offset = _header(payload, _ENCAPSULATION_BYTES, order)
    numbers, offset = _pose(payload, offset, order)
    return (seconds, nanoseconds, parent, "", numbers), offset


@_require_whole_payload
def read_transforms(payload: Payload, order: _ByteOrder) -> tuple[list[PoseRow], int]:
    """tf2_msgs/msg/TFMessage."""
    rows = []
    (count,) = order.length.unpack_from(payload, _ENCAPSULATION_BYTES)
    offset = _ENCAPSULATION_BYTES + order.length.size
    for _ in range(count):
        seconds, nanoseconds, parent, offset = _header(
            payload, offset + -offset % _COUNT_BYTES, order
        )
        child, offset = _name(payload, offset, order)
        numbers, offset = _pose(payload, offset, order)
        rows.append((seconds, nanoseconds, parent, child, numbers))
    return rows, offset


def _header(payload: Payload, offset: int, order: _ByteOrder) -> tuple[int, int, str, int]:
    """Seconds, nanoseconds and frame of the header at an offset, and the offset after it."""
    seconds, nanoseconds, size = order.header.unpack_from(payload, offset)
    offset += order.header.size + size
    return seconds, nanoseconds, _text(payload, offset, size), offset


def _name(payload: Payload, offset: int, order: _ByteOrder) -> tuple[str, int]:
    offset += -offset % _COUNT_BYTES
    (size,) = order.length.unpack_from(payload, offset)
    offset += order.length.size + size
    return _text(payload, offset, size), offset


def _pose(payload: Payload, offset: int, order: _ByteOrder) -> tuple[tuple[float, ...], int]:
    offset += -(offset - _ENCAPSULATION_BYTES) % _NUMBER_BYTES
    return order.pose.unpack_from(payload, offset), offset + order.pose.size


def _text(payload: Payload, end: int, size: int) -> str:
    """A name of ``size`` bytes, the last of them zero."""
    if size == 0 or payload[end - 1 : end] != b"\0":
        raise ValueError("a name does not end with zero")
    return str(payload[end - size : end - 1], "utf-8")


# By type and the RIHS01 hash of its definition, which identifies the layout.
READERS = {
    (name, f"RIHS01_{sha256}"): reader
    for name, sha256, reader in (
        (
            "sensor_msgs/msg/LaserScan",
            "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
            read_scan,
        ),
        (
            "nav_msgs/msg/Odometry",
            "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
            read_odometry,
        ),
        (
            "geometry_msgs/msg/PoseStamped",
            "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
            read_pose,
        ),
        (
            "tf2_msgs/msg/TFMessage",
            "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
            read_transforms,
        ),
    )
}
