"""Recordings of any size with a LiDAR and a depth camera, written by the libraries of each format.

What no sensor saw is zero, and long runs of zeros are left as holes: a file of 20 GB takes a few
hundred megabytes of the disk. Chunks are not compressed, so that the file is as large as it seems.
"""

import heapq
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from fusion_core.model.conventions import NS_PER_S

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
FIRST_NS = 1_700_000_000 * NS_PER_S
# One depth image in so many shows something.
_SEEN_EVERY = 20
_HOLE_BYTES = 1 << 16
_NOTHING = bytes(_HOLE_BYTES)
# Behind the encapsulation of CDR, and behind the sequence number of ROS 1.
_STAMP = struct.Struct("<II")
_STAMP_OFFSET = 4


@dataclass(frozen=True, slots=True)
class Stream:
    """Messages of one topic at a rate: ``payloads`` in CDR, the first one now and then."""

    topic: str
    type: str
    rate_hz: float
    payloads: tuple[bytes, ...]

    @property
    def bytes_per_s(self) -> float:
        return self.rate_hz * len(self.payloads[0])


# Place of the stream, log time, and whether it is one of the messages that show something.
Tick = tuple[int, int, bool]


def camera_streams() -> list[Stream]:
    """A depth camera with large colour images, 205 MB a second."""
    return [*_camera(480, 640, rate_hz=30.0), *_color(1080, 1920), _scan(682, 10.0), _odometry(50)]


def busy_streams() -> list[Stream]:
    """1,000 small messages a second."""
    pose = ("geometry_msgs/msg/PoseStamped", {"pose": _pose()})
    return [
        *_camera(48, 64, rate_hz=10.0),
        _scan(360, 20.0),
        _odometry(60),
        _stream("/tracked", *pose, rate_hz=900.0),
    ]


def ticks(streams: Sequence[Stream], seconds: float) -> Iterator[Tick]:
    """Every message of the streams in the order of time."""

    def own(place: int) -> Iterator[tuple[int, int, bool]]:
        rate_hz = streams[place].rate_hz
        for number in range(int(seconds * rate_hz)):
            at_ns = FIRST_NS + int(number * NS_PER_S / rate_hz)
            yield at_ns, place, number % _SEEN_EVERY == 0

    for at_ns, place, shows in heapq.merge(*map(own, range(len(streams)))):
        yield place, at_ns, shows


def write_mcap(
    folder: Path, streams: Sequence[Stream], seconds: float, *, use_chunks: bool = True
) -> Path:
    """By the mcap package."""
    file = folder / "recording.mcap"
    with file.open("wb") as stream:
        sparse = _SparseFile(stream)
        writer = McapLibraryWriter(
            sparse,  # type: ignore[arg-type]  # It asks for no more than write and tell.
            compression=CompressionType.NONE,
            use_chunking=use_chunks,
        )
        writer.start(profile="ros2", library="test")
        channels = []
        for own in streams:
            text, _ = ROS2.generate_msgdef(own.type, ros_version=2)
            schema = writer.register_schema(own.type, "ros2msg", text.encode())
            channels.append(writer.register_channel(own.topic, "cdr", schema))
        payloads = [[bytearray(payload) for payload in own.payloads] for own in streams]
        for place, at_ns, shows in ticks(streams, seconds):
            data = _stamped(payloads[place], at_ns, shows)
            writer.add_message(channels[place], at_ns, data, at_ns)
        writer.finish()
        sparse.finish()
    return file


def write_mcap_without_chunks(folder: Path, streams: Sequence[Stream], seconds: float) -> Path:
    """As the ROS 2 recorder writes with its preset ``fastwrite``."""
    return write_mcap(folder, streams, seconds, use_chunks=False)


def write_bag(folder: Path, streams: Sequence[Stream], seconds: float) -> Path:
    """A ROS 1 bag, by rosbags."""
    file = folder / "recording.bag"
    writer = Rosbag1Writer(file)
    with writer:
        sparse: Any = _SparseFile(writer.bio)
        writer.bio = sparse
        connections = [
            writer.add_connection(own.topic, own.type, typestore=ROS1) for own in streams
        ]
        payloads = [
            [bytearray(ROS2.cdr_to_ros1(payload, own.type)) for payload in own.payloads]
            for own in streams
        ]
        for place, at_ns, shows in ticks(streams, seconds):
            data = _stamped(payloads[place], at_ns, shows)
            writer.write(connections[place], at_ns, memoryview(data))
    return file


def write_database(folder: Path, streams: Sequence[Stream], seconds: float) -> Path:
    """A folder with a ROS 2 database, by rosbags. It has no holes."""
    path = folder / "recording"
    with Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = [
            writer.add_connection(own.topic, own.type, typestore=ROS2) for own in streams
        ]
        payloads = [[bytearray(payload) for payload in own.payloads] for own in streams]
        for place, at_ns, shows in ticks(streams, seconds):
            data = _stamped(payloads[place], at_ns, shows)
            writer.write(connections[place], at_ns, memoryview(data))
    return path / "recording.db3"


