"""Damaged MCAP files: what can be read is read, what is lost is named, nothing else happens."""

import io
import random
import struct
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, IndexType, Writer

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.containers import MAX_CHUNK_BYTES
from fusion_core.recordings.indexed import IndexedRecording
from fusion_core.recordings.mcap.file import McapFile

MAGIC = b"\x89MCAP0\r\n"
S = 10**9
Found = tuple[str, int, bytes]


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: bytes | str) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def schema(number: int, name: str = "my_msgs/msg/Own", data: str = "int32 a") -> bytes:
    return record(3, struct.pack("<H", number) + text(name) + text("ros2msg") + text(data))


def channel(number: int, topic: str, encoding: str = "cdr", schema_id: int | None = None) -> bytes:
    ids = struct.pack("<HH", number, number if schema_id is None else schema_id)
    return record(4, ids + text(topic) + text(encoding) + text(b""))


def message(number: int, log_time: int, data: bytes = b"12345678") -> bytes:
    return record(5, struct.pack("<HIQQ", number, 0, log_time, log_time) + data)


def chunk(
    content: bytes,
    times: tuple[int, int] = (0, 100 * S),
    *,
    compression: str = "",
    packed: bytes | None = None,
    size: int | None = None,
) -> bytes:
    """A chunk; ``packed`` and ``size`` where they are not as ``content`` has them."""
    data = content if packed is None else packed
    head = struct.pack("<QQQI", *times, len(content) if size is None else size, zlib.crc32(content))
    return record(6, head + text(compression) + struct.pack("<Q", len(data)) + data)


def message_index(number: int, entries: list[tuple[int, int]]) -> bytes:
    return record(
        7, struct.pack("<H", number) + text(b"".join(struct.pack("<QQ", *e) for e in entries))
    )


START = MAGIC + record(1, text("ros2") + text("test"))
END = record(15, bytes(4)) + record(2, bytes(20)) + MAGIC
DEFINITIONS = schema(1) + channel(1, "/a")


def read(path: Path) -> tuple[list[Found], list[str]]:
    """Topic, log time and bytes of every message that can be read, and the warnings."""
    file = McapFile(path)
    try:
        found = []
        for received_ns, number, block, offset in file.index().tolist():
            payload = bytes(file.payload(block, offset))
            found.append((file.channels[number].topic, received_ns, payload))
        return found, file.warnings
    finally:
        file.close()


@pytest.fixture
def read_bytes(tmp_path: Path) -> Callable[[bytes], tuple[list[Found], list[str]]]:
    """Write a file of these bytes and read it."""

    def write_and_read(content: bytes) -> tuple[list[Found], list[str]]:
        path = tmp_path / "made.mcap"
        path.write_bytes(content)
        return read(path)

    return write_and_read


Read = Callable[[bytes], tuple[list[Found], list[str]]]


def readable(read_bytes: Read, content: bytes) -> tuple[list[Found], list[str]]:
    """As ``read_bytes``; nothing, and the error, where the file is refused."""
    try:
        return read_bytes(content)
    except RecordingError as error:
        return [], [str(error)]


WRITERS: dict[str, dict[str, Any]] = {
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "plain": {"compression": CompressionType.NONE},
    "plain without checksums": {"compression": CompressionType.NONE, "enable_crcs": False},
    "unchunked": {"use_chunking": False},
    "zstd without message index": {
        "compression": CompressionType.ZSTD,
        "index_types": IndexType.CHUNK,
    },
}


def written(kind: str) -> tuple[bytes, list[Found]]:
    """A file by the mcap package: 120 messages on three topics, in about eight chunks."""
    rng = random.Random(5)
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=4000, **WRITERS[kind])
    writer.start("ros2", "test")
    channels = {}
    for topic in ("/a", "/b", "/c"):
        number = writer.register_schema(f"my_msgs/msg/{topic[1:].upper()}", "ros2msg", b"int32 a")
        channels[topic] = writer.register_channel(topic, "cdr", number)
    messages = []
    for i in range(120):
        topic = rng.choice(list(channels))
        data = rng.randbytes(rng.randrange(20, 400)) + bytes(rng.randrange(100))
        writer.add_message(channels[topic], S + i * 10**7, data, S + i * 10**7, i)
        messages.append((topic, S + i * 10**7, data))
    writer.finish()
    return stream.getvalue(), messages


