"""Scan of all records of a ROS 1 bag, complete or damaged.

The index data after each chunk locate its messages, so that an intact chunk is skipped. A chunk is
decompressed only if its index data are missing or contradict the index at the end of the bag.
"""

from array import array
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

import numpy as np

from fusion_core.model.conventions import IntArray
from fusion_core.recordings.containers import MAX_CHUNK_BYTES
from fusion_core.recordings.rosbag1.chunks import (
    DecompressedChunk,
    decompress_chunk,
    find_chunk_problem,
)
from fusion_core.recordings.rosbag1.connections import Connections
from fusion_core.recordings.rosbag1.records import (
    MAGIC,
    NOT_IN_A_CHUNK,
    OP_BAG,
    OP_CHUNK,
    OP_CHUNK_INFO,
    OP_CONNECTION,
    OP_INDEX,
    OP_MESSAGE,
    BagRecord,
    SearchBudget,
    connection_records,
    find_record,
    read_record,
)

# Record types that follow a chunk; messages and connections also occur inside chunks.
_BEHIND_CHUNKS = frozenset((OP_INDEX, OP_CHUNK, OP_CHUNK_INFO))
# Bounds on decompressed bytes, set by hand: ample for real bags, finite for hostile ones.
_UNPACKED_BYTES, _UNPACKED_PER_BYTE = 256 << 20, 64


@dataclass(frozen=True, slots=True)
class Lost:
    """A byte range of the file that could not be read, or only in part."""

    start: int
    end: int
    why: str


