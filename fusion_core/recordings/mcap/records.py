"""Records of an MCAP file (layout: mcap.dev/spec). Every length is checked before it is used.

A record is one byte of opcode, eight of length, then the content. Numbers are little-endian.
"""

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]  # Ships no type information.
import numpy as np
import zstandard
from mcap.opcode import Opcode

from fusion_core.recordings.containers import ENTRY, MAX_CHUNK_BYTES, Entries
from fusion_core.recordings.decompression import decompress_pieces

RECORD_HEADER = struct.Struct("<BQ")
# Opcode, length, channel, sequence, log time, publish time; the payload follows.
MESSAGE_HEADER = struct.Struct("<BQHIQQ")
INDEX_HEADER = struct.Struct("<BQHI")
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
_MESSAGE_BYTES = MESSAGE_HEADER.size - RECORD_HEADER.size
MAX_TIME_NS = int(np.iinfo(np.int64).max)

# First and last log time, size unpacked, CRC, length of the compression's name.
_CHUNK_HEADER = struct.Struct("<QQQII")
_COMPRESSIONS = ("", "zstd", "lz4")
_LENGTH = {"s": struct.Struct("<I"), "l": struct.Struct("<Q")}
# The fields of each kind of record: so many bytes, or bytes behind their length in four (s) or
# eight (l) bytes.
_FIELDS: dict[int, tuple[int | str, ...]] = {
    Opcode.HEADER: ("s", "s"),
    Opcode.FOOTER: (20,),
    Opcode.SCHEMA: (2, "s", "s", "s"),
    Opcode.CHANNEL: (4, "s", "s", "s"),
    Opcode.MESSAGE: (22,),
    Opcode.CHUNK: (28, "s", "l"),
    Opcode.MESSAGE_INDEX: (2, "s"),
    Opcode.CHUNK_INDEX: (32, "s", 8, "s", 16),
    Opcode.ATTACHMENT: (16, "s", "s", "l", 4),
    Opcode.ATTACHMENT_INDEX: (40, "s", "s"),
    Opcode.STATISTICS: (42, "s"),
    Opcode.METADATA: ("s", "s"),
    Opcode.METADATA_INDEX: (16, "s"),
    Opcode.SUMMARY_OFFSET: (17,),
    Opcode.DATA_END: (4,),
}
# Opcodes from here on belong to applications; those between are reserved.
_FIRST_PRIVATE_OPCODE = 0x80

# Enough for the header of a message, and for many small records in one read.
_HEAD_BYTES = MESSAGE_HEADER.size
_BLOCK_BYTES = 1 << 12
_PIECE_BYTES = 1 << 20
# Small steps, to recover the content up to close before the damage of a stream.
_STEP_BYTES = 1 << 14
# What a zstd frame may ask for besides its content.
_MAX_WINDOW_BYTES = 64 << 20
# The opcodes that carry messages or what is needed to read them, with a length below 4 GiB.
_CANDIDATE = re.compile(rb"[\x03-\x07\x0f](?=[\s\S]{4}\0{4})")
# Enough to find the record after many damaged chunks, and few enough to end within seconds.
_SEARCHED_BYTES = 512 << 20
_SEARCHED_CANDIDATES = 300_000


class Record(NamedTuple):
    """The position of a record in the file. ``fields_end`` is the end of its known fields.

    Either end may lie behind the end of the file, where that is cut. ``head`` are its first bytes.
    """

    opcode: int
    position: int
    end: int
    fields_end: int
    head: bytes


@dataclass(frozen=True, slots=True)
class DecompressedChunk:
    """The content of a chunk; up to the damage that ``problem`` describes if that is not empty."""

    content: bytes
    problem: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """The header of a chunk. ``start_ns`` and ``end_ns`` are its first and last log time."""

    position: int
    data_start: int
    data_end: int
    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str


