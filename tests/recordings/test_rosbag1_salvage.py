"""Truncated, unfinished, damaged and hostile ROS 1 bags: what can be read, and the warnings.

The bags are put together byte by byte after wiki.ros.org/Bags/Format/2.0, or by rosbags' writer.
"""

import bz2
import contextlib
import random
import struct
import tracemalloc
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.rosbag1.bag import open_rosbag1
from fusion_core.recordings.rosbag1.records import SearchBudget, find_record

T0_S = 1_700_000_000
MAGIC = b"#ROSBAG V2.0\n"
DEFINITION = """Header header
Pose pose
===
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
===
MSG: geometry_msgs/Pose
Point position
Quaternion orientation
===
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
===
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
""".replace("===", "=" * 80)
PACK: dict[bytes, Callable[[bytes], bytes]] = {
    b"none": bytes,
    b"bz2": lambda content: bz2.compress(content, 1),
    b"lz4": lambda content: lz4.frame.compress(
        content, block_size=lz4.frame.BLOCKSIZE_MAX64KB, content_checksum=True
    ),
}
COMPRESSIONS = list(PACK)


def u32(number: int) -> bytes:
    return struct.pack("<I", number)


def record(data: bytes, data_size: int | None = None, **header: bytes) -> bytes:
    fields = b"".join(
        u32(len(name) + 1 + len(value)) + name.encode() + b"=" + value
        for name, value in header.items()
    )
    size = len(data) if data_size is None else data_size
    return u32(len(fields)) + fields + u32(size) + data


def connection(number: int, topic: str) -> bytes:
    entries = {
        "topic": topic,
        "type": "geometry_msgs/PoseStamped",
        "md5sum": "d3812c3cbc69362b77dc0b19b345f8f5",
        "message_definition": DEFINITION,
    }
    data = b"".join(
        u32(len(name) + 1 + len(text)) + f"{name}={text}".encode() for name, text in entries.items()
    )
    return record(data, op=b"\x07", conn=u32(number), topic=topic.encode())


