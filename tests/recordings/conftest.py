"""Recordings built in code: the same messages in every format, with the values they must give."""

import bz2
import gzip
import importlib.util
import json
import sqlite3
import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    LaserScan,
    PoseSample,
    SensorValue,
    Transform,
    TransformBatch,
)
from fusion_core.recordings.ros2_writer import Ros2McapWriter

T0 = 1_700_000_000_000_000_000
MS = 1_000_000
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)


@dataclass(frozen=True)
class Written:
    """A message as it goes into a file, in the order of writing."""

    topic: str
    received_ns: int
    value: SensorValue

    @property
    def stamp_ns(self) -> int:
        if isinstance(self.value, TransformBatch):
            return self.value.transforms[0].stamp_ns
        return self.value.stamp_ns


@dataclass(frozen=True)
class Sample:
    """A file and what must come out of it. ``received`` is None where a format has no log.

    ``nominal``: the format has no clock, and its stamps are made from frame numbers.
    ``warnings``: what reading all of it must say.
    """

    path: Path
    written: list[Written]
    has_log: bool = True
    types: dict[str, str] = field(default_factory=dict)
    nominal: bool = False
    warnings: tuple[str, ...] = ()

    @property
    def expected(self) -> list[Written]:
        return sorted(self.written, key=lambda message: message.received_ns)


