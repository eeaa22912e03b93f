"""Reader of ROS 1 bags, version 2.0, with uncompressed, bz2 or lz4 chunks."""

import struct
from io import BytesIO
from pathlib import Path

import numpy as np

from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording
from fusion_core.recordings.containers import (
    ENTRY,
    Channel,
    ChecksumReport,
    ChunkCache,
    Entries,
    Payload,
    damaged_file_error,
    find_index_problem,
)
from fusion_core.recordings.indexed import IndexedRecording
from fusion_core.recordings.rosbag1.chunks import LZ4_HEADER_BYTES, decompress_chunk, has_checksum
from fusion_core.recordings.rosbag1.index import read_contents
from fusion_core.recordings.rosbag1.records import (
    LENGTH,
    MAGIC,
    NOT_IN_A_CHUNK,
    OP_CHUNK,
    OP_CONNECTION,
    OP_MESSAGE,
    op_field,
    read_record,
)

__all__ = ["MAGIC", "BagFile", "open_rosbag1"]

_IS_MESSAGE, _IS_CONNECTION = op_field(OP_MESSAGE), op_field(OP_CONNECTION)


def open_rosbag1(path: Path) -> Recording:
    """A ROS 1 bag. Raises RecordingError."""
    return IndexedRecording(path, "ROS 1 bag", [BagFile(path)])


class BagFile:
    """A ROS 1 bag. ``block`` of an entry is the position of its chunk in the file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: list[Channel] = []
        self.warnings: list[str] = []
        self._file = path.open("rb")
        self._size = self._file.seek(0, 2)
        self._chunks = ChunkCache(self._decompress_chunk)
        self._chunk_ends: dict[int, int] = {}
        self._channel_of: dict[int, int] = {}
        self._problems: dict[int, str] = {}

    def index(self) -> Entries:
        contents = read_contents(self._file, self._size)
        if contents.encryptor:
            raise RecordingError(
                f"is encrypted with {contents.encryptor!r}.",
                file=self.path,
                advice="Decrypt a copy with the tools of ROS.",
            )
        if contents.warnings and not len(contents.entries):
            problems = " ".join(dict.fromkeys([contents.warnings[0], contents.warnings[-1]]))
            raise damaged_file_error(self.path, f"no message can be read. {problems}".rstrip("."))
        self.channels = contents.channels
        self._channel_of = contents.channel_of
        self.warnings += contents.warnings
        self._chunk_ends = contents.chunk_ends
        for block, content in contents.unpacked.items():
            self._chunks.keep(block, content)
        return contents.entries

    def payload(self, block: int, offset: int) -> Payload:
        if offset == NOT_IN_A_CHUNK:
            return self._message_outside_chunks(block)
        chunk = self._chunks[block]
        try:
            while True:
                (size,) = LENGTH.unpack_from(chunk, offset)
                header, offset = offset, offset + LENGTH.size + size
                (size,) = LENGTH.unpack_from(chunk, offset)
                start, offset = offset + LENGTH.size, offset + LENGTH.size + size
                if chunk.find(_IS_MESSAGE, header, start) >= 0:
                    break
                # In some bags the index points at the connection record before the message.
                if chunk.find(_IS_CONNECTION, header, start) < 0:
                    raise self._broken_chunk_error(block)
        except struct.error as error:
            raise self._broken_chunk_error(block) from error
        if offset > len(chunk):
            raise self._broken_chunk_error(block)
        return memoryview(chunk)[start:offset]

    def published_ns(self, block: int, offset: int) -> None:
        return None

    def verify(self, entries: Entries) -> ChecksumReport:
        is_in_a_chunk = entries["offset"] != NOT_IN_A_CHUNK
        verified = ChecksumReport(unguarded=int(not is_in_a_chunk.all()))
        blocks = np.unique(entries["block"][is_in_a_chunk])
        entries = np.sort(entries, order=["block", "offset"])
        for block in blocks.tolist():
            content = self._decompress_chunk(block)
            if block in self._problems:
                continue
            if self._has_checksum(block):
                verified.checksums += 1
            else:
                verified.unguarded += 1
            first, end = np.searchsorted(entries["block"], [block, block + 1])
            problem = self._index_problem(content, entries[first:end])
            if problem:
                verified.damage.append(
                    f"{self.path.name}: Damaged: the chunk at byte {block}: {problem}."
                )
        return verified

    def close(self) -> None:
        self._file.close()

    def _has_checksum(self, block: int) -> bool:
        chunk = read_record(self._file, block, self._size)
        if chunk is None:
            return False
        self._file.seek(chunk.data_start)
        return has_checksum(chunk, self._file.read(LZ4_HEADER_BYTES))

    def _index_problem(self, content: bytes, indexed: Entries) -> str:
        """How the index contradicts a chunk's content; empty if it does not.

        ``indexed``: the entries of this chunk, sorted by offset.
        """
        stream, end = BytesIO(content), len(content)
        rows = []
        position = 0
        # The index may point at a message or at the connection records before it.
        starts: dict[int, int] = {}
        before: list[int] = []
        while position < end:
            record = read_record(stream, position, end)
            if record is None:
                return f"no record is at byte {position} of its content"
            before.append(position)
            if record.op == OP_MESSAGE:
                starts |= dict.fromkeys(before, position)
                before.clear()
                channel = self._channel_of.get(record.number(b"conn"), -1)
                rows.append((record.time_ns(b"time"), channel, indexed["block"][0], position))
            position = record.end
        offsets = [starts.get(offset, offset) for offset in indexed["offset"].tolist()]
        indexed["offset"] = offsets
        held = np.array(rows, dtype=ENTRY)
        return find_index_problem(held[held["channel"] >= 0], indexed)

    def _message_outside_chunks(self, start: int) -> bytes:
        record = read_record(self._file, start, self._size)
        if record is None or record.op != OP_MESSAGE:
            raise damaged_file_error(self.path, f"no message is at byte {start} any more")
        self._file.seek(record.data_start)
        return self._file.read(record.data_size)

    def _decompress_chunk(self, block: int) -> bytes:
        chunk = read_record(self._file, block, self._size)
        if chunk is None or chunk.op != OP_CHUNK:
            raise damaged_file_error(self.path, f"no chunk is at byte {block} any more")
        end = self._chunk_ends.get(block, min(chunk.end, self._size))
        unpacked = decompress_chunk(self._file, chunk, end)
        if unpacked.problem:
            self._problems[block] = unpacked.problem
        return unpacked.content

    def _broken_chunk_error(self, block: int) -> RecordingError:
        problem = self._problems.get(block, "no whole message stands where its index points")
        return damaged_file_error(self.path, f"the chunk at byte {block}: {problem}")
