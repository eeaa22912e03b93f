"""MCAP files: the index from the summary, or from a walk over the records where that fails."""

import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.containers import (
    ENTRY,
    MAX_CHUNK_BYTES,
    Channel,
    ChecksumReport,
    ChunkCache,
    Entries,
    Payload,
    damaged_file_error,
    find_index_problem,
)
from fusion_core.recordings.mcap.channels import DEFINING, McapChannels
from fusion_core.recordings.mcap.records import (
    MAX_TIME_NS,
    MESSAGE_HEADER,
    RECORD_HEADER,
    RecordFile,
    index_entries,
    records_in,
)
from fusion_core.recordings.mcap.walk import NOT_IN_A_CHUNK, RecordWalk

MAGIC = b"\x89MCAP0\r\n"

# Opcode, length, where the summary and its offsets start, CRC of the summary.
_FOOTER = struct.Struct("<BQQQI")
# Opcode, length, CRC of all before it.
_DATA_END = struct.Struct("<BQI")
# First and last log time, place and size of the chunk; the lengths of what follows.
_CHUNK_INDEX = struct.Struct("<QQQQI")
_MESSAGE_INDEX_BYTES = struct.Struct("<QI")
_UNPACKED_BYTES = struct.Struct("<QQ")
_PIECE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class _ChunkPlace:
    """A chunk as the summary describes it."""

    start_ns: int
    end_ns: int
    position: int
    end: int
    index_bytes: int
    size: int


@dataclass(slots=True)
class _Summary:
    """Contents of the summary; ``problem`` says why it is not reliable, empty if it is.

    ``start`` is where it begins, or the file's footer where there is no summary.
    """

    chunks: list[_ChunkPlace] = field(default_factory=list)
    message_count: int | None = None
    start: int = 0
    has_checksum: bool = False
    problem: str = ""


