"""Small recordings of a room whose scans, cameras or transforms hold what no sensor has.

``write_room`` writes the room and lets a change be made to each ROS 2 message, after the model has
made it and before its bytes are written.
"""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.typesys import Stores, get_typestore

from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    DepthImage,
    PoseSample,
    SensorValue,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from tests.mapping.box_room import LIDAR_HEIGHT_M, BoxRoom, camera_pose

START_NS = 1_700_000_000_000_000_000
SCAN_MS = 100
SCANS = 20
BEAMS = 360
LENS = CameraIntrinsics(width=80, height=60, fx=72.0, fy=72.0, cx=39.5, cy=29.5)
SCAN_TOPIC = "/scan"
DEPTH_TOPIC = "/camera/depth/image_raw"
INFO_TOPIC = "/camera/depth/camera_info"
_ROOM = BoxRoom(size_m=(5.5, 5.0, 2.5), boxes=((4.0, 0.8, 0.0, 4.6, 1.6, 1.5),))
_ROS2 = get_typestore(Stores.ROS2_HUMBLE)

Change = Callable[[str, int, Any], None]
"""Changes a raw message in place: its topic, its number on that topic, and itself."""


def unchanged(topic: str, number: int, message: Any) -> None:
    """Leave every message as it is."""


def write_room(path: Path, change: Change = unchanged, *, beams: int = BEAMS) -> Path:
    """Write twenty scans and depth images, odometry, and the mount in /tf_static.

    ``change`` is asked for each message; returns ``path``.
    """
    clean = path.with_name(f"{path.stem}.clean.mcap")
    with Ros2McapWriter(clean) as writer:
        for topic, value in _values(beams):
            writer.write(topic, value)
    with clean.open("rb") as source, path.open("wb") as file:
        # Uncompressed: millions of beams are written in no time.
        changed = McapLibraryWriter(file, compression=CompressionType.NONE)
        changed.start(profile="ros2")
        channels: dict[str, int] = {}
        counts: Counter[str] = Counter()
        for schema, channel, message in make_reader(source).iter_messages():
            assert schema is not None, "messages of ROS 2 have a schema"
            topic, kind = channel.topic, schema.name
            raw = _ROS2.deserialize_cdr(message.data, kind)
            change(topic, counts[topic], raw)
            counts[topic] += 1
            if topic not in channels:
                known = changed.register_schema(kind, schema.encoding, schema.data)
                channels[topic] = changed.register_channel(topic, "cdr", known)
            data = bytes(_ROS2.serialize_cdr(raw, kind))
            changed.add_message(channels[topic], message.log_time, data, message.publish_time)
        changed.finish()
    clean.unlink()
    return path


def _values(beams: int) -> list[tuple[str, SensorValue]]:
    T_base_camera = camera_pose(0.8)
    T_base_lidar = make_transform(np.eye(3), np.array([0.0, 0.0, LIDAR_HEIGHT_M]))
    mounts = tuple(
        Transform(stamp_ns=START_NS, parent="base_link", child=name, T_parent_child=T.copy())
        for name, T in (("laser", T_base_lidar), ("camera_optical", T_base_camera))
    )
    info = CameraInfo(
        stamp_ns=START_NS, received_ns=START_NS, frame_id="camera_optical", intrinsics=LENS
    )
    values: list[tuple[str, SensorValue]] = [
        ("/tf_static", TransformBatch(received_ns=START_NS, transforms=mounts)),
        (INFO_TOPIC, info),
    ]
    for number in range(SCANS):
        pose = np.array([1.0 + 0.02 * number, 2.5, 0.02 * number])
        stamp_ns = START_NS + number * SCAN_MS * NS_PER_MS
        turn = rotation_from_yaw_pitch_roll(pose[2], 0.0, 0.0)
        values.append((SCAN_TOPIC, _ROOM.scan(pose, beams=beams, stamp_ns=stamp_ns)))
        values.append(
            (
                DEPTH_TOPIC,
                DepthImage(
                    stamp_ns=stamp_ns,
                    received_ns=None,
                    frame_id="camera_optical",
                    depth_m=_ROOM.depth(pose, T_base_camera, intrinsics=LENS),
                ),
            )
        )
        values.append(
            (
                "/odom",
                PoseSample(
                    stamp_ns=stamp_ns,
                    received_ns=None,
                    parent="odom",
                    child="base_link",
                    T_parent_child=make_transform(turn, np.array([pose[0], pose[1], 0.0])),
                ),
            )
        )
    return values


def scans_where(is_meant: Callable[[int], bool], **fields: Any) -> Change:
    """Set fields of the scans whose number ``is_meant``; a callable is given the message."""

    def change(topic: str, number: int, message: Any) -> None:
        if topic == SCAN_TOPIC and is_meant(number):
            _set(message, fields)

    return change


def every_scan(**fields: Any) -> Change:
    """Set fields of each scan."""
    return scans_where(lambda number: True, **fields)


def every_message(of: str, **fields: Any) -> Change:
    """Set fields of each message of a topic."""

    def change(topic: str, number: int, message: Any) -> None:
        if topic == of:
            _set(message, fields)

    return change


