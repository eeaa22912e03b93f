"""tf messages of ROS 1 from their bytes, against rosbags' reader of any type."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fusion_core.recordings.containers import Channel
from fusion_core.recordings.decode import decode
from fusion_core.recordings.messages.types import deserializer
from fusion_core.recordings.rosbag1.transforms import is_ros1_tf, read_transforms

NAME = "tf2_msgs/msg/TFMessage"
STORE = get_typestore(Stores.ROS1_NOETIC)
OLD_NAME = "tf/msg/tfMessage"
for each in (NAME, OLD_NAME):
    STORE.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", each))

numbers = st.floats(-1e6, 1e6)
u32 = st.integers(0, 2**32 - 1)
entries = st.tuples(u32, st.integers(0, 2**31 - 3), u32, st.text(), st.text(), *[numbers] * 6)


def message(rows: list[tuple[Any, ...]]) -> Any:
    t = STORE.types
    return t[NAME](
        transforms=[
            t["geometry_msgs/msg/TransformStamped"](
                header=t["std_msgs/msg/Header"](
                    seq=seq,
                    stamp=t["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec),
                    frame_id=parent,
                ),
                child_frame_id=child,
                transform=t["geometry_msgs/msg/Transform"](
                    translation=t["geometry_msgs/msg/Vector3"](x=px, y=py, z=pz),
                    rotation=t["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=1.0),
                ),
            )
            for seq, sec, nanosec, parent, child, px, py, pz, x, y, z in rows
        ]
    )


@given(st.lists(entries, max_size=4))
def test_the_same_as_through_objects(rows: list[tuple[Any, ...]]) -> None:
    payload = STORE.serialize_ros1(message(rows), NAME)
    direct = read_transforms(payload)
    assert direct == read_transforms(bytes(payload))
    general = STORE.deserialize_ros1(payload, NAME)
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
    payload = bytes(STORE.serialize_ros1(message([(1, 2, 3, "map", "base", *[0.5] * 6)] * 2), NAME))
    for end in range(len(payload)):
        with pytest.raises(ValueError, match="no tf message"):
            read_transforms(payload[:end])
    with pytest.raises(ValueError, match="no tf message"):
        read_transforms(payload + b"\0")
    with pytest.raises(ValueError, match="no tf message"):
        read_transforms(b"\xff" * len(payload))
    with pytest.raises(ValueError, match="utf-8"):
        read_transforms(payload.replace(b"map", b"\xff\xff\xff"))


def test_only_for_its_own_layout() -> None:
    assert is_ros1_tf(STORE, NAME)
    assert is_ros1_tf(STORE, OLD_NAME)
    assert not is_ros1_tf(STORE, "geometry_msgs/msg/TransformStamped")
    text, _ = STORE.generate_msgdef(NAME)
    other = text.replace("uint32 seq\n", "")
    assert other != text
    for definition, is_direct in ((text, True), (other, False)):
        channel = Channel(
            topic="/tf", message_type=NAME, serialization="ros1", definition=definition
        )
        assert (deserializer(channel) is read_transforms) is is_direct