FILES = {kind: written(kind) for kind in WRITERS}


def reference(content: bytes) -> list[Found]:
    """The messages that the mcap package's own reader gives before it fails."""
    found = []
    try:
        for _, topic, m in NonSeekingReader(io.BytesIO(content)).iter_messages(
            log_time_order=False
        ):
            found.append((topic.topic, m.log_time, m.data))
    except Exception:  # noqa: BLE001 - Whatever it raises ends what it gives.
        pass
    return found


@pytest.mark.parametrize("kind", WRITERS)
def test_a_truncated_file_gives_what_precedes_the_cut(kind: str, read_bytes: Read) -> None:
    content, messages = FILES[kind]
    for cut in range(len(START), len(content), 487):
        expected = reference(content[:cut])
        found, reported = readable(read_bytes, content[:cut])
        assert len(found) >= len(expected)
        assert found == messages[: len(found)]
        assert "its end is missing" in reported[0]
        assert found or "no message of it can be read" in reported[0]


@pytest.mark.parametrize("kind", ["zstd", "lz4", "plain"])
def test_a_truncated_chunk_gives_its_whole_messages(kind: str, read_bytes: Read) -> None:
    rng = random.Random(2)
    messages = [message(1, i, rng.randbytes(5000)) for i in range(200)]
    content = DEFINITIONS + b"".join(messages)
    # Random bytes do not compress, so the blocks are as long as the content.
    packed = {
        "zstd": zstandard.ZstdCompressor().compress(content),
        "lz4": lz4.frame.compress(content, block_size=lz4.frame.BLOCKSIZE_MAX64KB),
        "plain": content,
    }[kind]
    block_bytes = {"zstd": 128 << 10, "lz4": 64 << 10, "plain": 1}[kind]
    head = START + chunk(
        content, (0, 199), compression="" if kind == "plain" else kind, packed=packed
    )
    for cut in (300_000, 600_000, len(head) - 1):
        found, warnings = read_bytes(head[:cut])
        behind = len(head) - cut
        there = (len(content) - behind) // block_bytes * block_bytes - len(DEFINITIONS)
        least = (there - block_bytes // 20) // len(messages[0])
        assert least <= len(found) <= (len(content) - behind) // len(messages[0])
        assert [time for _, time, _ in found] == list(range(len(found)))
        lost = f"made.mcap: Lost are {behind} bytes, from byte {cut} to {len(head)}, from "
        assert any(w.startswith(lost) and f"{len(found)} messages" in w for w in warnings)


def test_a_chunk_with_a_wrong_checksum_loses_only_itself(read_bytes: Read) -> None:
    chunks = [chunk(message(1, t * S) * 3, (t * S, t * S)) for t in range(1, 5)]
    spoiled = bytearray(chunks[2])
    spoiled[-1] ^= 1
    start = START + DEFINITIONS + chunks[0] + chunks[1]
    found, warnings = read_bytes(start + spoiled + chunks[3] + END)
    assert [time for _, time, _ in found] == [S] * 3 + [2 * S] * 3 + [4 * S] * 3
    end = len(start) + len(spoiled)
    assert warnings == [
        f"made.mcap: Lost are {len(spoiled)} bytes, from byte {len(start)} to {end}, "
        "from 2.000 s to 2.000 s: a chunk is left out, its checksum is wrong."
    ]


@pytest.mark.parametrize("kind", ["zstd", "lz4"])
def test_definitions_are_saved_from_a_damaged_chunk(kind: str, read_bytes: Read) -> None:
    content = DEFINITIONS + random.Random(1).randbytes(200_000)
    pack = zstandard.compress if kind == "zstd" else lz4.frame.compress
    packed = bytearray(pack(content))
    packed[-100_000:-50_000] = bytes(50_000)
    first = chunk(content, compression=kind, packed=bytes(packed))
    found, warnings = read_bytes(START + first + chunk(message(1, S)) + END)
    assert found == [("/a", S, b"12345678")]
    assert len(warnings) == 1
    assert "a chunk is left out" in warnings[0]


@pytest.mark.parametrize("kind", ["plain", "unchunked"])
def test_a_damaged_record_header_loses_only_its_record(kind: str, read_bytes: Read) -> None:
    records = [message(1, t * S) for t in range(1, 9)]
    if kind == "plain":
        records = [chunk(m, (t * S, t * S)) for t, m in enumerate(records, start=1)]
    place = len(START + DEFINITIONS + b"".join(records[:4]))
    whole = START + DEFINITIONS + b"".join(records) + END
    # Opcodes that are reserved or of other records, and wrong lengths.
    for at, byte in [(0, 0), (0, 0x44), (0, 0x0A), (1, 0xFF), (1, 3), (4, 0xFF), (8, 0x80)]:
        broken = bytearray(whole)
        broken[place + at] = byte
        found, warnings = read_bytes(bytes(broken))
        kept = [time // S for _, time, _ in found]
        assert set(kept) | {5} == set(range(1, 9)), (at, byte)
        # A chunk whose record states a wrong length is still complete.
        assert warnings or kept == list(range(1, 9))
        if len(kept) < 8:
            assert "after 3.000 s and before 5.000 s" in warnings[0], warnings


@given(at=st.integers(0, 10**6), data=st.binary(min_size=1, max_size=40))
def test_a_damaged_summary_loses_no_message(
    at: int, data: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    content, messages = FILES["zstd"]
    summary = make_reader(io.BytesIO(content)).get_summary()
    last = max(c.chunk_start_offset + c.chunk_length for c in summary.chunk_indexes)
    begin = content.index(record(15, b"")[:1] + struct.pack("<Q", 4), last)
    place = begin + 13 + at % (len(content) - begin - 13)
    damaged = content[:place] + data + content[place + len(data) :]
    path = tmp_path_factory.getbasetemp() / "summary.mcap"
    path.write_bytes(damaged)
    found, warnings = read(path)
    assert found == messages
    assert bool(warnings) == (damaged != content)


def test_a_summary_replaces_definitions_that_are_lost(read_bytes: Read) -> None:
    content, messages = FILES["unchunked"]
    place = content.index(b"\x02\0\0\0/b")
    damaged = bytearray(content)
    damaged[place : place + 4] = b"\xff" * 4
    found, warnings = read_bytes(bytes(damaged))
    assert found == messages
    assert "no record can be read there" in warnings[0]


def test_a_lost_channel_loses_only_its_topic(read_bytes: Read) -> None:
    other = bytearray(channel(2, "/b"))
    other[13] = 0xFF
    messages = b"".join(message(1 + i % 2, i * S) for i in range(6))
    found, warnings = read_bytes(START + DEFINITIONS + bytes(other) + messages + END)
    assert [(topic, time) for topic, time, _ in found] == [("/a", 0), ("/a", 2 * S), ("/a", 4 * S)]
    assert any("3 messages from 1.000 s to 5.000 s are left out" in w for w in warnings)


def test_a_lost_schema_loses_only_its_topic(tmp_path: Path) -> None:
    other = bytearray(schema(2, "sensor_msgs/msg/LaserScan"))
    other[11] = 0xFF
    path = tmp_path / "a.mcap"
    messages = message(1, 0) + message(2, 1)
    path.write_bytes(START + DEFINITIONS + bytes(other) + channel(2, "/b") + messages + END)
    with IndexedRecording(path, "MCAP file", [McapFile(path)]) as recording:
        assert {t.name: t.count for t in recording.topics} == {"/a": 1, "/b": 1}
        assert "/b is left out: the file does not tell its type." in recording.warnings


@pytest.mark.parametrize("encoding", ["json", "protobuf", "cbor"])
def test_other_encodings_are_left_out_by_name(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    channels = channel(2, "/plot", encoding, 0) + channel(3, "/other", encoding, 1)
    path.write_bytes(START + DEFINITIONS + channels + message(2, 1) + message(3, 2) + END)
    with IndexedRecording(path, "MCAP file", [McapFile(path)]) as recording:
        assert {t.name: t.count for t in recording.topics} == {"/a": 0, "/other": 1, "/plot": 1}
        for topic in ("/plot", "/other"):
            assert any(
                w.startswith(f"{topic} is left out") and encoding in w for w in recording.warnings
            )


def test_a_service_event_loses_only_its_topic(build: Callable[[str], Any], tmp_path: Path) -> None:
    service = schema(1, "sensor_msgs/msg/LaserScan", "float32 a\n---\nfloat32 b\n---\n")
    path = tmp_path / "a.mcap"
    pose = schema(2, "geometry_msgs/msg/PoseStamped", "int32 a")
    channels = channel(1, "/service") + channel(2, "/pose")
    path.write_bytes(START + service + pose + channels + message(1, 1) + message(2, 2) + END)
    with IndexedRecording(path, "MCAP file", [McapFile(path)]) as recording:
        assert {t.name: t.role for t in recording.topics} == {"/service": "other", "/pose": "pose"}
        assert any(w.startswith("/service is left out") for w in recording.warnings)


def test_a_chunk_followed_by_its_index_is_not_decompressed(read_bytes: Read) -> None:
    body = message(1, S) + message(1, 2 * S)
    index = message_index(1, [(S, 0), (2 * S, len(message(1, S)))])
    spoiled = chunk(body, (S, 2 * S), packed=bytes(len(body)))
    with pytest.raises(RecordingError, match="checksum"):
        read_bytes(START + DEFINITIONS + spoiled + index + END)
    # An index that contradicts its chunk is not used.
    for entries in ([(S, 0), (3 * S, 39)], [(S, 0), (2 * S, 900)], [(S, 0), (S, 0)]):
        good = chunk(body, (S, 2 * S))
        content = START + DEFINITIONS + good + message_index(1, entries) + END
        assert [time for _, time, _ in read_bytes(content)[0]] == [S, 2 * S]


def test_a_repeated_chunk_counts_once(read_bytes: Read) -> None:
    first = chunk(message(1, S), (S, S))
    found, warnings = read_bytes(START + DEFINITIONS + first + first + END)
    assert len(found) == 1
    assert "stands there again" in warnings[0]


def bomb(compression: str, size: int) -> bytes:
    zeros = bytes(1 << 20)
    if compression == "zstd":
        packer = zstandard.ZstdCompressor().compressobj()
        return b"".join(packer.compress(zeros) for _ in range(size >> 20)) + packer.flush()
    frame = lz4.frame.LZ4FrameCompressor()
    pieces = [frame.begin(), *(frame.compress(zeros) for _ in range(size >> 20)), frame.flush()]
    return b"".join(pieces)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed", [1 << 20, MAX_CHUNK_BYTES + 1, 4 << 30, (1 << 64) - 1])
def test_a_chunk_that_unpacks_to_too_much_loses_only_itself(
    compression: str, claimed: int, read_bytes: Read
) -> None:
    packed = bomb(compression, 64 << 20)
    hostile = chunk(b"", compression=compression, packed=packed, size=claimed)
    content = START + DEFINITIONS + chunk(message(1, S)) + hostile + chunk(message(1, 2 * S)) + END
    tracemalloc.start()
    try:
        found, warnings = read_bytes(content)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert [time for _, time, _ in found] == [S, 2 * S]
    assert str(claimed) in warnings[0]
    assert peak < 16 << 20


def test_messages_take_no_more_memory_than_their_file(read_bytes: Read) -> None:
    # A million equal messages in a few kilobytes: a bomb of records.
    content = message(1, S, b"") * 1_000_000
    packed = chunk(content, (S, S), compression="zstd", packed=zstandard.compress(content))
    file = START + DEFINITIONS + chunk(message(1, 0)) + packed + END
    found, warnings = read_bytes(file)
    assert 1 <= len(found) <= len(file)
    assert "no records" in warnings[0]


def test_names_and_numbers_of_channels_are_bounded(read_bytes: Read) -> None:
    long = channel(2, "/" + "x" * 5000)
    control = channel(3, "/a\n/b")
    many = b"".join(channel(n, f"/t{n}", schema_id=1) for n in range(10, 5000))
    messages = b"".join(message(n, S) for n in (1, 2, 3, 10, 4999))
    # Anything after the data is read as the summary.
    again = (
        record(15, bytes(4)) + channel(4999, "/t4999", schema_id=1) + record(2, bytes(20)) + MAGIC
    )
    found, warnings = read_bytes(START + DEFINITIONS + long + control + many + messages + again)
    assert [topic for topic, _, _ in found] == ["/a", "/t10"]
    assert any("schemas or channels cannot be read" in w for w in warnings)
    assert sum("1 messages" in w for w in warnings) == 3


def test_a_hostile_summary_is_not_used(read_bytes: Read) -> None:
    body = DEFINITIONS + message(1, S)
    only = chunk(body, (S, S))
    index = message_index(1, [(S, len(DEFINITIONS))])
    data = START + only + index + record(15, bytes(4))

    def chunk_index(position: int, length: int, index_bytes: int) -> bytes:
        head = struct.pack("<QQQQI", S, S, position, length, 0) + struct.pack("<Q", index_bytes)
        return record(8, head + text("") + struct.pack("<QQ", len(body), len(body)))

    honest = chunk_index(len(START), len(only), len(index))
    for indexes in (
        honest * 50,
        chunk_index(len(START), len(only), 1 << 62),
        chunk_index((1 << 64) - 1, (1 << 64) - 1, len(index)),
        record(8, struct.pack("<QQQQI", S, S, 0, 0, (1 << 32) - 1)),
    ):
        count = 50 if indexes == honest * 50 else 1
        statistics = record(11, struct.pack("<QHIIIIQQI", count, 1, 1, 0, 0, 1, S, S, 0))
        summary = DEFINITIONS + statistics + indexes
        footer = record(2, struct.pack("<QQI", len(data), 0, 0))
        found, _ = read_bytes(data + summary + footer + MAGIC)
        assert found == [("/a", S, b"12345678")]


def test_a_file_without_a_message_is_refused_in_one_line(read_bytes: Read) -> None:
    for content in (MAGIC, START, START + DEFINITIONS, START + bytes(5000), b"no MCAP" * 100):
        with pytest.raises(RecordingError, match="no message of it can be read") as caught:
            read_bytes(content)
        assert "\n" not in str(caught.value)
    # Whole, and nothing in it.
    assert read_bytes(START + END) == ([], [])


def mutations(content: bytes, count: int, seed: int) -> Iterator[bytes]:
    """Flipped bits, huge counts, swapped and missing pieces, noise; up to three at once."""
    rng = random.Random(seed)
    for _ in range(count):
        data = bytearray(content)
        for _ in range(rng.randrange(1, 4)):
            at = rng.randrange(len(data) - 400)
            other = rng.randrange(len(data) - 400)
            match rng.randrange(6):
                case 0:
                    data[at] ^= 1 << rng.randrange(8)
                case 1:
                    data[at : at + 8] = rng.choice([b"\xff" * 8, bytes(8), b"\xff" * 7 + b"\x7f"])
                case 2:
                    data[at : at + 8], data[other : other + 8] = (
                        data[other : other + 8],
                        data[at : at + 8],
                    )
                case 3:
                    del data[at : at + rng.randrange(1, 400)]
                case 4:
                    data[at:at] = data[other : other + rng.randrange(1, 400)]
                case 5:
                    data[at : at + 50] = rng.randbytes(50)
        yield bytes(data)


@pytest.mark.parametrize("kind", ["zstd", "plain without checksums", "unchunked"])
def test_mutated_files_are_read_or_refused(kind: str, tmp_path: Path) -> None:
    content, messages = FILES[kind]
    path = tmp_path / "a.mcap"
    recovered = 0
    for data in mutations(content, 200, seed=11):
        path.write_bytes(data)
        file = McapFile(path)
        reported, good = file.warnings, 0
        try:
            for _, _, block, offset in file.index().tolist():
                with suppress(RecordingError):
                    file.payload(block, offset)
                    good += 1
        except RecordingError as error:
            reported = [str(error)]
        finally:
            file.close()
        recovered += good
        # An undamaged summary may index a damaged chunk, which is reported when it is read.
        assert reported or good == len(messages) or kind != "unchunked"
        assert all("\n" not in line for line in reported)
    assert recovered > 0.7 * 200 * len(messages)


@pytest.mark.data
def test_real_files_truncated_and_whole(data_folder: Path, read_bytes: Read) -> None:
    files = sorted((data_folder / "real").rglob("*.mcap"))
    assert len(files) > 20
    for path in files:
        content = path.read_bytes()
        whole = reference(content)
        assert read(path) == (whole, []), path
        for fraction in (0.01, 0.5, 0.99):
            cut = content[: int(fraction * len(content))]
            found, _ = readable(read_bytes, cut)
            assert len(found) >= len(reference(cut)), (path, fraction)
            assert found == whole[: len(found)], (path, fraction)
