"""Row readers of frequent message types, against rosbags' reader of any type."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fusion_core.model.sensors import LaserScan, PoseSample, TransformBatch
from fusion_core.recordings.containers import Channel
from fusion_core.recordings.decode import decode_message
from fusion_core.recordings.messages import cdr_rows, ros1_rows
from fusion_core.recordings.messages.types import find_deserializer

SCAN, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
POSE, TF, OLD_TF = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
for name in (TF, OLD_TF):
    ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))


@dataclass(frozen=True)
class Wire:
    """One way of serialising, as rosbags does it, and the readers of rows for it."""

    name: str
    store: Typestore
    serialize: Callable[[Any, str], memoryview]
    deserialize: Callable[[Any, str], Any]
    readers: dict[tuple[str, str], Callable[[Any], Any]]
    padding_bytes: int

    def read(self, payload: bytes | memoryview, name: str) -> Any:
        """By the reader of rows for a type."""
        (reader,) = [reader for (of, _), reader in self.readers.items() if of == name]
        return reader(payload)

    def channel(self, name: str, definition: str = "") -> Channel:
        return Channel(
            topic="/topic", message_type=name, serialization=self.name, definition=definition
        )

    def definition(self, name: str) -> str:
        return self.store.generate_msgdef(name, ros_version=1 if self.name == "ros1" else 2)[0]


PLAIN = Wire("ros1", ROS1, ROS1.serialize_ros1, ROS1.deserialize_ros1, ros1_rows.READERS, 0)
LITTLE = Wire("cdr", ROS2, ROS2.serialize_cdr, ROS2.deserialize_cdr, cdr_rows.READERS, 3)
BIG = Wire(
    "cdr",
    ROS2,
    partial(ROS2.serialize_cdr, little_endian=False),
    ROS2.deserialize_cdr,
    cdr_rows.READERS,
    3,
)
WIRES = pytest.mark.parametrize("wire", [PLAIN, LITTLE, BIG], ids=["ROS 1", "CDR", "big-endian"])
KINDS = pytest.mark.parametrize("name", [SCAN, ODOMETRY, POSE, TF])

numbers = st.floats(-1e6, 1e6)
names = st.text(max_size=9)
stamps = st.tuples(st.integers(0, 2**31 - 3), st.integers(0, 2**32 - 1))
poses = st.tuples(*[numbers] * 6)
floats = st.floats(width=32)
limits = st.tuples(st.floats(0.0, 1.0, width=32), st.floats(2.0, 50.0, width=32))


class Builder:
    """Messages of a store from plain values."""

    def __init__(self, store: Typestore) -> None:
        self.types = store.types
        self.is_ros1 = store is ROS1

    def header(self, stamp: tuple[int, int], frame: str) -> Any:
        time = self.types["builtin_interfaces/msg/Time"](sec=stamp[0], nanosec=stamp[1])
        seq = {"seq": 7} if self.is_ros1 else {}
        return self.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **seq)

    def vector(self, kind: str, xyz: tuple[float, ...]) -> Any:
        return self.types[f"geometry_msgs/msg/{kind}"](x=xyz[0], y=xyz[1], z=xyz[2])

    def rotation(self, xyz: tuple[float, ...]) -> Any:
        return self.types["geometry_msgs/msg/Quaternion"](x=xyz[0], y=xyz[1], z=xyz[2], w=1.0)

    def pose(self, six: tuple[float, ...]) -> Any:
        return self.types["geometry_msgs/msg/Pose"](
            position=self.vector("Point", six), orientation=self.rotation(six[3:])
        )

    def stamped_pose(self, stamp: tuple[int, int], frame: str, six: tuple[float, ...]) -> Any:
        return self.types[POSE](header=self.header(stamp, frame), pose=self.pose(six))

    def odometry(
        self, stamp: tuple[int, int], frame: str, child: str, six: tuple[float, ...]
    ) -> Any:
        covariance = np.arange(36, dtype=np.float64)
        t = self.types
        twist = t["geometry_msgs/msg/Twist"](
            linear=self.vector("Vector3", six), angular=self.vector("Vector3", six)
        )
        return t[ODOMETRY](
            header=self.header(stamp, frame),
            child_frame_id=child,
            pose=t["geometry_msgs/msg/PoseWithCovariance"](
                pose=self.pose(six), covariance=covariance
            ),
            twist=t["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=covariance),
        )

    def transforms(
        self, rows: list[tuple[tuple[int, int], str, str, tuple[float, ...]]], name: str = TF
    ) -> Any:
        t = self.types
        return t[name](
            transforms=[
                t["geometry_msgs/msg/TransformStamped"](
                    header=self.header(stamp, parent),
                    child_frame_id=child,
                    transform=t["geometry_msgs/msg/Transform"](
                        translation=self.vector("Vector3", six), rotation=self.rotation(six[3:])
                    ),
                )
                for stamp, parent, child, six in rows
            ]
        )

    def scan(
        self,
        stamp: tuple[int, int],
        frame: str,
        limits_m: tuple[float, float],
        ranges: list[float],
        intensities: list[float],
    ) -> Any:
        return self.types[SCAN](
            header=self.header(stamp, frame),
            angle_min=-1.0,
            angle_max=1.0,
            angle_increment=0.25,
            time_increment=0.125,
            scan_time=0.5,
            range_min=limits_m[0],
            range_max=limits_m[1],
            ranges=np.array(ranges, dtype=np.float32),
            intensities=np.array(intensities, dtype=np.float32),
        )

    def any_of(self, name: str) -> Any:
        """One message of a type, its frame called map."""
        six = (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
        return {
            SCAN: lambda: self.scan((2, 3), "map", (0.0, 9.0), [1.0, 2.0], [3.0, 4.0]),
            ODOMETRY: lambda: self.odometry((2, 3), "map", "base", six),
            POSE: lambda: self.stamped_pose((2, 3), "map", six),
            TF: lambda: self.transforms([((2, 3), "map", "base", six)] * 2),
        }[name]()


def both_ways(wire: Wire, message: Any, name: str, padding_bytes: int = 0) -> tuple[Any, Any]:
    """The model value by the reader of rows, and by rosbags' objects."""
    payload = bytes(wire.serialize(message, name)) + bytes(padding_bytes)
    raws = [wire.read(memoryview(payload), name), wire.deserialize(payload, name)]
    direct, general = (decode_message(raw, name, topic="/topic", received_ns=5) for raw in raws)
    return direct, general


