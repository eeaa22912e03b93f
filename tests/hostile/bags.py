"""ROS 1 bags put together byte by byte as ROS's own recorder writes them: old ones, damaged ones.
MCAP files of the same messages, by their own library.

After wiki.ros.org/Bags/Format/2.0 and rosbag's C++ recorder: a connection's record stands once in
the chunk of its first message, just before that, and once more in the index at the end.
"""

import bz2
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import lz4.frame
import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

T0_NS = 1_275_000_000 * 10**9
MAGIC = b"#ROSBAG V2.0\n"
HEADER_BYTES = 4096
BEAMS = 12
PACK: dict[bytes, Callable[[bytes], bytes]] = {
    b"none": bytes,
    b"bz2": bz2.compress,
    # As roslz4 packs: a checksum of the content is in the frame.
    b"lz4": lambda content: lz4.frame.compress(content, content_checksum=True),
}
# What an entry of the index took in memory, where the first recorders got its length from.
OLD_ENTRY_BYTES = 20

_HEADER = """uint32 seq
time stamp
string frame_id
"""
_TRANSFORM = """Vector3 translation
Quaternion rotation
"""
_VECTOR = """float64 x
float64 y
float64 z
"""
_SCAN = """Header header
float32 angle_min        # start angle of the scan [rad]
float32 angle_max
float32 angle_increment
float32 time_increment
float32 scan_time
float32 range_min
float32 range_max
float32[] ranges         # range data [m] (Note: values < range_min are to be discarded)
float32[] intensities
"""


def _definition(text: str, *parts: tuple[str, str]) -> str:
    rule = "=" * 80
    return "\n".join([text, *(f"{rule}\nMSG: {name}\n{part}" for name, part in parts)])


@dataclass(frozen=True, kw_only=True)
class Connection:
    """A topic as a bag describes it."""

    topic: str
    message_type: str
    md5sum: str
    definition: str

    def record(self, number: int) -> bytes:
        entries = {
            "message_definition": self.definition,
            "md5sum": self.md5sum,
            "topic": self.topic,
            "type": self.message_type,
        }
        header = {"conn": u32(number), "op": b"\x07", "topic": self.topic.encode()}
        return record(_fields({name: text.encode() for name, text in entries.items()}), **header)


def scans_as(topic: str, header: str = "std_msgs/Header") -> Connection:
    """LaserScans whose definition calls the header's type ``header``."""
    return Connection(
        topic=topic,
        message_type="sensor_msgs/LaserScan",
        md5sum="90c7ef2dc6895d81024acba2ac42f369",
        definition=_definition(_SCAN, (header, _HEADER)),
    )


def transforms_as(topic: str, header: str = "std_msgs/Header") -> Connection:
    return Connection(
        topic=topic,
        message_type="tf/tfMessage",
        md5sum="94810edda583a504dfda3829e70d7eec",
        definition=_definition(
            "geometry_msgs/TransformStamped[] transforms\n",
            (
                "geometry_msgs/TransformStamped",
                "Header header\nstring child_frame_id\nTransform transform\n",
            ),
            (header, _HEADER),
            ("geometry_msgs/Transform", _TRANSFORM),
            ("geometry_msgs/Vector3", _VECTOR),
            ("geometry_msgs/Quaternion", _VECTOR + "float64 w\n"),
        ),
    )


def clock() -> Connection:
    """The clock of a simulator, before REP 100 gave it to another package."""
    return Connection(
        topic="/clock",
        message_type="roslib/Clock",
        md5sum="a9c97c1d230cfc112e270351a944ee47",
        definition="time clock\n",
    )


@dataclass(frozen=True)
class Logged:
    """A message on its way into a bag; ``connection`` counts the connections from 0."""

    connection: int
    time_ns: int
    payload: bytes


@dataclass(frozen=True)
class Bag:
    """The bytes of a bag, and where its parts begin."""

    content: bytes
    chunk_starts: tuple[int, ...]
    index_start: int


def u32(number: int) -> bytes:
    return struct.pack("<I", number)


