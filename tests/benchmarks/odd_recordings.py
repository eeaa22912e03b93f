"""Whole files with odd content: the built-in recording, changed as drivers and disks change one."""

import io
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from mcap.writer import Writer as McapLibraryWriter
from rosbags.typesys import Stores, get_typestore

from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.recording import Message
from fusion_core.model.sensors import (
    CameraInfo,
    DepthImage,
    LaserScan,
    TransformBatch,
)
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from tests.recordings.samples.ros_messages import ROS2, ros_message

SAMPLE = Path(__file__).parents[2] / "samples" / "furnished_room.mcap"
_SECONDS = 2
_DAY_NS = 86_400 * NS_PER_S
_BLOCK = bytes(16 << 20)
_BLOCKS = 256

Change = Callable[[int, Message], Message | None]


def altered(file: Path, change: Change) -> Path:
    """The first seconds of the built-in recording, each message changed, or left out for None."""
    with open_recording(SAMPLE) as recording, Ros2McapWriter(file) as writer:
        assert recording.start_ns is not None
        end_ns = recording.start_ns + _SECONDS * NS_PER_S
        for number, original in enumerate(recording.messages(end_ns=end_ns)):
            message = change(number, original)
            if message is not None:
                writer.write(message.topic, message.value)
    return file


def _without(kind: type) -> Change:
    return lambda _, message: None if isinstance(message.value, kind) else message


def _fewer_beams(number: int, message: Message) -> Message:
    value = message.value
    if not isinstance(value, LaserScan) or number % 5:
        return message
    beams = 1 + (number * 97) % value.ranges_m.size
    return replace(message, value=value.with_ranges(value.ranges_m[:beams].copy(), None))


def _smaller_image(number: int, message: Message) -> Message:
    value = message.value
    if not isinstance(value, DepthImage) or number % 4:
        return message
    return replace(message, value=replace(value, depth_m=value.depth_m[::2, ::2].copy()))


def _stamps(of: Callable[[int, int], int]) -> Change:
    def change(number: int, message: Message) -> Message:
        value = message.value
        if isinstance(value, TransformBatch):
            return message
        return replace(message, value=replace(value, stamp_ns=of(number, value.stamp_ns)))

    return change


def _nothing_seen(_: int, message: Message) -> Message:
    value = message.value
    if isinstance(value, LaserScan):
        value = value.with_ranges(np.full_like(value.ranges_m, np.nan), None)
    elif isinstance(value, DepthImage):
        value = replace(value, depth_m=np.full_like(value.depth_m, np.nan))
    return replace(message, value=value)


def _first_stamp_ns() -> int:
    with open_recording(SAMPLE) as recording:
        return next(recording.messages()).stamp_ns


def _by_message(file: Path, change: Callable[[object], None]) -> Path:
    """Messages of ROS 2 types whose fields were changed after the model made them."""
    with (
        open_recording(SAMPLE) as recording,
        file.open("wb") as stream,
    ):
        writer = McapLibraryWriter(stream)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        assert recording.start_ns is not None
        for message in recording.messages(end_ns=recording.start_ns + _SECONDS * NS_PER_S):
            raw = ros_message(ROS2, message.value)
            change(raw)
            name = raw.__msgtype__
            if message.topic not in channels:
                definition, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(
                    name, ros_version=2
                )
                schema = writer.register_schema(name, "ros2msg", definition.encode())
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            assert message.received_ns is not None
            data = bytes(ROS2.serialize_cdr(raw, name))
            time_ns = message.received_ns
            writer.add_message(channels[message.topic], time_ns, data, time_ns)
        writer.finish()
    return file