def assert_same_pose(one: Any, other: Any) -> None:
    assert (one.stamp_ns, one.parent, one.child) == (other.stamp_ns, other.parent, other.child)
    assert np.array_equal(one.T_parent_child, other.T_parent_child)


@WIRES
@given(
    st.lists(st.tuples(stamps, names, names, poses), max_size=4),
    st.integers(0, 3),
    st.sampled_from([TF, OLD_TF]),
)
def test_transforms_are_the_same(
    wire: Wire, rows: list[Any], padding_bytes: int, name: str
) -> None:
    name = name if wire is PLAIN else TF
    message = Builder(wire.store).transforms(rows, name)
    a, b = both_ways(wire, message, name, min(padding_bytes, wire.padding_bytes))
    assert isinstance(a, TransformBatch)
    assert a.received_ns == b.received_ns == 5
    assert len(a.transforms) == len(b.transforms) == len(rows)
    for one, other in zip(a.transforms, b.transforms, strict=True):
        assert_same_pose(one, other)


@WIRES
@given(stamps, names, names, poses, st.integers(0, 3))
def test_poses_are_the_same(
    wire: Wire, stamp: Any, frame: str, child: str, six: Any, padding_bytes: int
) -> None:
    build, padding_bytes = Builder(wire.store), min(padding_bytes, wire.padding_bytes)
    a, b = both_ways(wire, build.odometry(stamp, frame, child, six), ODOMETRY, padding_bytes)
    assert isinstance(a, PoseSample)
    assert_same_pose(a, b)
    a, b = both_ways(wire, build.stamped_pose(stamp, frame, six), POSE, padding_bytes)
    assert a.child == ""
    assert_same_pose(a, b)