class McapFile:
    """An MCAP file with ROS 2 (CDR) or ROS 1 messages."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings: list[str] = []
        self._channels = McapChannels()
        # Unbuffered: a walk seeks at every record, which would refill a buffer each time.
        self._file = path.open("rb", buffering=0)
        self._records = RecordFile(self._file)
        self._chunks = ChunkCache(self._decompress_chunk)
        self._summary = _Summary()

    @property
    def channels(self) -> list[Channel]:
        return self._channels.channels

    def index(self) -> Entries:
        """Every message that can be found; ``warnings`` then name the lost parts of a damaged file.

        Raises RecordingError where the file is damaged and no message can be found.
        """
        self._summary = summary = self._read_summary()
        if not summary.problem:
            entries = self._index_from_summary(summary)
            if entries is not None and not summary.has_checksum and self._is_contradicted(entries):
                summary.problem = "its summary contradicts its chunks"
            elif entries is not None:
                self._channels.add_fallbacks()
                return entries
        return self._salvage(summary)

    def payload(self, block: int, offset: int) -> Payload:
        header = self._header(block, offset)
        start = offset + MESSAGE_HEADER.size
        end = offset + RECORD_HEADER.size + RECORD_HEADER.unpack_from(header)[1]
        if block == NOT_IN_A_CHUNK and start <= end <= min(
            self._records.size, start + MAX_CHUNK_BYTES
        ):
            return self._records.read(start, end - start)
        if block != NOT_IN_A_CHUNK and start <= end <= len(self._chunks[block]):
            return memoryview(self._chunks[block])[start:end]
        raise damaged_file_error(
            self.path, f"the message at byte {offset}{_of_chunk(block)} breaks off"
        )

    def published_ns(self, block: int, offset: int) -> int:
        return int(MESSAGE_HEADER.unpack(self._header(block, offset))[-1])

    def verify(self, entries: Entries) -> ChecksumReport:
        verified = ChecksumReport()
        entries = np.sort(entries, order=["block", "offset"])
        for block in np.unique(entries["block"]).tolist():
            first, end = np.searchsorted(entries["block"], [block, block + 1])
            if block == NOT_IN_A_CHUNK:
                verified.unguarded += 1
            else:
                self._verify_chunk(block, entries[first:end], verified)
        if self._summary.has_checksum and not self._summary.problem:
            verified.checksums += 1
        self._verify_data(verified)
        return verified

    def close(self) -> None:
        self._file.close()

    def _verify_chunk(self, block: int, indexed: Entries, verified: ChecksumReport) -> None:
        try:
            content = self._decompress_chunk(block)
        except RecordingError:
            return
        if self._records.chunk(block).crc:
            verified.checksums += 1
        else:
            verified.unguarded += 1
        rows = []
        behind = 0
        for opcode, start, end in records_in(content):
            behind = end
            if opcode == Opcode.MESSAGE:
                position = start - RECORD_HEADER.size
                _, _, channel, _, log_time, _ = MESSAGE_HEADER.unpack_from(content, position)
                number = self._channels.channel_number(channel)
                if number is not None and log_time <= MAX_TIME_NS:
                    rows.append((log_time, number, block, position))
        problem = find_index_problem(np.array(rows, dtype=ENTRY), indexed)
        if behind < len(content):
            problem = f"no record is at byte {behind} of its content"
        if problem:
            verified.damage.append(
                f"{self.path.name}: Damaged: the chunk at byte {block}: {problem}."
            )

    def _verify_data(self, verified: ChecksumReport) -> None:
        """Verify the checksum of the data section, if the writer stored one."""
        end = self._summary.start - _DATA_END.size
        if self._summary.problem or end < len(MAGIC):
            return
        opcode, length, crc = _DATA_END.unpack(self._records.read(end, _DATA_END.size))
        if (opcode, length) != (Opcode.DATA_END, 4) or not crc:
            return
        if self._crc(0, end) == crc:
            verified.checksums += 1
            verified.unguarded = 0
        else:
            verified.damage.append(
                f"{self.path.name}: Damaged: the checksum of its first {end} bytes is wrong."
            )

    def _header(self, block: int, offset: int) -> bytes:
        if block != NOT_IN_A_CHUNK:
            header = self._chunks[block][offset : offset + MESSAGE_HEADER.size]
        else:
            size = max(min(MESSAGE_HEADER.size, self._records.size - offset), 0)
            header = self._records.read(offset, size)
        if len(header) < MESSAGE_HEADER.size or header[0] != Opcode.MESSAGE:
            raise damaged_file_error(self.path, f"no message at byte {offset}{_of_chunk(block)}")
        return header

    def _decompress_chunk(self, block: int) -> bytes:
        try:
            unpacked = self._records.decompress_chunk(self._records.chunk(block))
        except ValueError as error:
            raise damaged_file_error(self.path, f"the chunk at byte {block}, {error}") from error
        if unpacked.problem:
            raise damaged_file_error(self.path, f"the chunk at byte {block}, {unpacked.problem}")
        return unpacked.content

    def _read_summary(self) -> _Summary:
        footer_start = self._records.size - len(MAGIC) - _FOOTER.size
        if footer_start < len(MAGIC):
            return _Summary(problem="its end is missing")
        end = self._records.read(footer_start, _FOOTER.size + len(MAGIC))
        opcode, length, start, _, crc = _FOOTER.unpack_from(end)
        if not end.endswith(MAGIC) or (opcode, length) != (Opcode.FOOTER, _FOOTER.size - 9):
            return _Summary(problem="its end is missing")
        if not start:
            return _Summary(start=footer_start)
        if start > footer_start:
            return _Summary(problem="its end does not tell where its summary is")
        summary = _Summary(start=start, has_checksum=crc != 0)
        try:
            if crc and crc != self._crc(start, footer_start + _FOOTER.size - 4):
                summary.problem = "the checksum of its summary is wrong"
            self._read_records(summary, start, footer_start)
        except (ValueError, struct.error) as error:
            summary.problem = f"its summary is damaged, {error}"
        return summary

    def _crc(self, start: int, end: int) -> int:
        crc = 0
        while start < end:
            piece = self._records.read(start, min(_PIECE_BYTES, end - start))
            crc = zlib.crc32(piece, crc)
            start += len(piece)
        return crc

    def _read_records(self, summary: _Summary, start: int, end: int) -> None:
        while start < end:
            record = self._records.record(start)
            if record is None or record.end > end:
                raise ValueError(f"no record at byte {start}")
            content_start = start + RECORD_HEADER.size
            size = record.end - content_start
            if record.opcode in (*DEFINING, Opcode.STATISTICS, Opcode.CHUNK_INDEX):
                content = self._records.read(content_start, min(size, _PIECE_BYTES))
                if record.opcode == Opcode.STATISTICS:
                    summary.message_count = int.from_bytes(content[:8], "little")
                elif record.opcode == Opcode.CHUNK_INDEX:
                    summary.chunks.append(_chunk_place(content))
                else:
                    self._channels.define_fallback(record.opcode, content)
            start = record.end

    def _index_from_summary(self, summary: _Summary) -> Entries | None:
        """None where the summary does not account for every message."""
        parts = [np.empty(0, dtype=ENTRY)]
        end = 0
        try:
            for chunk in sorted(summary.chunks, key=lambda chunk: chunk.position):
                if chunk.position < end or max(chunk.index_bytes, chunk.size) > MAX_CHUNK_BYTES:
                    return None
                end = chunk.end + chunk.index_bytes
                parts.append(
                    index_entries(
                        self._records.read(chunk.end, chunk.index_bytes),
                        self._channels.channel_number,
                        block=chunk.position,
                        size=chunk.size,
                        start_ns=chunk.start_ns,
                        end_ns=chunk.end_ns,
                    )
                )
        except ValueError:
            return None
        if sum(map(len, parts)) != summary.message_count:
            return None
        return np.concatenate(parts)

    def _is_contradicted(self, entries: Entries) -> bool:
        """Whether the chunk of a channel's first message defines it unlike the summary."""
        _, rows = np.unique(entries["channel"], return_index=True)
        first = entries[rows]
        for block in np.unique(first["block"]).tolist():
            # A channel is defined before its first message.
            last = int(first["offset"][first["block"] == block].max())
            try:
                content = self._chunks[block][:last]
            except RecordingError:
                # Reading its messages reports that.
                continue
            for opcode, start, end in records_in(content):
                is_definition = opcode in DEFINING
                if is_definition and self._channels.contradicts(opcode, content[start:end]):
                    return True
        return False

    def _salvage(self, summary: _Summary) -> Entries:
        if summary.problem:
            # A name in a damaged summary may be damaged too: those of the chunks come first.
            self._channels = McapChannels()
        walk = RecordWalk(self._records, self._channels)
        begins = self._records.size >= len(MAGIC) and self._records.read(0, len(MAGIC)) == MAGIC
        entries = walk.entries(len(MAGIC) if begins else 0)
        if not summary.problem:
            self._channels.add_fallbacks()
        problem = summary.problem or ("" if begins else "its beginning is missing")
        losses = walk.losses.warnings(entries, self._records.size)
        if (problem or losses) and not len(entries):
            raise damaged_file_error(
                self.path, f"no message of it can be read ({problem or losses[0]})"
            )
        if problem:
            nothing = "" if losses else ", and none is lost"
            losses.insert(
                0, f"Damaged or cut short ({problem}): messages were looked for{nothing}."
            )
        if summary.message_count not in (None, len(entries)):
            losses.append(
                f"Its statistics count {summary.message_count} messages, {len(entries)} were found."
            )
        # A recording may be of several files.
        self.warnings += [f"{self.path.name}: {line}" for line in losses]
        return entries


def _of_chunk(block: int) -> str:
    return "" if block == NOT_IN_A_CHUNK else f" of the chunk at byte {block}"


def _chunk_place(content: bytes) -> _ChunkPlace:
    start_ns, end_ns, position, length, map_bytes = _CHUNK_INDEX.unpack_from(content)
    place = _CHUNK_INDEX.size + map_bytes
    index_bytes, name_bytes = _MESSAGE_INDEX_BYTES.unpack_from(content, place)
    place += _MESSAGE_INDEX_BYTES.size + name_bytes
    _, size = _UNPACKED_BYTES.unpack_from(content, place)
    return _ChunkPlace(start_ns, end_ns, position, position + length, index_bytes, size)
