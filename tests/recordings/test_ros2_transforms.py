"""tf messages of ROS 2 from their bytes, against rosbags' reader of any type."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from fusion_core.recordings.containers import Channel
from fusion_core.recordings.decode import decode
from fusion_core.recordings.messages.types import deserializer
from fusion_core.recordings.rosbag2.transforms import is_ros2_tf, read_cdr_transforms

NAME = "tf2_msgs/msg/TFMessage"
STORE = get_typestore(Stores.ROS2_HUMBLE)
ROW = (2, 3, "map", "base", *[0.5] * 6)

numbers = st.floats(-1e6, 1e6)
seconds = st.integers(0, 2**31 - 3)
entries = st.tuples(seconds, st.integers(0, 2**32 - 1), st.text(), st.text(), *[numbers] * 6)


def message(rows: list[tuple[Any, ...]]) -> Any:
    t = STORE.types
    return t[NAME](
        transforms=[
            t["geometry_msgs/msg/TransformStamped"](
                header=t["std_msgs/msg/Header"](
                    stamp=t["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec),
                    frame_id=parent,
                ),
                child_frame_id=child,
                transform=t["geometry_msgs/msg/Transform"](
                    translation=t["geometry_msgs/msg/Vector3"](x=px, y=py, z=pz),
                    rotation=t["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=1.0),
                ),
            )
            for sec, nanosec, parent, child, px, py, pz, x, y, z in rows
        ]
    )


@given(st.lists(entries, max_size=4), st.booleans(), st.integers(0, 3))
def test_the_same_as_through_objects(
    rows: list[tuple[Any, ...]], little_endian: bool, padding_bytes: int
) -> None:
    written = STORE.serialize_cdr(message(rows), NAME, little_endian=little_endian)
    payload = bytes(written) + bytes(padding_bytes)
    direct = read_cdr_transforms(payload)
    assert direct == read_cdr_transforms(memoryview(payload))
    general = STORE.deserialize_cdr(payload, NAME)
    a, b = (decode(raw, NAME, topic="/tf", received_ns=5) for raw in (direct, general))
    assert len(a.transforms) == len(b.transforms) == len(rows)
    for one, other in zip(a.transforms, b.transforms, strict=True):
        assert (one.stamp_ns, one.parent, one.child) == (
            other.stamp_ns,
            other.parent,
            other.child,
        )
        assert np.array_equal(one.T_parent_child, other.T_parent_child)


def test_bytes_that_do_not_fit() -> None:
    payload = bytes(STORE.serialize_cdr(message([ROW] * 2), NAME))
    for end in range(len(payload)):
        with pytest.raises(ValueError, match="no tf message"):
            read_cdr_transforms(payload[:end])
    with pytest.raises(ValueError, match="no tf message"):
        read_cdr_transforms(payload + bytes(4))
    with pytest.raises(ValueError, match="no tf message"):
        read_cdr_transforms(payload[:4] + b"\xff" * 64)
    with pytest.raises(ValueError, match="encapsulation"):
        read_cdr_transforms(b"\0\3" + payload[2:])
    with pytest.raises(ValueError, match="utf-8"):
        read_cdr_transforms(payload.replace(b"map\0", b"\xff\xff\xff\0"))
    with pytest.raises(ValueError, match="end with zero"):
        read_cdr_transforms(payload.replace(b"map\0", b"mapx"))


def test_only_for_its_own_layout() -> None:
    assert is_ros2_tf(STORE, NAME)
    assert not is_ros2_tf(STORE, "geometry_msgs/msg/TransformStamped")
    text, _ = STORE.generate_msgdef(NAME, ros_version=2)
    other = text.replace("string child_frame_id\n", "string child_frame_id\nuint8 quality\n")
    assert other != text
    for definition, is_direct in ((text, True), (other, False), ("", True)):
        channel = Channel(
            topic="/tf", message_type=NAME, serialization="cdr", definition=definition
        )
        assert (deserializer(channel) is read_cdr_transforms) is is_direct