@WIRES
@given(
    stamps,
    names,
    limits,
    st.lists(floats, min_size=1, max_size=9),
    st.booleans(),
    st.integers(0, 3),
)
def test_scans_are_the_same(
    wire: Wire,
    stamp: Any,
    frame: str,
    limits_m: Any,
    ranges: list[float],
    with_intensities: bool,
    padding_bytes: int,
) -> None:
    intensities = ranges[::-1] if with_intensities else []
    message = Builder(wire.store).scan(stamp, frame, limits_m, ranges, intensities)
    a, b = both_ways(wire, message, SCAN, min(padding_bytes, wire.padding_bytes))
    assert isinstance(a, LaserScan)
    for field in ("stamp_ns", "received_ns", "frame_id", "range_min_m", "range_max_m"):
        assert getattr(a, field) == getattr(b, field)
    for field in ("angle_min_rad", "angle_increment_rad", "scan_time_s", "time_increment_s"):
        assert getattr(a, field) == getattr(b, field)
    assert np.array_equal(a.ranges_m, b.ranges_m, equal_nan=True)
    # By REP 117's words, one by one.
    low, high = (float(np.float32(limit)) for limit in limits_m)
    kept = [value if value > 0.0 and low <= value < high else np.nan for value in ranges]
    assert np.array_equal(a.ranges_m, kept, equal_nan=True)
    if with_intensities:
        assert a.intensities is not None
        assert np.array_equal(a.intensities, intensities, equal_nan=True)
    else:
        assert a.intensities is None
        assert b.intensities is None


@WIRES
@KINDS
def test_bytes_that_do_not_fit(wire: Wire, name: str) -> None:
    payload = bytes(wire.serialize(Builder(wire.store).any_of(name), name))
    # Up to three missing bytes at the end may be CDR's padding.
    for end in range(len(payload)):
        with pytest.raises(ValueError, match="do not fit"):
            wire.read(payload[:end], name)
    with pytest.raises(ValueError, match="do not fit"):
        wire.read(payload + bytes(4), name)
    with pytest.raises(ValueError, match="do not fit"):
        wire.read(payload[:4] + b"\xff" * (len(payload) - 4), name)
    end = b"" if wire is PLAIN else b"\0"
    with pytest.raises(ValueError, match="utf-8"):
        wire.read(payload.replace(b"map" + end, b"\xff\xff\xff" + end), name)


@pytest.mark.parametrize("wire", [LITTLE, BIG], ids=["CDR", "big-endian"])
@KINDS
def test_what_is_no_plain_cdr(wire: Wire, name: str) -> None:
    payload = bytes(wire.serialize(Builder(wire.store).any_of(name), name))
    with pytest.raises(ValueError, match="encapsulation"):
        wire.read(b"\0\3" + payload[2:], name)
    with pytest.raises(ValueError, match="end with zero"):
        wire.read(payload.replace(b"map\0", b"mapx"), name)


@pytest.mark.parametrize("wire", [PLAIN, LITTLE], ids=["ROS 1", "CDR"])
@KINDS
def test_only_for_their_own_layout(wire: Wire, name: str) -> None:
    text = wire.definition(name)
    first, _, rest = text.partition("\n")
    readers = set(wire.readers.values())
    for definition, is_direct in ((text, True), (f"{first}\nuint8 more\n{rest}", False)):
        assert (find_deserializer(wire.channel(name, definition)) in readers) is is_direct
    if name in ROS1.types and name not in (TF, OLD_TF):
        assert find_deserializer(wire.channel(name)) in readers
    assert find_deserializer(wire.channel("sensor_msgs/msg/Image")) not in readers


def test_one_reader_for_all_topics_of_a_type() -> None:
    text = PLAIN.definition("sensor_msgs/msg/Image")
    channels = [
        Channel(
            topic=topic,
            message_type="sensor_msgs/msg/Image",
            serialization="ros1",
            definition=text,
        )
        for topic in ("/left", "/right")
    ]
    assert find_deserializer(channels[0]) is find_deserializer(channels[1])