def ros_time(time_ns: int) -> bytes:
    return struct.pack("<II", time_ns // 10**9, time_ns % 10**9)


def record(data: bytes, data_size: int | None = None, **header: bytes) -> bytes:
    fields = _fields(header)
    return u32(len(fields)) + fields + u32(len(data) if data_size is None else data_size) + data


def _fields(fields: dict[str, bytes]) -> bytes:
    entries = (name.encode() + b"=" + value for name, value in fields.items())
    return b"".join(u32(len(entry)) + entry for entry in entries)


def scan_message(step: int) -> bytes:
    """A LaserScan of stamp T0 + 0.1 s · ``step``, whose range i is 1 + step / 1000 + i / 8 m."""
    ranges = (1.0 + step / 1000 + np.arange(BEAMS) / 8).astype("<f4")
    return (
        u32(step)
        + ros_time(T0_NS + step * 10**8)
        + u32(5)
        + b"laser"
        + struct.pack("<7f", -0.5, 0.6, 0.1, 0.0, 0.1, 0.1, 30.0)
        + u32(BEAMS)
        + ranges.tobytes()
        + u32(0)
    )


def transform_message(step: int) -> bytes:
    """odom to base at x = ``step`` / 10 m."""
    return (
        u32(1)
        + u32(step)
        + ros_time(T0_NS + step * 10**8)
        + u32(5)
        + b"/odom"
        + u32(5)
        + b"/base"
        + struct.pack("<7d", step / 10, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    )


def bag(
    connections: Sequence[Connection],
    messages: Iterable[Logged],
    *,
    compression: bytes = b"none",
    messages_per_chunk: int = 100,
    entry_bytes: int = 12,
) -> Bag:
    """``entry_bytes`` is what the length of index data counts for an entry, which is of 12."""
    logged = list(messages)
    body, infos = b"", b""
    starts = []
    begun: set[int] = set()
    first = len(MAGIC) + HEADER_BYTES
    for place in range(0, len(logged), messages_per_chunk):
        part = logged[place : place + messages_per_chunk]
        content = b""
        offsets: dict[int, list[tuple[int, int]]] = {}
        for message in part:
            number = message.connection
            if number not in begun:
                begun.add(number)
                content += connections[number].record(number)
            offsets.setdefault(number, []).append((message.time_ns, len(content)))
            header = {"conn": u32(number), "op": b"\x02", "time": ros_time(message.time_ns)}
            content += record(message.payload, **header)
        starts.append(first + len(body))
        packed = PACK[compression](content)
        body += record(packed, compression=compression, op=b"\x05", size=u32(len(content)))
        counts = b""
        for number, entries in sorted(offsets.items()):
            data = b"".join(ros_time(time_ns) + u32(offset) for time_ns, offset in entries)
            header = {"conn": u32(number), "count": u32(len(entries)), "op": b"\x04", "ver": u32(1)}
            body += record(data, len(entries) * entry_bytes, **header)
            counts += u32(number) + u32(len(entries))
        times = [message.time_ns for message in part]
        info = {"chunk_pos": struct.pack("<Q", starts[-1]), "count": u32(len(offsets))}
        info |= {"end_time": ros_time(max(times)), "op": b"\x06"}
        infos += record(counts, **info, start_time=ros_time(min(times)), ver=u32(1))
    index_start = first + len(body)
    header = {
        "chunk_count": u32(len(starts)),
        "conn_count": u32(len(connections)),
        "index_pos": struct.pack("<Q", index_start),
        "op": b"\x03",
    }
    head = record(b" " * (HEADER_BYTES - len(record(b"", **header))), **header)
    end = b"".join(own.record(number) for number, own in enumerate(connections)) + infos
    return Bag(MAGIC + head + body + end, tuple(starts), index_start)


def scans_and_transforms(count: int) -> list[Logged]:
    """``count`` scans of connection 0 at 10 Hz, each followed by a transform of connection 1."""
    logged = []
    for step in range(count):
        time_ns = T0_NS + step * 10**8
        logged.append(Logged(0, time_ns, scan_message(step)))
        logged.append(Logged(1, time_ns + 10**7, transform_message(step)))
    return logged


def write_old_bag(path: Path, *, scans: int = 360, compression: bytes = b"bz2") -> Path:
    """A bag of 2010: roslib/Header in the definitions, 20 bytes claimed for an index entry.

    ``scans`` each of /scan and /tf, and one message of /clock.
    """
    header = "roslib/Header"
    connections = [scans_as("/scan", header), transforms_as("/tf", header), clock()]
    logged = [*scans_and_transforms(scans), Logged(2, T0_NS + scans * 10**8, ros_time(T0_NS))]
    old = bag(
        connections,
        logged,
        compression=compression,
        messages_per_chunk=scans,
        entry_bytes=OLD_ENTRY_BYTES,
    )
    path.write_bytes(old.content)
    return path


def small_bag(compression: bytes = b"none", count: int = 8) -> Bag:
    """``count`` messages each of /scan and /tf in chunks of 5."""
    connections = [scans_as("/scan"), transforms_as("/tf")]
    return bag(
        connections,
        scans_and_transforms(count),
        compression=compression,
        messages_per_chunk=5,
    )


def write_bag_of_renamed_topic(path: Path, compression: bytes = b"none") -> Path:
    """Six bytes flipped in the index at the end: there /tf has another name, twice, as it should.

    The chunk that holds its first message still has its record as it was.
    """
    whole = small_bag(compression)
    content = bytearray(whole.content)
    at = whole.index_start
    for _ in range(2):
        at = content.index(b"topic=/tf", at) + len(b"topic=/")
        # "/tf" becomes "/uo".
        content[at] ^= 1
        content[at + 1] ^= 9
        at += 2
    path.write_bytes(content)
    return path


def write_mcap(
    path: Path,
    *,
    count: int = 8,
    compression: CompressionType = CompressionType.NONE,
    with_checksums: bool = True,
) -> list[tuple[int, int]]:
    """``count`` messages each of /scan and /tf, of ROS 1, in chunks of about five.

    Gives where the data of each chunk begin and end.
    """
    with path.open("wb") as stream:
        writer = McapWriter(
            stream, chunk_size=700, compression=compression, enable_crcs=with_checksums
        )
        writer.start(profile="ros1", library="test")
        channels = []
        for own in (scans_as("/scan"), transforms_as("/tf")):
            schema = writer.register_schema(own.message_type, "ros1msg", own.definition.encode())
            channels.append(writer.register_channel(own.topic, "ros1", schema))
        for message in scans_and_transforms(count):
            writer.add_message(
                channels[message.connection], message.time_ns, message.payload, message.time_ns
            )
        writer.finish()
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    spans = []
    for chunk in summary.chunk_indexes:
        end = chunk.chunk_start_offset + chunk.chunk_length
        spans.append((end - chunk.compressed_size, end))
    return spans


def write_flipped_mcap(
    path: Path, fraction: float, compression: CompressionType = CompressionType.NONE
) -> Path:
    """An MCAP file with checksums, one byte flipped at a ``fraction`` of the data of its chunks."""
    places = [place for span in write_mcap(path, compression=compression) for place in range(*span)]
    content = bytearray(path.read_bytes())
    content[places[int(fraction * len(places))]] ^= 0x10
    path.write_bytes(content)
    return path