def _set(message: Any, fields: dict[str, Any]) -> None:
    for name, value in fields.items():
        setattr(message, name, value(message) if callable(value) else value)


def ranges(count: int, value: float = 2.0) -> np.ndarray[Any, Any]:
    """(count,) float32 of one value."""
    return np.full(count, value, dtype=np.float32)


def first_beams(count: int) -> Callable[[Any], np.ndarray[Any, Any]]:
    """The first ``count`` ranges of a scan."""
    return lambda message: message.ranges[:count].copy()


def far_child(value: float) -> Change:
    """Put each child frame of /tf_static at x = ``value``, in metres."""

    def change(topic: str, number: int, message: Any) -> None:
        if topic == "/tf_static":
            for entry in message.transforms:
                entry.transform.translation.x = value

    return change


def _fewer_beams(topic: str, number: int, message: Any) -> None:
    if topic == SCAN_TOPIC:
        message.ranges = message.ranges[: BEAMS - number].copy()


def _one_pixel(topic: str, number: int, message: Any) -> None:
    if topic in (DEPTH_TOPIC, INFO_TOPIC):
        message.height = message.width = 1
    if topic == DEPTH_TOPIC:
        message.step, message.data = 4, ranges(1).view(np.uint8)


def _focal(value: float) -> Callable[[Any], np.ndarray[Any, Any]]:
    return lambda message: np.where(np.arange(9) % 4 == 0, value, message.k)


_TURN = float(np.float32(2.0 * np.pi))

WITHOUT_RANGES: dict[str, Change] = {
    "one_empty": scans_where(lambda number: number == 7, ranges=ranges(0)),
    "first_empty": scans_where(lambda number: number == 0, ranges=ranges(0)),
    "all_empty": every_scan(ranges=ranges(0)),
}
"""Scans without ranges, by name."""

IMPLAUSIBLE: dict[str, Change] = {
    "increment_100": every_scan(angle_increment=100.0),
    "increment_zero": every_scan(angle_increment=0.0),
    "increment_nan": every_scan(angle_increment=np.nan),
    "increment_inf": every_scan(angle_increment=np.inf),
    "increment_subnormal": every_scan(angle_increment=1e-42),
    "in_degrees": every_scan(angle_min=-180.0, angle_increment=1.0),
    "two_turns": every_scan(angle_increment=2.0 * _TURN / BEAMS),
    "angle_min_nan": every_scan(angle_min=np.nan),
    "angle_min_huge": every_scan(angle_min=1e30),
    "beams_100000": every_scan(ranges=ranges(100_000)),
    "beams_1000000": every_scan(ranges=ranges(1_000_000)),
    "beams_16000000": scans_where(lambda number: number == 0, ranges=ranges(16_000_000)),
}
"""Scans whose beams and angles no scanner has, by name."""

ODD: dict[str, Change] = {
    "all_nan": every_scan(ranges=ranges(BEAMS, np.nan)),
    "all_zero": every_scan(ranges=ranges(BEAMS, 0.0)),
    "all_inf": every_scan(ranges=ranges(BEAMS, np.inf)),
    "one_nan": scans_where(lambda number: number == 7, ranges=ranges(BEAMS, np.nan)),
    "one_beam": every_scan(ranges=first_beams(1)),
    "two_beams": every_scan(ranges=first_beams(2)),
    "three_beams": every_scan(ranges=first_beams(3)),
    "two_beams_opposite": every_scan(ranges=first_beams(2), angle_increment=np.pi),
    "beams_change": _fewer_beams,
    "one_beam_once": scans_where(lambda number: number == 7, ranges=first_beams(1)),
    "no_intensities": every_scan(intensities=ranges(0)),
    "full_turn_and_a_step": every_scan(
        ranges=lambda message: np.append(message.ranges, message.ranges[:2]).astype(np.float32)
    ),
    "range_max_inf": every_scan(range_max=np.inf),
    "range_max_huge": every_scan(range_max=1e38),
    "range_min_inf": every_scan(range_min=-np.inf),
    "times_nan": every_scan(scan_time=np.nan, time_increment=np.nan),
}
"""Scans that a scanner may send, if rarely, by name."""

CAMERAS: dict[str, Change] = {
    "one_pixel": _one_pixel,
    "focal_1e-300": every_message(INFO_TOPIC, k=_focal(1e-300)),
    "focal_1e300": every_message(INFO_TOPIC, k=_focal(1e300)),
    "distortion_1e300": every_message(INFO_TOPIC, d=np.full(5, 1e300)),
    "centre_1e300": every_message(
        INFO_TOPIC, k=np.array([72.0, 0.0, 1e300, 0.0, 72.0, 1e300, 0.0, 0.0, 1.0])
    ),
    "mount_1e300": far_child(1e300),
    "mount_1e150": far_child(1e150),
}
"""Cameras and mounts that cannot be, by name."""

HOSTILE: dict[str, Change] = {**WITHOUT_RANGES, **IMPLAUSIBLE, **ODD, **CAMERAS}
