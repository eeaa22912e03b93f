"""MCAP files: the index from the summary, or from a walk over the records where it is missing.

Layout: mcap.dev/spec. Records are one byte of opcode, eight of length, then the content.
"""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel as McapChannel
from mcap.records import Chunk, ChunkIndex, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.summary import Summary

from fusion_core.recordings.containers import (
    MAX_CHUNK_BYTES,
    Channel,
    ChunkCache,
    Entries,
    Payload,
    damaged,
    entries_from,
    in_file_order,
    ros2_type_name,
)

MAGIC = b"\x89MCAP0\r\n"

_RECORD_HEADER = struct.Struct("<BQ")
# Opcode, length, channel, sequence, log time, publish time; the payload follows.
_MESSAGE_HEADER = struct.Struct("<BQHIQQ")
_INDEX_HEADER = struct.Struct("<BQHI")
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
_FOOTER_BYTES = 37
_NOT_IN_A_CHUNK = -1
# What the mcap package raises on bytes that are not as they should be.
_DAMAGE = (
    McapError,
    ValueError,
    KeyError,
    OverflowError,
    RuntimeError,
    StopIteration,
    struct.error,
    zstandard.ZstdError,
)


class McapFile:
    """An MCAP file with ROS 2 (CDR) or ROS 1 messages."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: list[Channel] = []
        self.warnings: list[str] = []
        self._numbers: dict[int, int] = {}
        self._file = path.open("rb")
        self._chunks = ChunkCache(self._unpack)
        try:
            self._size = self._file.seek(0, 2)
            self._summary = self._read_summary()
        except BaseException:
            self._file.close()
            raise

    def index(self) -> Entries:
        entries = self._index_from_summary()
        return self._index_from_walk() if entries is None else entries

    def payload(self, block: int, offset: int) -> Payload:
        if block == _NOT_IN_A_CHUNK:
            _, length = _RECORD_HEADER.unpack(self._read(offset, _RECORD_HEADER.size))
            start = offset + _MESSAGE_HEADER.size
            return self._read(start, offset + _RECORD_HEADER.size + length - start)
        chunk = self._chunks[block]
        header = chunk[offset : offset + _MESSAGE_HEADER.size]
        if len(header) < _MESSAGE_HEADER.size or header[0] != Opcode.MESSAGE:
            raise damaged(self.path, f"no message at byte {offset} of the chunk at {block}")
        end = offset + _RECORD_HEADER.size + _RECORD_HEADER.unpack_from(header)[1]
        if end > len(chunk):
            raise damaged(self.path, f"a message ends behind its chunk at byte {block}")
        return memoryview(chunk)[offset + _MESSAGE_HEADER.size : end]

    def close(self) -> None:
        self._file.close()

    def _read(self, position: int, size: int) -> bytes:
        if not 0 <= size <= self._size - position:
            raise damaged(self.path, f"{size} bytes at byte {position} are not there")
        self._file.seek(position)
        return self._file.read(size)

    def _read_summary(self) -> Summary | None:
        if self._size < len(MAGIC) + _FOOTER_BYTES or self._read(0, 8) != MAGIC:
            raise damaged(self.path, "it ends before its first record")
        if self._read(self._size - len(MAGIC), len(MAGIC)) != MAGIC:
            raise damaged(self.path, "its end is missing")
        try:
            self._file.seek(0)
            return SeekingReader(self._file, record_size_limit=MAX_CHUNK_BYTES).get_summary()
        except _DAMAGE as error:
            raise damaged(self.path, f"its summary cannot be read ({error})") from error

    def _unpack(self, block: int) -> bytes:
        _, length = _RECORD_HEADER.unpack(self._read(block, _RECORD_HEADER.size))
        record = self._read(block + _RECORD_HEADER.size, length)
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(record)))
            if chunk.uncompressed_size > MAX_CHUNK_BYTES:
                raise ValueError(f"it claims {chunk.uncompressed_size} bytes")
            if chunk.compression == "zstd":
                # zstandard takes memory for what the frame claims, whatever the chunk says.
                claimed = zstandard.frame_content_size(chunk.data)
                if claimed not in (-1, chunk.uncompressed_size):
                    raise ValueError(f"its frame claims {claimed} bytes")
            stream, size = get_chunk_data_stream(chunk, validate_crc=True)
            return stream.read(size)
        except _DAMAGE as error:
            raise damaged(self.path, f"the chunk at byte {block} ({error})") from error

    def _register(self, channel: McapChannel, schemas: dict[int, Schema]) -> None:
        if channel.id in self._numbers:
            return
        schema = schemas.get(channel.schema_id)
        encoding = "" if schema is None else schema.encoding
        name = "" if schema is None else schema.name
        readable = schema is not None and encoding in ("ros1msg", "ros2msg", "ros2idl", "omgidl")
        self._numbers[channel.id] = len(self.channels)
        self.channels.append(
            Channel(
                topic=channel.topic,
                message_type=ros2_type_name(name) if readable else name,
                serialization=channel.message_encoding,
                definition=schema.data.decode(errors="replace") if schema and readable else "",
                definition_format="idl" if encoding.endswith("idl") else "msg",
            )
        )

    def _index_from_summary(self) -> Entries | None:
        """None where the summary does not account for every message."""
        summary = self._summary
        if summary is None or summary.statistics is None:
            return None
        for channel in summary.channels.values():
            self._register(channel, summary.schemas)
        entries = in_file_order(
            [part for chunk in summary.chunk_indexes for part in self._chunk_entries(chunk)]
        )
        complete = len(entries) == summary.statistics.message_count
        return entries if complete else None

    def _chunk_entries(self, chunk: ChunkIndex) -> Iterator[Entries]:
        """The message index records that follow a chunk."""
        records = self._read(
            chunk.chunk_start_offset + chunk.chunk_length, chunk.message_index_length
        )
        position = 0
        while position < len(records):
            try:
                _, length, channel, size = _INDEX_HEADER.unpack_from(records, position)
                index = np.frombuffer(
                    records, _INDEX_ENTRY, size // 16, position + _INDEX_HEADER.size
                )
                number = self._numbers[channel]
            except (struct.error, ValueError, KeyError) as error:
                raise damaged(
                    self.path, f"the index of the chunk at byte {chunk.chunk_start_offset}"
                ) from error
            yield entries_from(index["log_time"], number, chunk.chunk_start_offset, index["offset"])
            position += _RECORD_HEADER.size + length

    def _index_from_walk(self) -> Entries:
        schemas: dict[int, Schema] = {}
        parts: list[Entries] = []
        position, end = len(MAGIC), self._size - len(MAGIC)
        while position < end:
            opcode, length = _RECORD_HEADER.unpack(self._read(position, _RECORD_HEADER.size))
            content = position + _RECORD_HEADER.size
            if opcode == Opcode.DATA_END:
                break
            if opcode == Opcode.CHUNK:
                parts.append(self._walk_chunk(position, schemas))
            elif opcode == Opcode.MESSAGE:
                header = self._read(position, _MESSAGE_HEADER.size)
                parts.append(self._entry(header, 0, _NOT_IN_A_CHUNK, position))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, self._read(content, length), schemas)
            position = content + length
        return in_file_order(parts)

    def _walk_chunk(self, block: int, schemas: dict[int, Schema]) -> Entries:
        chunk = self._chunks[block]
        parts: list[Entries] = []
        position = 0
        while position < len(chunk):
            try:
                opcode, length = _RECORD_HEADER.unpack_from(chunk, position)
            except struct.error as error:
                raise damaged(self.path, f"the chunk at byte {block} breaks off") from error
            content = position + _RECORD_HEADER.size
            if opcode == Opcode.MESSAGE:
                parts.append(self._entry(chunk, position, block, position))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, chunk[content : content + length], schemas)
            position = content + length
        return in_file_order(parts)

    def _entry(self, buffer: bytes, position: int, block: int, offset: int) -> Entries:
        try:
            _, _, channel, _, log_time, _ = _MESSAGE_HEADER.unpack_from(buffer, position)
            return entries_from([log_time], self._numbers[channel], block, offset)
        except (struct.error, KeyError, OverflowError) as error:
            raise damaged(self.path, f"the message at byte {offset}") from error

    def _define(self, opcode: int, content: bytes, schemas: dict[int, Schema]) -> None:
        stream = ReadDataStream(BytesIO(content))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                schemas[schema.id] = schema
            else:
                self._register(McapChannel.read(stream), schemas)
        except _DAMAGE as error:
            raise damaged(self.path, f"a schema or channel ({error})") from error
