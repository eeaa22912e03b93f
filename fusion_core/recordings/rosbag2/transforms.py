"""tf messages of ROS 2, straight from their bytes in CDR.

As for those of ROS 1: the objects that a reader of any type makes are most of the work.
"""

import struct

from rosbags.typesys.store import Typestore

from fusion_core.recordings.containers import Payload
from fusion_core.recordings.rosbag1.transforms import TransformRow

_NAME = "tf2_msgs/msg/TFMessage"
# Of the type, where its definition gives the layout below.
_LAYOUT_HASH = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
_ENCAPSULATION_BYTES = 4
# A number begins at a multiple of its size, counted from behind the encapsulation.
_COUNT_BYTES = 4
_NUMBER_BYTES = 8
_LENGTH = {0: struct.Struct(">I"), 1: struct.Struct("<I")}
# Seconds, nanoseconds, and the length of the parent's name with the zero behind it.
_HEADER = {0: struct.Struct(">iII"), 1: struct.Struct("<iII")}
# Position, and the rotation as x y z w.
_POSE = {0: struct.Struct(">7d"), 1: struct.Struct("<7d")}
# Middleware fills a message up to a multiple of four.
_MAX_PADDING = 3


def is_ros2_tf(store: Typestore, name: str) -> bool:
    """Whether a type is laid out as ``read_cdr_transforms`` reads it, by its own definition."""
    return name == _NAME and store.hash_rihs01(name) == _LAYOUT_HASH


def read_cdr_transforms(payload: Payload) -> list[TransformRow]:
    """The transforms of a message. Raises ValueError for bytes that are no tf message."""
    if payload[:1] != b"\0" or payload[1:2] not in (b"\0", b"\1"):
        raise ValueError("its bytes are no tf message (their encapsulation is not plain CDR)")
    order = payload[1]
    length, header, pose = _LENGTH[order], _HEADER[order], _POSE[order]
    rows = []
    try:
        (count,) = length.unpack_from(payload, _ENCAPSULATION_BYTES)
        at = _ENCAPSULATION_BYTES + _COUNT_BYTES
        for _ in range(count):
            at += -at % _COUNT_BYTES
            seconds, nanoseconds, size = header.unpack_from(payload, at)
            at += header.size + size
            parent = _text(payload, at, size)
            at += -at % _COUNT_BYTES
            (size,) = length.unpack_from(payload, at)
            at += length.size + size
            child = _text(payload, at, size)
            at += -(at - _ENCAPSULATION_BYTES) % _NUMBER_BYTES
            rows.append((seconds, nanoseconds, parent, child, pose.unpack_from(payload, at)))
            at += pose.size
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"its bytes are no tf message ({error})") from error
    if not 0 <= len(payload) - at <= _MAX_PADDING:
        raise ValueError(f"its bytes are no tf message (it has {len(payload)} bytes, not {at})")
    return rows


def _text(payload: Payload, end: int, size: int) -> str:
    """A name of ``size`` bytes, the last of them zero."""
    if size == 0 or payload[end - 1 : end] != b"\0":
        raise ValueError("its bytes are no tf message (a name does not end with zero)")
    return str(payload[end - size : end - 1], "utf-8")