def same(a: object, b: object) -> bool:
    """Equality of frozen values that hold arrays; NaN equals NaN."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        if a.dtype != b.dtype or a.shape != b.shape:
            return False
        if a.shape == (4, 4):
            # A pose through a quaternion keeps its numbers to rounding.
            return np.allclose(a, b, rtol=0.0, atol=1e-12)
        return np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if is_dataclass(a) and type(a) is type(b):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b


def float32(value: float) -> float:
    """What is left of a number after a float32 field."""
    return float(np.float32(value))


def pose(i: int) -> np.ndarray:
    """A pose far from half turns."""
    return make_transform(
        rotation_from_yaw_pitch_roll(0.1 * i, 0.02, -0.03), np.array([i, 0.5, 0.25])
    )


def scan(i: int, received_ns: int, frame_id: str = "laser") -> LaserScan:
    ranges = np.array([1.0 + 0.25 * i, np.nan, 2.5, np.nan, 0.125], dtype=np.float64)
    return LaserScan(
        stamp_ns=received_ns - 3 * MS,
        received_ns=received_ns,
        frame_id=frame_id,
        angle_min_rad=-0.5,
        angle_increment_rad=0.25,
        range_min_m=0.0625,
        range_max_m=5.5,
        ranges_m=ranges,
        intensities=np.arange(5.0),
        scan_time_s=float32(0.1),
        time_increment_s=0.0,
    )


def depth(i: int, received_ns: int) -> DepthImage:
    mm = np.arange(12, dtype=np.uint16).reshape(3, 4) * 250 + i
    mm[0, 0] = 0
    metres = (mm.astype(np.float32) / np.float32(1000)).astype(np.float32)
    metres[0, 0] = np.nan
    return DepthImage(
        stamp_ns=received_ns - 5 * MS,
        received_ns=received_ns,
        frame_id="camera",
        depth_m=metres,
        encoding="16UC1",
    )


def color(i: int, received_ns: int) -> ColorImage:
    rgb = (np.arange(36, dtype=np.uint8) + i).reshape(3, 4, 3)
    return ColorImage(
        stamp_ns=received_ns - 4 * MS, received_ns=received_ns, frame_id="camera", rgb=rgb
    )


def camera_info(received_ns: int, calibrated: bool = True) -> CameraInfo:
    intrinsics = CameraIntrinsics(
        width=4, height=3, fx=3.5, fy=3.25, cx=1.5, cy=1.0, distortion=(0.5, 0.0, 0.0, 0.0, 0.25)
    )
    return CameraInfo(
        stamp_ns=received_ns - 5 * MS,
        received_ns=received_ns,
        frame_id="camera",
        intrinsics=intrinsics if calibrated else None,
    )


def pose_sample(i: int, received_ns: int, parent: str, child: str) -> PoseSample:
    return PoseSample(
        stamp_ns=received_ns - 1 * MS,
        received_ns=received_ns,
        parent=parent,
        child=child,
        T_parent_child=pose(i),
    )


def transforms(i: int, received_ns: int) -> TransformBatch:
    return TransformBatch(
        received_ns=received_ns,
        transforms=tuple(
            Transform(
                stamp_ns=received_ns - k * MS, parent="base", child=f"s{k}", T_parent_child=pose(i)
            )
            for k in (1, 2)
        ),
    )


def messages() -> list[Written]:
    """Twelve steps with ties in log time and one message logged late, in the order of writing."""
    written = [Written("/tf_static", T0 - MS, transforms(0, T0 - MS))]
    for i in range(12):
        at = T0 + i * 50 * MS
        written.append(Written("/scan", at, scan(i, at)))
        written.append(Written("/camera/depth/image_raw", at, depth(i, at)))
        written.append(Written("/camera/depth/camera_info", at + 1, camera_info(at + 1, i > 0)))
        written.append(Written("/camera/color/image_raw", at + 2, color(i, at + 2)))
        written.append(Written("/odom", at + 3, pose_sample(i, at + 3, "odom", "base")))
        written.append(Written("/tf", at + 3, transforms(i, at + 3)))
        written.append(Written("/tf", at + 3, transforms(i + 1, at + 3)))
        written.append(Written("/ground_truth", at + 4, pose_sample(i, at + 4, "map", "")))
    late = T0 + 75 * MS
    written.append(Written("/scan", late, scan(13, late)))
    return written


MESSAGES = messages()
TYPES = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/camera/depth/image_raw": "sensor_msgs/msg/Image",
    "/camera/depth/camera_info": "sensor_msgs/msg/CameraInfo",
    "/camera/color/image_raw": "sensor_msgs/msg/Image",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/ground_truth": "geometry_msgs/msg/PoseStamped",
}


def ros_message(store: Any, value: SensorValue) -> Any:
    """The ROS message of a value, put together field by field (the tests' own writer)."""
    types = store.types
    is_ros1 = store is ROS1

    def time(ns: int) -> Any:
        return types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)

    def header(ns: int, frame: str) -> Any:
        seq = {"seq": 7} if is_ros1 else {}
        return types["std_msgs/msg/Header"](stamp=time(ns), frame_id=frame, **seq)

    def vector(kind: str, xyz: np.ndarray) -> Any:
        return types[f"geometry_msgs/msg/{kind}"](x=xyz[0], y=xyz[1], z=xyz[2])

    def quaternion(T: np.ndarray) -> Any:
        # From the trace: all test rotations are far from half turns. Twice the length, since
        # readers must not rely on unit length.
        w = np.sqrt(1.0 + np.trace(T[:3, :3])) / 2.0
        x, y, z = (T[a, b] - T[b, a] for a, b in ((2, 1), (0, 2), (1, 0)))
        scale = 2.0 / (4.0 * w)
        return types["geometry_msgs/msg/Quaternion"](
            x=x * scale, y=y * scale, z=z * scale, w=2.0 * w
        )

    def ros_pose(T: np.ndarray) -> Any:
        return types["geometry_msgs/msg/Pose"](
            position=vector("Point", T[:3, 3]), orientation=quaternion(T)
        )

    def image(head: Any, encoding: str, pixels: np.ndarray) -> Any:
        # Two bytes of padding at the end of each row, which readers must drop.
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
        padded = np.pad(rows, ((0, 0), (0, 2)), constant_values=255)
        return types["sensor_msgs/msg/Image"](
            header=head,
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=padded.shape[1],
            data=padded.ravel(),
        )

    match value:
        case LaserScan():
            ranges = value.ranges_m.astype(np.float32)
            ranges[1], ranges[3] = 0.0, np.inf
            return types["sensor_msgs/msg/LaserScan"](
                header=header(value.stamp_ns, value.frame_id),
                angle_min=value.angle_min_rad,
                angle_max=0.5,
                angle_increment=value.angle_increment_rad,
                time_increment=0.0,
                scan_time=value.scan_time_s,
                range_min=value.range_min_m,
                range_max=value.range_max_m,
                ranges=ranges,
                intensities=np.arange(5, dtype=np.float32),
            )
        case DepthImage():
            mm = np.nan_to_num(np.rint(value.depth_m * 1000.0)).astype("<u2")
            return image(header(value.stamp_ns, value.frame_id), "16UC1", mm)
        case ColorImage():
            bgr = np.ascontiguousarray(value.rgb[:, :, ::-1])
            return image(header(value.stamp_ns, value.frame_id), "bgr8", bgr)
        case CameraInfo():
            c = value.intrinsics
            k = [c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0] if c else [0.0] * 9
            matrices = {
                "d": np.array(c.distortion if c else (), dtype=np.float64),
                "k": np.array(k),
                "r": np.eye(3).ravel(),
                "p": np.zeros(12),
            }
            return types["sensor_msgs/msg/CameraInfo"](
                header=header(value.stamp_ns, value.frame_id),
                height=3,
                width=4,
                distortion_model="plumb_bob",
                binning_x=0,
                binning_y=0,
                roi=types["sensor_msgs/msg/RegionOfInterest"](
                    x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
                ),
                **{name.upper() if is_ros1 else name: m for name, m in matrices.items()},
            )
        case PoseSample(child=""):
            return types["geometry_msgs/msg/PoseStamped"](
                header=header(value.stamp_ns, value.parent), pose=ros_pose(value.T_parent_child)
            )
        case PoseSample():
            zero = vector("Vector3", np.zeros(3))
            return types["nav_msgs/msg/Odometry"](
                header=header(value.stamp_ns, value.parent),
                child_frame_id=value.child,
                pose=types["geometry_msgs/msg/PoseWithCovariance"](
                    pose=ros_pose(value.T_parent_child), covariance=np.zeros(36)
                ),
                twist=types["geometry_msgs/msg/TwistWithCovariance"](
                    twist=types["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
                    covariance=np.zeros(36),
                ),
            )
        case TransformBatch():
            return types["tf2_msgs/msg/TFMessage"](
                transforms=[
                    types["geometry_msgs/msg/TransformStamped"](
                        header=header(t.stamp_ns, "/" + t.parent if is_ros1 else t.parent),
                        child_frame_id=t.child,
                        transform=types["geometry_msgs/msg/Transform"](
                            translation=vector("Vector3", t.T_parent_child[:3, 3]),
                            rotation=quaternion(t.T_parent_child),
                        ),
                    )
                    for t in value.transforms
                ]
            )


def build_rosbag1(path: Path, compression: Any = None, chunk_bytes: int = 2000) -> Sample:
    writer = Rosbag1Writer(path / "sample.bag")
    writer.chunk_threshold = chunk_bytes
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        connections = {t: writer.add_connection(t, n, typestore=ROS1) for t, n in TYPES.items()}
        for m in MESSAGES:
            data = ROS1.serialize_ros1(ros_message(ROS1, m.value), TYPES[m.topic])
            writer.write(connections[m.topic], m.received_ns, data)
    return Sample(path / "sample.bag", MESSAGES, types=TYPES)


def build_rosbag2(
    path: Path, storage: StoragePlugin, compression: CompressionMode = CompressionMode.NONE
) -> Sample:
    writer = Rosbag2Writer(path / "sample", version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {t: writer.add_connection(t, n, typestore=ROS2) for t, n in TYPES.items()}
        for m in MESSAGES:
            data = ROS2.serialize_cdr(ros_message(ROS2, m.value), TYPES[m.topic])
            writer.write(connections[m.topic], m.received_ns, data)
    return Sample(path / "sample", MESSAGES, types=TYPES)


def lone_file(sample: Sample, suffix: str) -> Sample:
    return Sample(next(sample.path.glob(f"*{suffix}")), sample.written, types=sample.types)


def without_metadata(sample: Sample) -> Sample:
    (sample.path / "metadata.yaml").unlink()
    return sample


def build_mcap(
    file: Path,
    written: Sequence[Written] = MESSAGES,
    *,
    ros1: bool = False,
    summary: bool = True,
    **options: Any,
) -> Sample:
    """By the mcap package's writer."""
    store = ROS1 if ros1 else ROS2
    with file.open("wb") as stream:
        if not summary:
            options |= {"use_statistics": False, "use_summary_offsets": False}
            options |= {"repeat_channels": False, "repeat_schemas": False}
            options |= {"index_types": IndexType.NONE}
        writer = McapLibraryWriter(stream, chunk_size=2000, **options)
        writer.start(profile="ros1" if ros1 else "ros2", library="test")
        channels = {}
        for topic, name in TYPES.items():
            text, _ = store.generate_msgdef(name, ros_version=1 if ros1 else 2)
            ros1_name = name.replace("/msg/", "/")
            schema = writer.register_schema(
                ros1_name if ros1 else name, "ros1msg" if ros1 else "ros2msg", text.encode()
            )
            channels[topic] = writer.register_channel(topic, "ros1" if ros1 else "cdr", schema)
        for m in written:
            serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
            data = bytes(serialize(ros_message(store, m.value), TYPES[m.topic]))
            writer.add_message(channels[m.topic], m.received_ns, data, m.stamp_ns)
        writer.finish()
    return Sample(file, list(written), types=TYPES)


def build_split_folder(path: Path) -> Sample:
    folder = path / "split"
    folder.mkdir()
    # Ten parts and more: part 10 follows part 9, not part 1.
    for part in range(12):
        share = MESSAGES[part * 9 : (part + 1) * 9 if part < 11 else None]
        build_mcap(folder / f"split_{part}.mcap", share)
    return Sample(folder, MESSAGES, types=TYPES)


def build_ours(file: Path) -> Sample:
    with Ros2McapWriter(file) as writer:
        for m in MESSAGES:
            writer.write(m.topic, m.value, odometry=m.topic == "/odom")
    return Sample(file, MESSAGES, types=TYPES)


SCAN_DEFINITION = """Header header
float32 angle_min
float32 angle_max
float32 angle_increment
float32 time_increment
float32 scan_time
float32 range_min
float32 range_max
float32[] ranges
float32[] intensities
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""


def bag_record(header: dict[str, bytes], data: bytes) -> bytes:
    packed = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in header.items()
    )
    return struct.pack("<I", len(packed)) + packed + struct.pack("<I", len(data)) + data


def bag_time(ns: int) -> bytes:
    return struct.pack("<II", ns // 10**9, ns % 10**9)


def scan_bytes(value: LaserScan) -> bytes:
    ranges = value.ranges_m.astype("<f4")
    ranges[[1, 3]] = 0.0, 5.5  # The second sentinel is range_max itself.
    frame = value.frame_id.encode()
    return (
        struct.pack("<I", 9)
        + bag_time(value.stamp_ns)
        + struct.pack("<I", len(frame))
        + frame
        + struct.pack("<7f", -0.5, 0.5, 0.25, 0.0, value.scan_time_s, 0.0625, 5.5)
        + struct.pack("<I", 5)
        + ranges.tobytes()
        + struct.pack("<I5f", 5, 0, 1, 2, 3, 4)
    )


def build_rosbag1_by_bytes(path: Path) -> Sample:
    """A ROS 1 bag after wiki.ros.org/Bags/Format/2.0, without any library.

    Chunks overlap in time and the second is written with the later messages first.
    """
    topics = ["/front_scan", "/rear_scan"]
    logged = [(0, 10), (1, 10), (0, 30), (1, 40), (0, 20), (0, 30), (1, 5)]
    written = [
        Written(topics[c], T0 + ms * MS, scan(i, T0 + ms * MS)) for i, (c, ms) in enumerate(logged)
    ]
    connections = [
        bag_record(
            {"op": b"\x07", "conn": struct.pack("<I", c), "topic": topic.encode()},
            b"".join(
                struct.pack("<I", len(entry)) + entry
                for entry in (
                    b"topic=" + topic.encode(),
                    b"type=sensor_msgs/LaserScan",
                    b"md5sum=90c7ef2dc6895d81024acba2ac42f369",
                    b"message_definition=" + SCAN_DEFINITION.encode(),
                )
            ),
        )
        for c, topic in enumerate(topics)
    ]
    body = b""
    infos = b""
    head_bytes = len(b"#ROSBAG V2.0\n") + 4096
    for start in (0, 4):
        chunk, offsets = b"", {0: [], 1: []}
        for (c, ms), m in list(zip(logged, written, strict=True))[start : start + 4]:
            # The index may point at the connection's record before the message.
            at = len(chunk)
            chunk += connections[c] if not offsets[c] else b""
            offsets[c].append((T0 + ms * MS, at))
            header = {"time": bag_time(m.received_ns), "conn": struct.pack("<I", c), "op": b"\x02"}
            chunk += bag_record(header, scan_bytes(m.value))
        position = head_bytes + len(body)
        body += bag_record(
            {"op": b"\x05", "compression": b"none", "size": struct.pack("<I", len(chunk))}, chunk
        )
        for c, entries in offsets.items():
            header = {"op": b"\x04", "ver": struct.pack("<I", 1), "conn": struct.pack("<I", c)}
            header["count"] = struct.pack("<I", len(entries))
            data = b"".join(bag_time(ns) + struct.pack("<I", at) for ns, at in entries)
            body += bag_record(header, data)
        stamps = [ns for entries in offsets.values() for ns, _ in entries]
        info = {
            "op": b"\x06",
            "ver": struct.pack("<I", 1),
            "chunk_pos": struct.pack("<Q", position),
        }
        info |= {"start_time": bag_time(min(stamps)), "end_time": bag_time(max(stamps))}
        info["count"] = struct.pack("<I", 2)
        counts = b"".join(struct.pack("<II", c, len(entries)) for c, entries in offsets.items())
        infos += bag_record(info, counts)
    header = {"op": b"\x03", "index_pos": struct.pack("<Q", head_bytes + len(body))}
    header |= {"conn_count": struct.pack("<I", 2), "chunk_count": struct.pack("<I", 2)}
    bare = bag_record(header, b"")
    head = bag_record(header, b" " * (4096 - len(bare)))
    file = path / "by_bytes.bag"
    file.write_bytes(b"#ROSBAG V2.0\n" + head + body + b"".join(connections) + infos)
    return Sample(file, written, types=dict.fromkeys(topics, "sensor_msgs/msg/LaserScan"))


FRAME_COUNT = 5


def frame_messages(numbers: Sequence[int], intrinsics: bool) -> list[Written]:
    """What a folder of frames gives, in the order of iteration; the stamp stands for the log."""
    written = []
    for number in numbers:
        stamp = (number - numbers[0]) * 10**9 // 30
        info = CameraInfo(
            stamp_ns=stamp,
            received_ns=None,
            frame_id="camera",
            intrinsics=CameraIntrinsics(width=4, height=3, fx=3.5, fy=3.25, cx=1.5, cy=1.0),
        )
        mm = frame_depth_mm(number)
        metres = mm.astype(np.float32) / np.float32(1000)
        metres[(mm == 0) | (mm == 65535)] = np.nan
        image = DepthImage(
            stamp_ns=stamp, received_ns=None, frame_id="camera", depth_m=metres, encoding="16UC1"
        )
        picture = ColorImage(
            stamp_ns=stamp, received_ns=None, frame_id="camera", rgb=frame_rgb(number)
        )
        sample = PoseSample(
            stamp_ns=stamp,
            received_ns=None,
            parent="world",
            child="camera",
            T_parent_child=pose(number),
        )
        written.append(Written("/camera/color/image_raw", stamp, picture))
        if intrinsics:
            written.append(Written("/camera/depth/camera_info", stamp, info))
        written.append(Written("/camera/depth/image_raw", stamp, image))
        written.append(Written("/camera/pose", stamp, sample))
    return written


def frame_depth_mm(number: int) -> np.ndarray:
    mm = (np.arange(12, dtype=np.uint16) * 300 + number).reshape(3, 4)
    mm[0, 0], mm[2, 3] = 0, 65535
    return mm


def frame_rgb(number: int) -> np.ndarray:
    return (np.arange(36, dtype=np.uint8) * 3 + number).reshape(3, 4, 3)


def write_png(file: Path, pixels: np.ndarray) -> None:
    if pixels.ndim == 3:
        pixels = np.ascontiguousarray(pixels[:, :, ::-1])
    assert cv2.imwrite(str(file), pixels)


def build_seven_scenes(path: Path) -> Sample:
    folder = path / "seq-01"
    folder.mkdir()
    # A frame is missing: its successors keep their own time.
    numbers = [3, 4, 6, 7, 8]
    for n in numbers:
        write_png(folder / f"frame-{n:06d}.depth.png", frame_depth_mm(n))
        write_png(folder / f"frame-{n:06d}.color.png", frame_rgb(n))
        np.savetxt(folder / f"frame-{n:06d}.pose.txt", pose(n), fmt="%.17e")
    np.savetxt(folder / "camera-intrinsics.txt", [[3.5, 0, 1.5], [0, 3.25, 1.0], [0, 0, 1]])
    return Sample(folder, frame_messages(numbers, True), has_log=False, nominal=True)


def build_redwood(path: Path) -> Sample:
    folder = path / "redwood"
    for name in ("depth", "color"):
        (folder / name).mkdir(parents=True)
    lines = []
    for n in range(FRAME_COUNT):
        write_png(folder / f"depth/{n:05d}.png", frame_depth_mm(n))
        write_png(folder / f"color/{n:05d}.png", frame_rgb(n))
        lines.append(f"{n} {n} {n + 1}")
        lines += [" ".join(f"{v:.17e}" for v in row) for row in pose(n)]
    (folder / "trajectory.log").write_text("\n".join(lines) + "\n")
    camera = {"width": 4, "height": 3, "intrinsic_matrix": [3.5, 0, 0, 0, 3.25, 0, 1.5, 1.0, 1]}
    (folder / "camera_primesense.json").write_text(json.dumps(camera))
    return Sample(folder, frame_messages(range(FRAME_COUNT), True), has_log=False, nominal=True)


def build_slambook(path: Path) -> Sample:
    folder = path / "slambook"
    for name in ("depth", "color"):
        (folder / name).mkdir(parents=True)
    # Frame 10 follows frame 9, not frame 1.
    numbers = list(range(1, 13))
    lines = []
    for n in numbers:
        write_png(folder / f"depth/{n}.png", frame_depth_mm(n))
        write_png(folder / f"color/{n}.png", frame_rgb(n))
        q = ros_message(ROS2, pose_sample(n, MS, "a", "")).pose.orientation
        lines.append(" ".join(f"{v:.17e}" for v in (*pose(n)[:3, 3], q.x, q.y, q.z, q.w)))
    (folder / "pose.txt").write_text("\n".join(lines) + "\n")
    return Sample(folder, frame_messages(numbers, False), has_log=False, nominal=True)


def timed_frames(topic_of_truth: str | None, units_per_metre: float) -> list[Written]:
    """Depth at 30 Hz and colour 7 ms later, each with its own stamps, and poses at 100 Hz."""
    written = []
    for n in range(FRAME_COUNT):
        stamp = T0 + n * 33_333_333
        values = frame_depth_mm(n)
        metres = values.astype(np.float32) / np.float32(units_per_metre)
        metres[(values == 0) | (values == 65535)] = np.nan
        head = {"stamp_ns": stamp, "received_ns": None, "frame_id": "camera"}
        info = CameraInfo(
            **head,
            intrinsics=CameraIntrinsics(width=4, height=3, fx=3.5, fy=3.25, cx=1.5, cy=1.0),
        )
        encoding = "16UC1" if units_per_metre == 1000.0 else "32FC1"
        image = DepthImage(**head, depth_m=metres, encoding=encoding)
        later = stamp + 7 * MS
        picture = ColorImage(stamp_ns=later, received_ns=None, frame_id="camera", rgb=frame_rgb(n))
        written.append(Written("/camera/depth/camera_info", stamp, info))
        written.append(Written("/camera/depth/image_raw", stamp, image))
        written.append(Written("/camera/color/image_raw", later, picture))
    for n in range(12 if topic_of_truth else 0):
        stamp = T0 - 5 * MS + n * 10 * MS
        sample = PoseSample(
            stamp_ns=stamp,
            received_ns=None,
            parent="world",
            child="camera",
            T_parent_child=pose(n),
        )
        written.append(Written(str(topic_of_truth), stamp, sample))
    return written


def decimal_seconds(ns: int) -> str:
    return f"{ns // 10**9}.{ns % 10**9:09d}"


def build_tum(path: Path) -> Sample:
    folder = path / "rgbd_dataset"
    lists = {"depth": ["# depth maps", "# timestamp filename"], "rgb": ["# color images"]}
    truth = ["# ground truth trajectory", "# timestamp tx ty tz qx qy qz qw"]
    for name in lists:
        (folder / name).mkdir(parents=True)
    written = timed_frames("/camera/ground_truth", 5000.0)
    n = 0
    for m in written:
        at = decimal_seconds(m.stamp_ns)
        if isinstance(m.value, PoseSample):
            q = ros_message(ROS2, m.value).pose.pose.orientation
            numbers = (*m.value.T_parent_child[:3, 3], q.x, q.y, q.z, q.w)
            truth.append(" ".join([at, *(f"{v:.17e}" for v in numbers)]))
        elif isinstance(m.value, DepthImage):
            write_png(folder / f"depth/{at}.png", frame_depth_mm(n))
            lists["depth"].append(f"{at} depth/{at}.png")
        elif isinstance(m.value, ColorImage):
            write_png(folder / f"rgb/{at}.png", m.value.rgb)
            lists["rgb"].append(f"{at} rgb/{at}.png")
            n += 1
    for name, lines in (*lists.items(), ("groundtruth", truth)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    (folder / "accelerometer.txt").write_text("# timestamp ax ay az\n1.5 0.1 8.0 -5.0\n")
    (folder / "calibration.txt").write_text("3.5 3.25 1.5 1.0\n")
    return Sample(folder, written, has_log=False)


def build_timed_images(path: Path) -> Sample:
    """Depth named by nanoseconds and colour by decimal seconds."""
    folder = path / "images by time"
    for name in ("depth", "rgb"):
        (folder / name).mkdir(parents=True)
    written = timed_frames(None, 1000.0)
    n = 0
    for m in written:
        if isinstance(m.value, DepthImage):
            write_png(folder / f"depth/{m.stamp_ns}.png", frame_depth_mm(n))
        elif isinstance(m.value, ColorImage):
            write_png(folder / f"rgb/{decimal_seconds(m.stamp_ns)}.png", m.value.rgb)
            n += 1
    keys = {"fx": 3.5, "fy": 3.25, "cx": 1.5, "cy": 1, "width": 4, "height": 3}
    (folder / "camera.json").write_text(json.dumps(keys | {"depth_scale": 1000}))
    return Sample(folder, written, has_log=False)


def build_numbered_images(path: Path) -> Sample:
    folder = path / "images by number"
    for name in ("depth", "images"):
        (folder / name).mkdir(parents=True)
    # Frame 10 follows frame 9, not frame 1.
    numbers = [2, 9, 10, 11]
    for n in numbers:
        write_png(folder / f"depth/depth_{n}.png", frame_depth_mm(n))
        write_png(folder / f"images/frame{n:06d}.png", frame_rgb(n))
    camera = {"width": 4, "height": 3, "intrinsic_matrix": [3.5, 0, 0, 0, 3.25, 0, 1.5, 1.0, 1]}
    (folder / "intrinsics.json").write_text(json.dumps(camera | {"depth_scale": 0.001}))
    written = [m for m in frame_messages(numbers, True) if m.topic != "/camera/pose"]
    return Sample(folder, written, has_log=False, nominal=True)


def builders(name: str) -> Any:
    """A module of builders beside this file, which is on no import path."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


ROBOT_AT_HOME = builders("robot_at_home_trees")
CARMEN = builders("carmen_logs")


def robot_at_home_messages(source: Any, depth_bits: int) -> list[Written]:
    """What a room gives, from what the exporters store of it."""
    lens = CameraIntrinsics(
        width=320,
        height=240,
        fx=286.441384,
        fy=271.36999,
        cx=157.3245865,
        cy=120.0802295,
        distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    )
    written, transforms = [], {}
    for sweep in source.sweeps[2]:
        step = 4.1847 / sweep.ranges_m.size
        value = LaserScan(
            stamp_ns=sweep.stamp_ns,
            received_ns=None,
            frame_id="laser",
            angle_min_rad=-0.5 * (sweep.ranges_m.size - 1) * step,
            angle_increment_rad=step,
            range_min_m=0.0,
            range_max_m=5.6,
            ranges_m=sweep.ranges_m,
            scan_time_s=0.1,
        )
        written.append(Written("/laser", sweep.stamp_ns, value))
        transforms["laser"] = sweep.pose
    for sight in source.sights:
        name = sight.label.lower()
        transforms[f"{name}_optical"] = sight.pose
        head = {
            "stamp_ns": sight.stamp_ns,
            "received_ns": None,
            "frame_id": f"{name}_optical",
        }
        units = ROBOT_AT_HOME.stored_depth(sight.depth_m).astype(np.float64)
        if depth_bits == 8:
            units = np.where(units >= 256, 256 * (units // 256) + 127.5, 0)
        metres = np.where(units > 0, units / 6553.5, np.nan)
        values = {
            "camera_info": CameraInfo(**head, intrinsics=lens),
            "color": ColorImage(**head, rgb=sight.rgb.copy()),
            "depth": DepthImage(
                **head,
                depth_m=metres.astype(np.float32),
                quantum_m=256 / 6553.5 if depth_bits == 8 else None,
            ),
        }
        for kind, image in values.items():
            written.append(Written(f"/{name}/{kind}", sight.stamp_ns, image))
    first = min(m.received_ns for m in written)
    # Optical axes in those of the body: right is -y, down is -z, forward is x.
    optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    batch = TransformBatch(
        received_ns=None,
        transforms=tuple(
            Transform(
                stamp_ns=first,
                parent="base_link",
                child=child,
                T_parent_child=make_transform(
                    rotation_from_yaw_pitch_roll(*p[3:]) @ (optical if p[5] else np.eye(3)),
                    np.array(p[:3]),
                ),
            )
            for child, p in sorted(transforms.items())
        ),
    )
    written.append(Written("/tf_static", first, batch))
    return sorted(written, key=lambda m: (m.received_ns, m.topic))


def build_plain_text_room(path: Path) -> Sample:
    source = ROBOT_AT_HOME.small_room()
    root = ROBOT_AT_HOME.write_plain_text(path / "robot_at_home", [source])
    written = robot_at_home_messages(source, depth_bits=16)
    return Sample(root, written, has_log=False)


def build_robot_at_home2_room(path: Path) -> Sample:
    source = ROBOT_AT_HOME.small_room()
    root = ROBOT_AT_HOME.write_robot_at_home2(path / "R@H2", [source])
    written = robot_at_home_messages(source, depth_bits=8)
    return Sample(root, written, has_log=False, warnings=("steps of 39 mm",))


def build_carmen(file: Path, pack: Callable[[bytes], bytes] = bytes) -> Sample:
    text, given = CARMEN.small_log()
    file.write_bytes(pack(text.encode()))
    return Sample(file, [Written(topic, value.received_ns, value) for topic, value in given])


def build_old_sqlite(path: Path) -> Sample:
    """A .db3 of the first schema: no definitions, type names without their middle part."""
    file = path / "old.db3"
    connection = sqlite3.connect(file)
    connection.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        " serialization_format TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
    )
    ids = {topic: 10 * n for n, topic in enumerate(TYPES, start=1)}
    connection.executemany(
        "INSERT INTO topics VALUES (?, ?, ?, 'cdr')",
        [(ids[topic], topic, name.replace("/msg/", "/")) for topic, name in TYPES.items()],
    )
    connection.executemany(
        "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
        [
            (
                ids[m.topic],
                m.received_ns,
                bytes(ROS2.serialize_cdr(ros_message(ROS2, m.value), TYPES[m.topic])),
            )
            for m in MESSAGES
        ],
    )
    connection.commit()
    connection.close()
    return Sample(file, MESSAGES, types=TYPES)


BagCompression = Rosbag1Writer.CompressionFormat
BUILDERS: dict[str, Callable[[Path], Sample]] = {
    "rosbag1": build_rosbag1,
    "rosbag1 bz2": lambda p: build_rosbag1(p, BagCompression.BZ2),
    "rosbag1 lz4": lambda p: build_rosbag1(p, BagCompression.LZ4),
    "rosbag1 by bytes": build_rosbag1_by_bytes,
    "rosbag2 sqlite": lambda p: build_rosbag2(p, StoragePlugin.SQLITE3),
    "rosbag2 mcap": lambda p: build_rosbag2(p, StoragePlugin.MCAP),
    **{
        f"rosbag2 {storage.name.lower()} packed by {mode.name.lower()}": partial(
            build_rosbag2, storage=storage, compression=mode
        )
        for storage in (StoragePlugin.SQLITE3, StoragePlugin.MCAP)
        for mode in (CompressionMode.FILE, CompressionMode.MESSAGE)
    },
    "rosbag2 sqlite, no metadata": lambda p: without_metadata(
        build_rosbag2(p, StoragePlugin.SQLITE3)
    ),
    "rosbag2 mcap, no metadata": lambda p: without_metadata(build_rosbag2(p, StoragePlugin.MCAP)),
    "split mcap, no metadata": build_split_folder,
    "db3": lambda p: lone_file(build_rosbag2(p, StoragePlugin.SQLITE3), ".db3"),
    "db3 of the first schema": build_old_sqlite,
    "mcap zstd": lambda p: build_mcap(p / "a.mcap"),
    "mcap lz4": lambda p: build_mcap(p / "a.mcap", compression=CompressionType.LZ4),
    "mcap plain": lambda p: build_mcap(p / "a.mcap", compression=CompressionType.NONE),
    "mcap without chunks": lambda p: build_mcap(p / "a.mcap", use_chunking=False),
    "mcap without summary": lambda p: build_mcap(p / "a.mcap", summary=False),
    "mcap without message index": lambda p: build_mcap(p / "a.mcap", index_types=IndexType.CHUNK),
    "mcap of ROS 1": lambda p: build_mcap(p / "a.mcap", ros1=True),
    "mcap of this project": lambda p: build_ours(p / "a.mcap"),
    "7-Scenes": build_seven_scenes,
    "Redwood": build_redwood,
    "slambook": build_slambook,
    "TUM RGB-D": build_tum,
    "images by time": build_timed_images,
    "images by number": build_numbered_images,
    "Robot@Home": build_plain_text_room,
    "Robot@Home2": build_robot_at_home2_room,
    "CARMEN": lambda p: build_carmen(p / "log.clf"),
    "CARMEN gz": lambda p: build_carmen(p / "log.clf.gz", gzip.compress),
    "CARMEN bz2": lambda p: build_carmen(p / "packed", bz2.compress),
}


@pytest.fixture(params=list(BUILDERS))
def sample(request: pytest.FixtureRequest, tmp_path: Path) -> Sample:
    """One recording in each format."""
    return BUILDERS[request.param](tmp_path)


@pytest.fixture
def build(tmp_path: Path) -> Callable[[str], Sample]:
    """Build a recording of a format by its name in BUILDERS."""
    return lambda name: BUILDERS[name](tmp_path)


@pytest.fixture
def robot_at_home_trees() -> Any:
    """The writers of both versions of Robot@Home."""
    return ROBOT_AT_HOME


@pytest.fixture
def carmen_logs() -> Any:
    """The writer of a CARMEN log with every kind of line."""
    return CARMEN


@pytest.fixture
def same_value() -> Callable[[object, object], bool]:
    """Equality of frozen values that hold arrays; NaN equals NaN."""
    return same
