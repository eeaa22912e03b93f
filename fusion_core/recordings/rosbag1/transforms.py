"""tf messages of ROS 1, straight from their bytes.

Recordings hold transforms by the ten thousand, and a reader of any type makes seven objects of
each: more work than all the rest of reading a transform.
"""

import struct

from rosbags.typesys.store import Typestore

from fusion_core.recordings.containers import Payload

_NAMES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
# Of both, where their definition gives the layout below.
_LAYOUT_MD5 = "94810edda583a504dfda3829e70d7eec"
_COUNT = struct.Struct("<I")
# Sequence number, seconds, nanoseconds, and the length of the parent's name.
_HEADER = struct.Struct("<IIII")
# Position, and the rotation as x y z w.
_POSE = struct.Struct("<7d")

# Seconds and nanoseconds of the stamp, parent, child, pose.
TransformRow = tuple[int, int, str, str, tuple[float, ...]]


def is_ros1_tf(store: Typestore, name: str) -> bool:
    """Whether a type is laid out as ``read_transforms`` reads it, by its own definition."""
    return name in _NAMES and store.generate_msgdef(name)[1] == _LAYOUT_MD5


def read_transforms(payload: Payload) -> list[TransformRow]:
    """The transforms of a message. Raises ValueError for bytes that are no tf message."""
    rows = []
    try:
        (count,) = _COUNT.unpack_from(payload, 0)
        at = _COUNT.size
        for _ in range(count):
            _, seconds, nanoseconds, size = _HEADER.unpack_from(payload, at)
            at += _HEADER.size + size
            parent = str(payload[at - size : at], "utf-8")
            (size,) = _COUNT.unpack_from(payload, at)
            at += _COUNT.size + size
            child = str(payload[at - size : at], "utf-8")
            rows.append((seconds, nanoseconds, parent, child, _POSE.unpack_from(payload, at)))
            at += _POSE.size
    except (struct.error, UnicodeDecodeError) as error:
        raise ValueError(f"its bytes are no tf message ({error})") from error
    if at != len(payload):
        raise ValueError(f"its bytes are no tf message (it has {len(payload)} bytes, not {at})")
    return rows