class RecordFile:
    """Reads records and chunks of an open file; every claim is checked before memory is taken.

    Methods raise ValueError with a short reason for damaged content.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.size = file.seek(0, 2)
        self._file = file
        self._searchable_bytes = _SEARCHED_BYTES
        self._searchable_candidates = _SEARCHED_CANDIDATES
        self._block, self._block_start = b"", 0
        self._last: tuple[int, Record | None] = (-1, None)

    def read(self, position: int, size: int) -> bytes:
        if not 0 <= size <= self.size - position:
            raise ValueError(f"{size} bytes at byte {position} are not there")
        self._file.seek(position)
        return self._file.read(size)

    def record(self, position: int) -> Record | None:
        """The record at a position, None where none can be. The file's end may truncate it."""
        # Kept, since ``follows`` is usually called before the record itself is needed.
        if position != self._last[0]:
            self._last = position, self._read_record(position)
        return self._last[1]

    def _read_record(self, position: int) -> Record | None:
        if not 0 <= position <= self.size - RECORD_HEADER.size:
            return None
        head = self._head(position)
        opcode, length = RECORD_HEADER.unpack_from(head)
        place = position + RECORD_HEADER.size
        end = place + length
        if opcode >= _FIRST_PRIVATE_OPCODE:
            return Record(opcode, position, end, end, head) if end <= self.size else None
        if opcode not in _FIELDS:
            return None
        for field in _FIELDS[opcode]:
            if isinstance(field, str):
                number = _LENGTH[field]
                if place + number.size > self.size:
                    break
                place += number.size + number.unpack(self.read(place, number.size))[0]
            else:
                place += field
        # The data's length of a chunk may be right where that of the record is wrong.
        fits = place <= end or opcode == Opcode.CHUNK
        return Record(opcode, position, end, place, head) if fits else None

    def _head(self, position: int) -> bytes:
        start = position - self._block_start
        if not 0 <= start <= len(self._block) - _HEAD_BYTES:
            self._block = self.read(position, min(_BLOCK_BYTES, self.size - position))
            self._block_start, start = position, 0
        return self._block[start : start + _HEAD_BYTES]

    def chunk(self, position: int) -> Chunk:
        """The header of the chunk at a place; its data may be cut by the file's end."""
        start = position + RECORD_HEADER.size
        opcode = self.read(position, 1)[0]
        header = self.read(start, _CHUNK_HEADER.size)
        start_ns, end_ns, size, crc, name_bytes = _CHUNK_HEADER.unpack(header)
        if opcode != Opcode.CHUNK or name_bytes > max(map(len, _COMPRESSIONS)):
            raise ValueError("its header is none")
        name_start = start + _CHUNK_HEADER.size
        compression = self.read(name_start, name_bytes).decode(errors="replace")
        data_start = name_start + name_bytes + _LENGTH["l"].size
        (data_bytes,) = _LENGTH["l"].unpack(self.read(name_start + name_bytes, _LENGTH["l"].size))
        if compression not in _COMPRESSIONS:
            raise ValueError(f"its compression {compression!r} is not known")
        if max(size, data_bytes) > MAX_CHUNK_BYTES:
            raise ValueError(
                f"it claims {max(size, data_bytes)} bytes, more than {MAX_CHUNK_BYTES}"
            )
        return Chunk(
            position=position,
            data_start=data_start,
            data_end=data_start + data_bytes,
            start_ns=start_ns,
            end_ns=end_ns,
            size=size,
            crc=crc,
            compression=compression,
        )

    def decompress_chunk(self, chunk: Chunk) -> DecompressedChunk:
        """A chunk's content. One that the file's end truncates is not reported as a problem."""
        end = min(chunk.data_end, self.size)
        packed = self.read(chunk.data_start, end - chunk.data_start)
        content, problem = _decompress(packed, chunk.compression, chunk.size)
        if not problem and end == chunk.data_end:
            if len(content) != chunk.size:
                problem = f"it does not unpack to the {chunk.size} bytes that it claims"
            elif chunk.crc and zlib.crc32(content) != chunk.crc:
                problem = "its checksum is wrong"
        return DecompressedChunk(content, problem)

    def find_record(self, start: int) -> int | None:
        """The next position of a record that another record or the file's end follows."""
        while start < self.size and self._searchable_bytes > 0:
            block = self.read(start, min(_PIECE_BYTES, self.size - start))
            self._searchable_bytes -= len(block)
            for match in _CANDIDATE.finditer(block):
                self._searchable_candidates -= 1
                if self._searchable_candidates < 0:
                    return None
                if self._is_certain(start + match.start()):
                    return start + match.start()
            start += max(len(block) - RECORD_HEADER.size + 1, 1)
        return None

    def follows(self, position: int) -> bool:
        """Whether a record or the end of the file is at a position."""
        return position == self.size or self.record(position) is not None

    def _is_certain(self, position: int) -> bool:
        record = self.record(position)
        if record is None:
            return False
        if record.opcode == Opcode.CHUNK:
            if record.end != record.fields_end:
                return False
            try:
                self.chunk(position)
            except ValueError:
                return False
            return record.end > self.size or self.follows(record.end)
        if record.opcode != Opcode.MESSAGE:
            return record.end == record.fields_end and self.follows(record.end)
        # A message's header has nothing to check it by: two more records must follow.
        second = self.record(record.end)
        return record.end == self.size or (second is not None and self.follows(second.end))