Write = Callable[[Path, Sequence[Stream], float], Path]


class _SparseFile:
    """A file in which long runs of zeros become holes."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.tell = file.tell
        self.seek = file.seek

    def write(self, data: bytes) -> int:
        if len(data) < _HOLE_BYTES:
            return self._file.write(data)
        # Pieces that begin where blocks of the disk do.
        first = -self._file.tell() % _HOLE_BYTES
        for start, end in _pieces(first, len(data)):
            piece = data[start:end]
            if piece == _NOTHING:
                self._file.seek(len(piece), 1)
            else:
                self._file.write(piece)
        return len(data)

    def finish(self) -> None:
        self._file.truncate()

    def close(self) -> None:
        self._file.close()


def _pieces(first: int, size: int) -> Iterator[tuple[int, int]]:
    bounds = [0, *range(first, size, _HOLE_BYTES), size]
    return pairwise(bounds)


def _stamped(payloads: Sequence[bytearray], at_ns: int, shows: bool) -> bytearray:
    payload = payloads[0 if shows else -1]
    _STAMP.pack_into(payload, _STAMP_OFFSET, *divmod(at_ns, NS_PER_S))
    return payload


def _message(name: str, **fields: Any) -> Any:
    return ROS2.types[name](**fields)


def _stream(topic: str, name: str, *contents: dict[str, Any], rate_hz: float) -> Stream:
    """``contents``: the fields behind the header of each payload."""
    stamp = _message("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    header = _message("std_msgs/msg/Header", stamp=stamp, frame_id=topic.split("/")[1])
    payloads = (
        bytes(ROS2.serialize_cdr(_message(name, header=header, **fields), name))
        for fields in contents
    )
    return Stream(topic, name, rate_hz, tuple(payloads))


def _camera(height: int, width: int, rate_hz: float) -> list[Stream]:
    wall_mm = np.full((height, width), 2000, "<u2") + np.arange(width, dtype="<u2")
    images = [_image("16UC1", wall_mm), _image("16UC1", np.zeros_like(wall_mm))]
    return [
        _stream("/camera/depth/image_raw", "sensor_msgs/msg/Image", *images, rate_hz=rate_hz),
        _camera_info("/camera/depth/camera_info", height, width, rate_hz),
    ]


def _color(height: int, width: int) -> list[Stream]:
    black = _image("rgb8", np.zeros((height, 3 * width), np.uint8))
    return [
        _stream("/camera/color/image_raw", "sensor_msgs/msg/Image", black, rate_hz=30.0),
        _camera_info("/camera/color/camera_info", height, width, 30.0),
    ]


def _image(encoding: str, rows: np.ndarray[Any, Any]) -> dict[str, Any]:
    """``rows``: (H, W) depth, or (H, 3 W) colour."""
    data = rows.view(np.uint8)
    height, width = rows.shape
    return {
        "height": height,
        "width": width // 3 if encoding == "rgb8" else width,
        "encoding": encoding,
        "is_bigendian": 0,
        "step": data.shape[1],
        "data": data.ravel(),
    }


def _camera_info(topic: str, height: int, width: int, rate_hz: float) -> Stream:
    focal, cx, cy = 0.9 * width, 0.5 * (width - 1), 0.5 * (height - 1)
    fields = {
        "height": height,
        "width": width,
        "distortion_model": "plumb_bob",
        "d": np.zeros(5),
        "k": np.array([focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0]),
        "r": np.eye(3).ravel(),
        "p": np.array([focal, 0.0, cx, 0.0, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0]),
        "binning_x": 0,
        "binning_y": 0,
        "roi": _message(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        ),
    }
    return _stream(topic, "sensor_msgs/msg/CameraInfo", fields, rate_hz=rate_hz)


def _scan(beams: int, rate_hz: float) -> Stream:
    span_rad = 4.18
    fields = {
        "angle_min": -0.5 * span_rad,
        "angle_max": 0.5 * span_rad,
        "angle_increment": span_rad / (beams - 1),
        "time_increment": 0.0,
        "scan_time": 1.0 / rate_hz,
        "range_min": 0.06,
        "range_max": 5.6,
        "ranges": np.linspace(1.0, 5.0, beams, dtype=np.float32),
        "intensities": np.zeros(0, np.float32),
    }
    return _stream("/scan", "sensor_msgs/msg/LaserScan", fields, rate_hz=rate_hz)


def _pose() -> Any:
    return _message(
        "geometry_msgs/msg/Pose",
        position=_message("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0),
        orientation=_message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )


def _odometry(rate_hz: float) -> Stream:
    zero = _message("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    fields = {
        "child_frame_id": "base",
        "pose": _message(
            "geometry_msgs/msg/PoseWithCovariance", pose=_pose(), covariance=np.zeros(36)
        ),
        "twist": _message(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=_message("geometry_msgs/msg/Twist", linear=zero, angular=zero),
            covariance=np.zeros(36),
        ),
    }
    return _stream("/odom", "nav_msgs/msg/Odometry", fields, rate_hz=rate_hz)