class BagWalk:
    """Contents of a bag, gathered by ``walk_file``, then by ``walk_chunk`` for unindexed chunks.

    ``messages`` has rows of log time, connection, block and offset; ``chunks`` of position and
    content size; ``index`` of chunk, connection and number of entries in ``index_data``;
    ``infos`` of chunk, connection and count; ``spans`` of chunk, first and last log time.
    ``unindexed`` are chunks whose index data are missing or unreliable, ``whole`` those that
    ``walk_chunk`` read completely.
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.header: BagRecord | None = None
        self.connections = Connections()
        self.lost: list[Lost] = []
        self.chunk_count = 0
        self.unindexed: set[int] = set()
        self.whole: set[int] = set()
        self.chunk_ends: dict[int, int] = {}
        self.index_data = bytearray()
        self._messages = array("q")
        self._chunks = array("q")
        self._index = array("q")
        self._infos = array("q")
        self._spans = array("q")
        self._file = file
        self._size = size
        self._search = SearchBudget()
        self._connection_search = SearchBudget()
        self._unpackable_bytes = _UNPACKED_BYTES + _UNPACKED_PER_BYTE * size
        # The chunk to which the following index data belong.
        self._chunk: int | None = None

    @property
    def messages(self) -> IntArray:
        return _rows(self._messages, 4)

    @property
    def chunks(self) -> IntArray:
        return _rows(self._chunks, 2)

    @property
    def index(self) -> IntArray:
        return _rows(self._index, 3)

    @property
    def infos(self) -> IntArray:
        return _rows(self._infos, 3)

    @property
    def spans(self) -> IntArray:
        return _rows(self._spans, 3)

    def walk_file(self) -> None:
        position = len(MAGIC)
        while position < self._size:
            record = self.record_at(position)
            if record is None:
                found = self._find(position + 1)
                self.lost.append(Lost(position, found, "no whole record is there"))
                self._close_chunk(is_damaged=True)
                position = found
            elif record.op == OP_CHUNK:
                self._close_chunk()
                self.chunk_count += 1
                position = self._skip_chunk(record)
            else:
                if record.op != OP_INDEX:
                    self._close_chunk()
                self._take_record(record)
                position = record.end
                if record.op == OP_BAG and not self._has_record_at(position):
                    # The stated length of its padding may be too large.
                    position = min(self._find(record.data_start), record.end)
        # A complete bag does not end with the index data of a chunk: some of it may be lost.
        self._close_chunk(is_damaged=True)

    def walk_chunk(self, start: int, *, take_messages: bool = True) -> None:
        """Read the connections of a chunk, and its messages, from its content."""
        found_chunk = self._chunk_at(start)
        if found_chunk is None:
            return
        unpacked = self._decompress_chunk(*found_chunk)
        stream, end = BytesIO(unpacked.content), len(unpacked.content)
        position = lost_bytes = 0
        while position < end:
            record = read_record(stream, position, end)
            if record is None or record.op == OP_CHUNK:
                found = find_record(stream, position + 1, end, self._search)
                lost_bytes += found - position
                position = found
                continue
            if record.op == OP_CONNECTION:
                self.connections.add(stream, record, start)
            elif record.op == OP_MESSAGE and take_messages:
                self._add_message(record, start, record.start)
            position = record.end
        if take_messages and (unpacked.problem or lost_bytes):
            inner = f"{lost_bytes} of the {end} bytes in its chunk are no records"
            self.lost.append(Lost(start, found_chunk[1], unpacked.problem or inner))
        elif take_messages:
            self.whole.add(start)

    def content(self, start: int) -> DecompressedChunk:
        """The content of the chunk at ``start``, as far as it can be read."""
        chunk = self._chunk_at(start)
        return (
            DecompressedChunk(b"", "no chunk is there")
            if chunk is None
            else self._decompress_chunk(*chunk)
        )

    def connection_records(self, content: bytes) -> dict[int, bytes]:
        """Candidate connection records in a chunk's content, by connection number."""
        found = connection_records(content, self._connection_search)
        return {one.number(b"conn"): content[one.start : one.end] for one in found}

    def bytes_of(self, start: int, end: int) -> bytes:
        """The bytes of the file from ``start`` to ``end``."""
        self._file.seek(start)
        return self._file.read(end - start)

    def record_at(self, start: int) -> BagRecord | None:
        return read_record(self._file, start, self._size)

    def _chunk_at(self, start: int) -> tuple[BagRecord, int] | None:
        """The chunk at ``start`` and the end of its data in the file; None if there is no chunk."""
        chunk = self.record_at(start)
        if chunk is None or chunk.op != OP_CHUNK:
            return None
        return chunk, self.chunk_ends.get(start, min(chunk.end, self._size))

    def _skip_chunk(self, chunk: BagRecord) -> int:
        """Register a chunk; returns where the next record is."""
        is_whole = self._has_record_at(chunk.end)
        is_plain = chunk.fields[b"compression"] == b"none"
        content_bytes = chunk.number(b"size")
        fits = content_bytes == chunk.data_size <= MAX_CHUNK_BYTES
        if is_plain and not (is_whole and fits):
            # Its records are then read as if they were outside of a chunk.
            return chunk.data_start
        end = chunk.end
        problem = find_chunk_problem(chunk)
        if not is_whole and (problem or not self._has_right_length(chunk)):
            # It ends where the next record begins.
            end = find_record(
                self._file, chunk.data_start, self._size, self._search, _BEHIND_CHUNKS
            )
            self.chunk_ends[chunk.start] = end
            if not problem:
                self.unindexed.add(chunk.start)
        if problem:
            self.lost.append(Lost(chunk.start, end, problem))
        else:
            self._chunk = chunk.start
            self._chunks.extend((chunk.start, content_bytes))
        return end

    def _has_record_at(self, position: int) -> bool:
        """Whether a record or the end of the file is at ``position``."""
        return position == self._size or self.record_at(position) is not None

    def _find(self, start: int) -> int:
        return find_record(self._file, start, self._size, self._search)

    def _has_right_length(self, chunk: BagRecord) -> bool:
        if chunk.end > self._size:
            return False
        unpacked = self._decompress_chunk(chunk, chunk.end)
        return not unpacked.problem and unpacked.surplus_bytes == 0

    def _close_chunk(self, is_damaged: bool = False) -> None:
        if is_damaged and self._chunk is not None:
            # Part of its index data is lost.
            self.unindexed.add(self._chunk)
        self._chunk = None

    def _take_record(self, record: BagRecord) -> None:
        """Process a record outside of chunks."""
        if record.op == OP_MESSAGE:
            self._add_message(record, record.start, NOT_IN_A_CHUNK)
        elif record.op == OP_CONNECTION:
            self.connections.add(self._file, record, None)
        elif record.op == OP_INDEX and self._chunk is not None:
            self._index.extend((self._chunk, record.number(b"conn"), record.number(b"count")))
            self.index_data += self._data(record)
        elif record.op == OP_CHUNK_INFO:
            chunk = min(record.number(b"chunk_pos"), self._size)
            counts = np.frombuffer(self._data(record), dtype="<u4").reshape(-1, 2)
            for connection, count in counts.tolist():
                self._infos.extend((chunk, connection, count))
            if {b"start_time", b"end_time"} <= record.fields.keys():
                times = record.time_ns(b"start_time"), record.time_ns(b"end_time")
                self._spans.extend((chunk, *times))
        elif record.op == OP_BAG and self.header is None:
            self.header = record

    def _data(self, record: BagRecord) -> bytes:
        return self.bytes_of(record.data_start, record.end)

    def _add_message(self, record: BagRecord, block: int, offset: int) -> None:
        self._messages.extend((record.time_ns(b"time"), record.number(b"conn"), block, offset))

    def _decompress_chunk(self, chunk: BagRecord, end: int) -> DecompressedChunk:
        if self._unpackable_bytes <= 0:
            return DecompressedChunk(b"", "its chunks unpack to far more than those of a recording")
        unpacked = decompress_chunk(self._file, chunk, end)
        self._unpackable_bytes -= len(unpacked.content) or chunk.number(b"size")
        return unpacked


def _rows(numbers: "array[int]", width: int) -> IntArray:
    return np.array(numbers, dtype=np.int64).reshape(-1, width)