def records_in(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of the records in a chunk's content, up to one that is none."""
    position = 0
    while position <= len(content) - RECORD_HEADER.size:
        opcode, length = RECORD_HEADER.unpack_from(content, position)
        start = position + RECORD_HEADER.size
        position = start + length
        is_short = opcode == Opcode.MESSAGE and position - start < _MESSAGE_BYTES
        if opcode == 0 or is_short or position > len(content):
            return
        yield opcode, start, position


def index_entries(
    records: bytes,
    number: Callable[[int], int | None],
    *,
    block: int,
    size: int,
    start_ns: int,
    end_ns: int,
) -> Entries:
    """Entries, in the order of the chunk at ``block``, from the message index records behind it.

    ``number`` gives the place of a channel by its id. Raises ValueError where they contradict a
    chunk of ``size`` bytes with log times from ``start_ns`` to ``end_ns``.
    """
    position = 0
    numbers, counts, indexes = [], [], []
    try:
        while position < len(records):
            opcode, length, channel, index_bytes = INDEX_HEADER.unpack_from(records, position)
            start = position + INDEX_HEADER.size
            position += RECORD_HEADER.size + length
            found = number(channel)
            if opcode != Opcode.MESSAGE_INDEX or start + index_bytes > position or found is None:
                raise ValueError("its message index is damaged")
            count = index_bytes // INDEX_ENTRY.itemsize
            numbers.append(found)
            counts.append(count)
            indexes.append(np.frombuffer(records, INDEX_ENTRY, count, start))
    except struct.error as error:
        raise ValueError("its message index breaks off") from error
    index = np.concatenate([np.empty(0, INDEX_ENTRY), *indexes])
    order = np.argsort(index["offset"])
    index = index[order]
    times, offsets = index["log_time"], index["offset"]
    if len(index) and not (
        start_ns <= times.min() <= times.max() <= min(end_ns, MAX_TIME_NS)
        and offsets[-1] < size
        and (offsets[1:] > offsets[:-1]).all()
    ):
        raise ValueError("its message index contradicts it")
    entries = np.empty(len(index), ENTRY)
    entries["received_ns"] = times
    entries["channel"] = np.repeat(np.array(numbers, np.int32), counts)[order]
    entries["block"] = block
    entries["offset"] = offsets
    return entries


def _decompress(packed: bytes, compression: str, size: int) -> tuple[bytes, str]:
    """At most ``size + 1`` bytes before ``packed`` breaks off or is damaged, and the damage."""
    if compression == "zstd":
        return _decompress_zstd(packed, size)
    if compression == "lz4":
        return _decompress_lz4(packed, size)
    return packed, ""


def _decompress_zstd(packed: bytes, size: int) -> tuple[bytes, str]:
    decompressor = zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW_BYTES)
    try:
        return decompressor.stream_reader(packed).read(size + 1), ""
    except zstandard.ZstdError as error:
        problem = f"it does not unpack, {error}"
    content = BytesIO()
    reader = decompressor.stream_reader(packed)
    try:
        while content.tell() < size and (piece := reader.read(_STEP_BYTES)):
            content.write(piece)
    except zstandard.ZstdError:
        # Reported by the first attempt.
        pass
    return content.getvalue(), problem


def _decompress_lz4(packed: bytes, size: int, step: int = _PIECE_BYTES) -> tuple[bytes, str]:
    stream, content = BytesIO(packed), BytesIO()
    pieces = decompress_pieces(
        lz4.frame.LZ4FrameDecompressor(), lambda: stream.read(step), min(step, size + 1)
    )
    try:
        while content.tell() <= size and (piece := next(pieces, None)) is not None:
            content.write(piece)
    except RuntimeError as error:
        if step > _STEP_BYTES:
            return _decompress_lz4(packed, size, _STEP_BYTES)
        return content.getvalue(), f"it does not unpack, {error}"
    content.truncate(size + 1)
    return content.getvalue(), ""