def _short_image(raw: object) -> None:
    if hasattr(raw, "encoding"):
        raw.data = raw.data[: raw.data.size // 2]


def _nan_intrinsics(raw: object) -> None:
    if hasattr(raw, "distortion_model"):
        raw.k = np.full(9, np.nan)


def _huge_stamps(raw: object) -> None:
    if hasattr(raw, "ranges"):
        raw.header.stamp.sec = -(2**31)


def _bomb_mcap(folder: Path) -> Path:
    """One chunk of a few kilobytes that unpacks to 4 GiB of zeros."""
    packed = io.BytesIO()
    stream = zstandard.ZstdCompressor().stream_writer(packed, closefd=False)
    for _ in range(_BLOCKS):
        stream.write(_BLOCK)
    stream.close()
    data = packed.getvalue()
    text = b"zstd"
    chunk = struct.pack("<QQQI", 0, 1, len(_BLOCK) * _BLOCKS, 0)
    chunk += struct.pack("<I", len(text)) + text + struct.pack("<Q", len(data)) + data
    magic = b"\x89MCAP0\r\n"
    header = struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0)
    records = [(1, header), (6, chunk), (15, struct.pack("<I", 0))]
    body = b"".join(struct.pack("<BQ", op, len(content)) + content for op, content in records)
    footer = struct.pack("<BQQQI", 2, 20, 0, 0, 0)
    file = folder / "bomb.mcap"
    file.write_bytes(magic + body + footer + magic)
    return file


def _bag_record(fields: dict[str, bytes], data: bytes) -> bytes:
    header = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in fields.items()
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _lz4_blocks() -> Iterator[bytes]:
    packer = lz4.frame.LZ4FrameCompressor()
    yield packer.begin()
    for _ in range(_BLOCKS):
        yield packer.compress(_BLOCK)
    yield packer.flush()


def _bomb_bag(folder: Path) -> Path:
    """An unindexed bag whose one chunk unpacks to 4 GiB of zeros."""
    head = {"op": b"\x03", "index_pos": bytes(8), "conn_count": bytes(4), "chunk_count": bytes(4)}
    size = struct.pack("<I", 0xFFFFFFFF)
    chunk = {"op": b"\x05", "compression": b"lz4", "size": size}
    file = folder / "bomb.bag"
    file.write_bytes(
        b"#ROSBAG V2.0\n"
        + _bag_record(head, b" " * 4000)
        + _bag_record(chunk, b"".join(_lz4_blocks()))
    )
    return file


def _stamp_case(name: str, of: Callable[[int, int], int]) -> Callable[[Path], Path]:
    return lambda folder: altered(folder / f"{name}.mcap", _stamps(of))


ODD: dict[str, Callable[[Path], Path]] = {
    "no LiDAR": lambda folder: altered(folder / "depth.mcap", _without(LaserScan)),
    "no depth": lambda folder: altered(folder / "scans.mcap", _without(DepthImage)),
    "no intrinsics": lambda folder: altered(folder / "plain.mcap", _without(CameraInfo)),
    "scans of changing length": lambda folder: altered(folder / "beams.mcap", _fewer_beams),
    "images of changing size": lambda folder: altered(folder / "sizes.mcap", _smaller_image),
    "nothing seen by either": lambda folder: altered(folder / "dark.mcap", _nothing_seen),
    "stamps that run backwards": _stamp_case(
        "backwards", lambda _, stamp: 2 * _first_stamp_ns() - stamp + 10 * NS_PER_S
    ),
    "stamps that jump by a day": _stamp_case(
        "day", lambda number, stamp: stamp + (_DAY_NS if number % 50 > 25 else 0)
    ),
    "one stamp for all": _stamp_case("one", lambda *_: 1_700_000_000 * NS_PER_S),
    "images shorter than step x height": lambda folder: _by_message(
        folder / "short.mcap", _short_image
    ),
    "NaN intrinsics": lambda folder: _by_message(folder / "nan.mcap", _nan_intrinsics),
    "stamps of the year 1901": lambda folder: _by_message(folder / "1901.mcap", _huge_stamps),
    "a zstd chunk of 4 GiB": _bomb_mcap,
    "an lz4 chunk of 4 GiB": _bomb_bag,
}