def pose(step: int, padding: int = 0) -> bytes:
    """A PoseStamped at x = ``step``; the padding is in the name of its frame."""
    # Random letters, so that they hardly compress.
    frame = random.Random(step).choices(range(97, 123), k=padding)
    return (
        struct.pack("<IIII", step, T0_S, step, padding)
        + bytes(frame)
        + struct.pack("<7d", step, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    )


def log_time(step: int) -> bytes:
    return struct.pack("<II", T0_S + step, 0)


def message(number: int, step: int, padding: int = 0) -> bytes:
    return record(pose(step, padding), op=b"\x02", conn=u32(number), time=log_time(step))


@dataclass
class Bag:
    """A bag being written: even steps go to /a (connection 0), odd ones to /b (connection 1)."""

    compression: bytes = b"none"
    padding: int = 0
    body: bytes = b""
    infos: bytes = b""
    starts: list[int] = field(default_factory=list)
    """Where each chunk begins."""
    packed: list[tuple[int, int]] = field(default_factory=list)
    """Where the data of each chunk begin and end."""

    def add_chunk(self, steps: range, *, connections: bytes | None = None) -> "Bag":
        start = len(MAGIC) + 4096 + len(self.body)
        content = connection(0, "/a") + connection(1, "/b") if connections is None else connections
        offsets: dict[int, list[tuple[int, int]]] = {0: [], 1: []}
        for step in steps:
            offsets[step % 2].append((step, len(content)))
            content += message(step % 2, step, self.padding)
        packed = PACK[self.compression](content)
        header = {"op": b"\x05", "compression": self.compression, "size": u32(len(content))}
        chunk = record(packed, **header)
        self.starts.append(start)
        self.packed.append((start + len(chunk) - len(packed), start + len(chunk)))
        self.body += chunk
        counts = b""
        for number, entries in offsets.items():
            data = b"".join(log_time(step) + u32(offset) for step, offset in entries)
            index = {"op": b"\x04", "ver": u32(1), "conn": u32(number), "count": u32(len(entries))}
            self.body += record(data, **index)
            counts += u32(number) + u32(len(entries))
        info = {"op": b"\x06", "ver": u32(1), "chunk_pos": struct.pack("<Q", start)}
        info |= {"start_time": log_time(steps[0]), "end_time": log_time(steps[-1])}
        self.infos += record(counts, **info, count=u32(2))
        return self

    def content(self, *, finished: bool = True) -> bytes:
        index_start = len(MAGIC) + 4096 + len(self.body)
        header = {
            "op": b"\x03",
            "index_pos": struct.pack("<Q", index_start if finished else 0),
            "conn_count": u32(2 if finished else 0),
            "chunk_count": u32(len(self.starts) if finished else 0),
        }
        bare = record(b"", **header)
        head = MAGIC + record(b" " * (4096 - len(bare)), **header) + self.body
        return head + connection(0, "/a") + connection(1, "/b") + self.infos if finished else head


def three_chunks(compression: bytes = b"none", padding: int = 0) -> Bag:
    bag = Bag(compression, padding)
    return bag.add_chunk(range(10)).add_chunk(range(10, 20)).add_chunk(range(20, 30))


@dataclass(frozen=True)
class Found:
    """The steps that a bag still has, each with its topic and value checked."""

    steps: list[int]
    warnings: list[str]

    def warns_of(self, *parts: str) -> bool:
        return any(all(part in warning for part in parts) for warning in self.warnings)


@pytest.fixture
def read(tmp_path: Path) -> Callable[[bytes], Found]:
    def read(content: bytes) -> Found:
        path = tmp_path / "a.bag"
        path.write_bytes(content)
        steps = []
        with open_rosbag1(path) as recording:
            for m in recording.messages():
                step = int(m.value.T_parent_child[0, 3])
                assert m.topic == ("/a", "/b")[step % 2]
                assert m.received_ns == (T0_S + step) * 10**9
                assert recording.read(m.topic, m.index).value.stamp_ns == m.value.stamp_ns
                steps.append(step)
            assert not any("\n" in warning for warning in recording.warnings)
            return Found(steps, list(recording.warnings))

    return read


Read = Callable[[bytes], Found]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_bags_of_these_tests_are_whole(read: Read, tmp_path: Path, compression: bytes) -> None:
    found = read(three_chunks(compression).content())
    assert found == Found(list(range(30)), [])
    # rosbags agrees that they are bags.
    with Reader(tmp_path / "a.bag") as reader:
        assert sum(1 for _ in reader.messages()) == 30


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_an_unfinished_recording_loses_nothing(read: Read, compression: bytes) -> None:
    found = read(three_chunks(compression).content(finished=False))
    assert found.steps == list(range(30))
    assert len(found.warnings) == 1
    assert found.warns_of("did not finish")


def test_plain_chunks_are_read_up_to_the_last_whole_message(read: Read) -> None:
    bag = three_chunks()
    content = bag.content()
    ends = [content.find(message(s % 2, s)) + len(message(s % 2, s)) for s in range(30)]
    for step in (0, 9, 10, 15, 29):
        for cut, count in ((ends[step] - 1, step), (ends[step], step + 1)):
            if count == 0:
                with pytest.raises(RecordingError, match="no message can be read"):
                    read(content[:cut])
                continue
            found = read(content[:cut])
            assert found.steps == list(range(count))
            assert found.warns_of(
                "cut short", f"ends at byte {cut}", f"index at byte {bag_end(bag)}"
            )
    # Cut within a message: the bytes and the time from which on all is lost.
    start = ends[14]
    found = read(content[: start + 30])
    assert found.warns_of(f"Bytes {start} to {start + 30} of", f"logged after {T0_S + 14}.000 s")


def bag_end(bag: Bag) -> int:
    return len(MAGIC) + 4096 + len(bag.body)


@pytest.mark.parametrize("compression", [b"bz2", b"lz4"])
def test_a_truncated_compressed_chunk_gives_its_first_messages(
    read: Read, compression: bytes
) -> None:
    # Blocks of 64 and of 100 KB: of 400 KB in the last chunk, some are whole.
    bag = Bag(compression, padding=4000).add_chunk(range(10)).add_chunk(range(10, 20))
    start, end = bag.add_chunk(range(20, 120)).packed[2]
    found = read(bag.content()[: start + (end - start) * 3 // 4])
    assert found.steps == list(range(len(found.steps)))
    assert 60 <= len(found.steps) < 100
    assert found.warns_of(f"Bytes {bag.starts[2]} to", "breaks off after", "logged after")


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_cut_at_the_end_of_a_chunk_loses_only_its_successors(
    read: Read, compression: bytes
) -> None:
    bag = three_chunks(compression)
    # Behind the chunk, and within the index data behind it, and between two of them.
    for cut in (bag.packed[1][1], bag.packed[1][1] + 70, bag.packed[1][1] + 55 + 5 * 12):
        found = read(bag.content()[:cut])
        assert found.steps == list(range(20))
        assert found.warns_of("Of 3 chunks and 2 connections in its header, 2 and 2 are found")


def test_a_cut_in_the_index_at_the_end_loses_no_message(read: Read) -> None:
    content = three_chunks().content()
    for lost in (1, 100, 500):
        found = read(content[:-lost])
        assert found.steps == list(range(30))
        assert found.warns_of(f"to {len(content) - lost} of {len(content) - lost} are lost")


@pytest.mark.parametrize("compression", [b"bz2", b"lz4"])
@pytest.mark.parametrize("finished", [True, False])
def test_a_chunk_of_garbage_loses_only_itself(
    read: Read, compression: bytes, finished: bool
) -> None:
    bag = three_chunks(compression)
    content = bytearray(bag.content(finished=finished))
    start, end = bag.packed[1]
    content[start:end] = random.Random(1).randbytes(end - start)
    found = read(bytes(content))
    assert found.steps == [*range(10), *range(20, 30)]
    # The index data after the chunk still hold the number of its messages.
    assert found.warns_of("/a: 5 of 15 messages are left out", f"chunk at byte {bag.starts[1]}")
    # Without them the bytes are all that is known.
    behind = bag.starts[2] - end
    found = read(bytes(content[:end] + bytes(behind) + content[end + behind :]))
    assert found.steps == [*range(10), *range(20, 30)]
    assert found.warns_of(f"Bytes {bag.starts[1]} to", f"between {T0_S + 9}.000 s and {T0_S + 20}")
    assert found.warns_of("10 of the 30 messages in its index", f"to {T0_S + 19}.000 s") is finished


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("finished", [True, False])
def test_a_chunk_without_its_header(read: Read, compression: bytes, finished: bool) -> None:
    bag = three_chunks(compression)
    content = bytearray(bag.content(finished=finished))
    content[bag.starts[1] + 4] ^= 0xFF
    found = read(bytes(content))
    kept = compression == b"none"
    assert found.steps == ([*range(30)] if kept else [*range(10), *range(20, 30)])
    assert found.warns_of(f"Bytes {bag.starts[1]} to", "no whole record")
    assert found.warns_of("10 of the 30 messages in its index are lost") is (finished and not kept)


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("length", [0, 1000, 1 << 30, 0xFFFFFFFF])
def test_a_chunk_with_a_wrong_length_is_still_read(
    read: Read, compression: bytes, length: int
) -> None:
    bag = three_chunks(compression)
    content = bytearray(bag.content())
    start = bag.packed[1][0]
    content[start - 4 : start] = u32(length)
    assert read(bytes(content)).steps == list(range(30))


def test_a_record_in_a_chunk_without_its_header(read: Read) -> None:
    bag = three_chunks()
    at = bag.content().find(message(1, 13))
    for finished in (True, False):
        content = bytearray(bag.content(finished=finished))
        content[at] ^= 0xFF
        found = read(bytes(content))
        assert found.steps == [*range(13), *range(14, 30)]
        assert found.warns_of("/b: 1 of 15 messages are left out")
        # Without index data its neighbours are found by themselves.
        end = bag.packed[1][1]
        found = read(bytes(content[:end] + content[bag.starts[2] :]))
        assert found.steps == [*range(13), *range(14, 30)]
        size = len(message(1, 13))
        assert found.warns_of(f"{size} of the", "bytes in its chunk are no records")


def test_index_data_that_contradict_the_index_at_the_end_are_not_used(read: Read) -> None:
    bag = three_chunks()
    content = bag.content()
    index = bag.packed[1][1]
    a_then_b = content[index : bag.starts[2]]
    swapped = a_then_b.replace(b"conn=" + u32(0), b"conn=" + u32(7))
    found = read(content[:index] + swapped + content[bag.starts[2] :])
    assert found.steps == list(range(30))
    later = a_then_b.replace(log_time(12), log_time(12_000))
    found = read(content[:index] + later + content[bag.starts[2] :])
    assert found.steps == list(range(30))


def test_connections_are_found_in_the_chunks_where_the_end_is_lost(read: Read) -> None:
    bag = Bag(b"lz4").add_chunk(range(0, 20, 2), connections=connection(0, "/a"))
    bag.add_chunk(range(21, 41, 2), connections=connection(1, "/b"))
    found = read(bag.content(finished=False))
    assert found.steps == [*range(0, 20, 2), *range(21, 41, 2)]


def test_a_lost_connection_loses_only_its_topic(read: Read) -> None:
    bag = Bag(b"lz4").add_chunk(range(10), connections=connection(1, "/b"))
    found = read(bag.content(finished=False))
    assert found.steps == [1, 3, 5, 7, 9]
    assert found.warns_of("5 messages are left out: the records of their topics are lost")


def test_a_bag_without_chunks(read: Read) -> None:
    bag = Bag(body=connection(0, "/a") + connection(1, "/b"))
    bag.body += b"".join(message(step % 2, step) for step in range(8))
    assert read(bag.content()) == Found(list(range(8)), [])


def test_chunks_in_any_order(read: Read) -> None:
    bag = Bag(b"bz2").add_chunk(range(20, 30)).add_chunk(range(10))
    assert read(bag.content()) == Found([*range(10), *range(20, 30)], [])


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(junk=st.lists(st.binary(max_size=40), min_size=9, max_size=9))
def test_junk_between_records_loses_no_record(read: Read, junk: list[bytes]) -> None:
    # Two whole messages follow each other, so that each is found.
    pairs = [message(0, step) + message(1, step + 1) for step in range(0, 18, 2)]
    body = b"".join(junk_bytes + pair for junk_bytes, pair in zip(junk, pairs, strict=True))
    bag = Bag(body=connection(0, "/a") + connection(1, "/b") + body)
    found = read(bag.content(finished=False))
    assert found.steps == list(range(18))


def test_records_that_show_in_compressed_data_are_not_taken_for_records(read: Read) -> None:
    # lz4 keeps the header of the first message as it is, and shortens its data.
    time = struct.pack("<II", T0_S + 10, 123_456_789)
    content = record(pose(10), op=b"\x02", conn=u32(0), time=time)
    packed = PACK[b"lz4"](content)
    assert content[: -len(pose(10))] in packed
    bag = Bag(b"lz4").add_chunk(range(10))
    bag.body += record(packed, op=b"?", compression=b"lz4", size=u32(len(content)))
    found = read(bag.add_chunk(range(20, 30)).content())
    assert found.steps == [*range(10), *range(20, 30)]
    assert not found.warns_of("cannot be read")


def test_a_search_is_bounded() -> None:
    record_bytes = message(0, 1)
    stream, end = BytesIO(bytes(99) + record_bytes), 99 + len(record_bytes)
    assert find_record(stream, 0, end, SearchBudget()) == 99
    assert find_record(stream, 0, end, SearchBudget(places=5)) == end
    far = BytesIO(bytes(1 << 20) + record_bytes)
    end = (1 << 20) + len(record_bytes)
    assert find_record(far, 0, end, SearchBudget()) == 1 << 20
    assert find_record(far, 0, end, SearchBudget(file_bytes=1 << 19)) == end


BOMB_BYTES = 64 << 20


def zeros(compression: bytes) -> bytes:
    return PACK[compression](bytes(BOMB_BYTES))


@pytest.mark.parametrize("compression", [b"bz2", b"lz4"])
@pytest.mark.parametrize(
    ("claimed", "warning"), [(0xFFFFFFFF, "it claims 4294967295 bytes"), (5000, "holds more than")]
)
def test_a_decompression_bomb_loses_only_itself(
    read: Read, compression: bytes, claimed: int, warning: str
) -> None:
    bag = three_chunks(compression)
    header = {"op": b"\x05", "compression": compression, "size": u32(claimed)}
    bomb = record(zeros(compression), **header)
    tracemalloc.start()
    try:
        found = read(bag.content(finished=False) + bomb)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.steps == list(range(30))
    assert found.warns_of(warning)
    assert peak < BOMB_BYTES // 4


@pytest.mark.parametrize(
    "hostile",
    [
        pytest.param(record(b"", 0xFFFFFFFF, op=b"\x02", conn=u32(0), time=log_time(1)), id="data"),
        pytest.param(u32(0xFFFFFFFF) + b"x" * 99, id="header"),
        pytest.param(
            record(b"", op=b"\x04", ver=u32(1), conn=u32(0), count=u32(0xFFFFFFFF)), id="count"
        ),
        pytest.param(connection(2, "/" + "t" * 2000), id="name"),
        pytest.param(b"\x04\0\0\0op=\x05" * 200_000, id="opcodes"),
        pytest.param(
            record(b"", 1 << 31, op=b"\x05", compression=b"lz4", size=u32(9)) * 20_000, id="chunks"
        ),
    ],
)
def test_hostile_records_lose_only_themselves(read: Read, hostile: bytes) -> None:
    found = read(three_chunks().content(finished=False) + hostile)
    assert found.steps == list(range(30))
    assert found.warns_of("Bytes", "are lost")
    assert len(found.warnings) < 10


def test_the_number_of_topics_is_bounded(tmp_path: Path) -> None:
    bag = Bag(body=b"".join(connection(n, f"/t{n}") for n in range(5000)) + message(0, 0))
    path = tmp_path / "a.bag"
    path.write_bytes(bag.content(finished=False).replace(b"PoseStamped", b"PoseUnknown"))
    with open_rosbag1(path) as recording:
        assert len(recording.topics) == 4096


@pytest.mark.parametrize("kept", [0, 13, 100, 4500])
def test_what_has_no_message_left_is_refused_in_one_line(read: Read, kept: int) -> None:
    content = three_chunks(b"bz2").content()
    with pytest.raises(RecordingError, match="no message can be read") as caught:
        read(content[:kept])
    assert "\n" not in str(caught.value)


def test_a_bag_without_messages_is_whole(read: Read) -> None:
    assert read(Bag().content()) == Found([], [])


def test_an_encrypted_bag_is_refused(read: Read) -> None:
    content = three_chunks().content()
    header = {"op": b"\x03", "index_pos": struct.pack("<Q", 9), "conn_count": u32(1)}
    header |= {"chunk_count": u32(1), "encryptor": b"rosbag/AesCbcEncryptor"}
    with pytest.raises(RecordingError, match="AesCbcEncryptor"):
        read(MAGIC + record(b" " * 4000, **header) + content[len(MAGIC) + 4096 :])


def mutations(content: bytes, count: int, seed: int) -> Iterator[bytes]:
    """Flipped bits, swapped and huge lengths, pieces repeated and left out."""
    rng = random.Random(seed)
    for _ in range(count):
        data = bytearray(content)
        at, other = rng.randrange(len(data) - 8), rng.randrange(len(data) - 8)
        match rng.randrange(5):
            case 0:
                data[at] ^= 1 << rng.randrange(8)
            case 1:
                data[at : at + 4] = rng.choice([b"\xff\xff\xff\xff", bytes(4), b"\xff\xff\xff\x7f"])
            case 2:
                data[other:other] = data[at : at + rng.randrange(3000)]
            case 3:
                del data[at : at + rng.randrange(500)]
            case 4:
                data[at : at + 4], data[other : other + 4] = (
                    data[other : other + 4],
                    data[at : at + 4],
                )
        yield bytes(data)


@pytest.mark.parametrize("name", ["rosbag1", "rosbag1 lz4", "rosbag1 bz2"])
def test_mutated_bags_give_what_is_left(build: Callable[[str], Any], name: str) -> None:
    sample = build(name)
    content = sample.path.read_bytes()
    fractions = []
    for data in mutations(content, 80, seed=5):
        sample.path.write_bytes(data)
        found = 0
        with contextlib.suppress(RecordingError), open_rosbag1(sample.path) as recording:
            found = sum(1 for _ in recording.messages())
            assert found >= len(sample.written) or recording.warnings
        fractions.append(found / len(sample.written))
    # One mutation loses a message, a chunk or a topic, not the bag.
    assert sum(fractions) / len(fractions) > 0.9


@pytest.mark.data
@pytest.mark.parametrize("fraction", [0.5, 0.99])
def test_a_truncated_real_bag(data_folder: Path, tmp_path: Path, fraction: float) -> None:
    whole = data_folder / "real/bags/guardian_3.bag"
    with Reader(whole) as reader:
        count = reader.message_count
        largest = max(sum(info.connection_counts.values()) for info in reader.chunk_infos)
    content = whole.read_bytes()
    cut = tmp_path / "cut.bag"
    cut.write_bytes(content[: int(fraction * len(content))])
    with open_rosbag1(cut) as recording:
        found = sum(topic.count for topic in recording.topics)
    assert found >= fraction * count - largest
