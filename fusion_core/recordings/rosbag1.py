"""ROS 1 bags, version 2.0: chunks plain, bz2 or lz4, read through the index at their end."""

import struct
from pathlib import Path

import numpy as np
from rosbags.rosbag1.reader import Reader, ReaderError

from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording
from fusion_core.recordings.containers import (
    Channel,
    ChunkCache,
    Entries,
    Payload,
    damaged,
    entries_from,
    in_file_order,
)
from fusion_core.recordings.indexed import IndexedRecording

MAGIC = b"#ROSBAG V2.0\n"

_LENGTH = struct.Struct("<I")
_OP_MESSAGE, _OP_CONNECTION = b"\x02", b"\x07"
# rosbags asserts some of the format's rules, and seeks to whatever position a record names.
_DAMAGE = (
    ReaderError,
    AssertionError,
    struct.error,
    ValueError,
    KeyError,
    IndexError,
    OverflowError,
    OSError,
)


def open_rosbag1(path: Path) -> Recording:
    """A ROS 1 bag. Raises RecordingError."""
    return IndexedRecording(path, "ROS 1 bag", [BagFile(path)])


class BagFile:
    """A ROS 1 bag. ``block`` of an entry is the position of its chunk in the file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings: list[str] = []
        self._file = path.open("rb")
        self._reader = Reader(path)
        try:
            self._reader.open()
        except _DAMAGE as error:
            self._file.close()
            problem = str(error) or "a record contradicts the format"
            if "not indexed" in problem:
                raise RecordingError(
                    "has no index, since its recorder did not finish.",
                    file=path,
                    advice="Run `rosbag reindex` on a copy.",
                ) from error
            raise damaged(path, problem.rstrip(".")) from error
        self.channels = [
            Channel(
                topic=connection.topic,
                message_type=connection.msgtype,
                serialization="ros1",
                definition=connection.msgdef.data,
            )
            for connection in self._reader.connections
        ]
        self._chunks = ChunkCache(self._unpack)

    def index(self) -> Entries:
        parts = []
        for number, connection in enumerate(self._reader.connections):
            # A tuple for each message; only the columns are kept.
            found = self._reader.indexes.pop(connection.id)
            columns = np.array(found, dtype=np.int64).reshape(-1, 3)
            parts.append(entries_from(columns[:, 0], number, columns[:, 1], columns[:, 2]))
        return in_file_order(parts)

    def payload(self, block: int, offset: int) -> Payload:
        chunk = self._chunks[block]
        try:
            while True:
                op, start = _record_header(chunk, offset)
                (size,) = _LENGTH.unpack_from(chunk, start)
                offset = start + _LENGTH.size + size
                # Some writers let the index point at the connection before the message.
                if op != _OP_CONNECTION:
                    break
        except struct.error as error:
            raise damaged(self.path, f"the chunk at byte {block} breaks off") from error
        if op != _OP_MESSAGE or offset > len(chunk):
            raise damaged(self.path, f"no whole message where the index of chunk {block} points")
        return memoryview(chunk)[start + _LENGTH.size : offset]

    def close(self) -> None:
        self._file.close()
        if self._reader.bio is not None:
            self._reader.close()

    def _unpack(self, block: int) -> bytes:
        chunk = self._reader.chunks[block]
        self._file.seek(chunk.datapos)
        packed = self._file.read(chunk.datasize)
        if len(packed) < chunk.datasize:
            raise damaged(self.path, f"the chunk at byte {block} breaks off")
        try:
            return chunk.decompressor(packed)
        except (OSError, ValueError, RuntimeError, EOFError) as error:
            raise damaged(self.path, f"the chunk at byte {block} ({error})") from error


def _record_header(chunk: bytes, offset: int) -> tuple[bytes, int]:
    """The opcode of a record and where its data's length stands."""
    (size,) = _LENGTH.unpack_from(chunk, offset)
    position = offset + _LENGTH.size
    end = position + size
    op = b""
    while position < end:
        (field_size,) = _LENGTH.unpack_from(chunk, position)
        position += _LENGTH.size
        if chunk.startswith(b"op=", position):
            op = chunk[position + 3 : position + field_size]
        position += field_size
    return op, end
