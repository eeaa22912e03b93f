"""Recovery: read an MCAP file record by record if its summary is missing or damaged."""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from mcap.opcode import Opcode

from fusion_core.recordings.containers import ENTRY, MAX_CHUNK_BYTES, Entries
from fusion_core.recordings.mcap.channels import DEFINING, McapChannels
from fusion_core.recordings.mcap.losses import Losses, Lost
from fusion_core.recordings.mcap.records import (
    INDEX_ENTRY,
    INDEX_HEADER,
    MAX_TIME_NS,
    MESSAGE_HEADER,
    RECORD_HEADER,
    Chunk,
    Record,
    RecordFile,
    index_entries,
    records_in,
)

NOT_IN_A_CHUNK = -1

_ROWS_AT_A_TIME = 65536
_CHANNEL_IDS = 1 << 16
_NO_RECORD = "no record can be read there"


class RecordWalk:
    """Reads the data section of a file; ``losses`` then lists what could not be read.

    A chunk is decompressed only if the message index after it is missing, damaged, or refers to
    channels that no earlier record defines.
    """

    def __init__(self, file: RecordFile, channels: McapChannels) -> None:
        self.losses = Losses()
        self._file = file
        self._channels = channels
        self._in_data = True
        # Their channels are ids of the file until ``_with_numbers`` replaces them.
        self._parts: list[Entries] = [np.empty(0, dtype=ENTRY)]
        # Log time, channel, block and offset of messages.
        self._rows: list[tuple[int, int, int, int]] = []
        self._seen: dict[tuple[int, ...], int] = {}
        # Bound for hostile files: log times and sequence numbers need at least a byte per message.
        self._records_left = file.size

    def entries(self, start: int) -> Entries:
        """All messages from byte ``start`` on, in file order."""
        position = start
        while (record := self._next(position)) and record.opcode != Opcode.FOOTER:
            # Read on into the summary: the definitions repeated there may be the only ones left.
            self._in_data = self._in_data and record.opcode != Opcode.DATA_END
            if record.opcode == Opcode.CHUNK:
                self._flush()
                position = self._take_chunk(record)
            else:
                position = self._take_record(record)
        self._flush()
        self.losses.breaks_off = record is None and self._in_data
        entries = np.concatenate(self._parts)
        self._parts.clear()
        return self._with_numbers(entries)

    def _next(self, position: int) -> Record | None:
        """The record at ``position`` or, if there is none, the next one that can be found."""
        if position >= self._file.size:
            return None
        record = self._file.record(position)
        if record is None:
            position = self._lose(position, position + 1, _NO_RECORD)
            record = self._file.record(position)
        return record

    def _lose(self, start: int, search_from: int, what: str, chunk: Chunk | None = None) -> int:
        """Report the bytes from ``start`` to the next record as lost; returns its position."""
        found = self._file.find_record(search_from)
        end = self._file.size if found is None else found
        self._add_lost(start, end, what, chunk)
        return end

    def _add_lost(self, start: int, end: int, what: str, chunk: Chunk | None = None) -> None:
        start_ns, end_ns = (None, None) if chunk is None else (chunk.start_ns, chunk.end_ns)
        # After the data section there are only definitions, which are also elsewhere.
        if self._in_data:
            self.losses.add(Lost(start=start, end=end, what=what, start_ns=start_ns, end_ns=end_ns))

    def _take_record(self, record: Record) -> int:
        """Process a record outside of chunks; returns where to look for the next one."""
        after = record.end
        if not self._file.follows(record.end):
            found = self._file.find_record(record.position + 1)
            after = self._file.size if found is None else found
            if record.end > after:
                self._add_lost(record.position, after, "a record breaks off")
                return after
            self._add_lost(record.end, after, _NO_RECORD)
        if record.opcode == Opcode.MESSAGE:
            _, _, channel, _, log_time, _ = MESSAGE_HEADER.unpack(record.head)
            self._add_row(log_time, channel, record.position, NOT_IN_A_CHUNK)
        elif record.opcode in DEFINING:
            start = record.position + RECORD_HEADER.size
            size = min(record.fields_end - start, MAX_CHUNK_BYTES)
            self._define(record.opcode, self._file.read(start, size), record.position)
        elif record.opcode == Opcode.MESSAGE_INDEX:
            after = max(after, self._behind_index(record.position))
            count = self._indexed_count(record.position, after)
            self._add_lost(
                record.position, after, f"the index of {count} messages without their chunk"
            )
        return after

    def _take_chunk(self, record: Record) -> int:
        """Process a chunk and its message index; returns where to look for the next record."""
        try:
            chunk = self._file.chunk(record.position)
        except ValueError as error:
            what = f"a chunk is left out, {error}"
            if self._file.follows(record.end):
                self._add_lost(record.position, record.end, what)
                return record.end
            return self._lose(record.position, record.position + 1, what)
        if record.end == chunk.data_end > self._file.size:
            return self._take_cut_chunk(chunk)
        # Either of the two lengths may be damaged.
        ends = (end for end in (chunk.data_end, record.end) if self._file.follows(end))
        end = next(ends, None)
        after = None if end is None else self._behind_index(end)
        if after is not None and self._is_repeated(chunk, after):
            return after
        if end is not None and after is not None and self._take_index(chunk, end, after):
            return after
        unpacked = self._file.decompress_chunk(chunk)
        if unpacked.problem:
            self._keep_definitions(unpacked.content)
            if end is None or after is None:
                what = f"a chunk is left out, {unpacked.problem}"
                return self._lose(chunk.position, chunk.position + 1, what, chunk)
            count = self._indexed_count(end, after)
            what = f"a chunk{f' of {count} messages' if count else ''} is left out"
            self._add_lost(chunk.position, after, f"{what}, {unpacked.problem}", chunk)
            return after
        read = self._take_content(chunk, unpacked.content)
        if read < len(unpacked.content):
            unread = len(unpacked.content) - read
            what = f"{unread} of the {len(unpacked.content)} bytes in a chunk are no records"
            self._add_lost(chunk.position, chunk.data_end, what, chunk)
        return (
            after if after is not None else self._lose(chunk.data_end, chunk.data_end, _NO_RECORD)
        )

    def _take_cut_chunk(self, chunk: Chunk) -> int:
        before = len(self._parts)
        unpacked = self._file.decompress_chunk(chunk)
        problem = f", {unpacked.problem}" if unpacked.problem else ""
        if problem:
            self._keep_definitions(unpacked.content)
        else:
            self._take_content(chunk, unpacked.content)
        saved = self._parts[before:]
        count = sum(map(len, saved))
        last_ns = max((int(part["received_ns"].max()) for part in saved if len(part)), default=None)
        self.losses.add(
            Lost(
                start=self._file.size,
                end=chunk.data_end,
                what=f"a chunk breaks off, of which {count} messages are saved{problem}",
                start_ns=chunk.start_ns if last_ns is None else last_ns,
                end_ns=chunk.end_ns,
            )
        )
        return self._file.size

    def _behind_index(self, position: int) -> int:
        """The end of the message index records that start at ``position``."""
        while (
            (record := self._file.record(position)) is not None
            and record.opcode == Opcode.MESSAGE_INDEX
            and record.end == record.fields_end <= self._file.size
        ):
            position = record.end
        return position

    def _indexed_count(self, position: int, end: int) -> int:
        """Number of messages in the message index records from ``position`` to ``end``."""
        count = 0
        while position < end and (record := self._file.record(position)) is not None:
            count += (record.end - record.position - INDEX_HEADER.size) // INDEX_ENTRY.itemsize
            position = record.end
        return count

    def _take_index(self, chunk: Chunk, start: int, end: int) -> bool:
        """Add the messages of a chunk from its index; False if the index may be incomplete."""
        behind = self._file.record(end)
        if behind is None or behind.opcode == Opcode.MESSAGE_INDEX:
            return False
        if not 0 < end - start <= MAX_CHUNK_BYTES:
            return False
        try:
            entries = index_entries(
                self._file.read(start, end - start),
                self._known_channel,
                block=chunk.position,
                size=chunk.size,
                start_ns=chunk.start_ns,
                end_ns=chunk.end_ns,
            )
        except ValueError:
            return False
        self._parts.append(entries)
        return True

    def _is_repeated(self, chunk: Chunk, after: int) -> bool:
        """Whether an identical chunk came before, judged by checksum, size and times."""
        key = (chunk.crc, chunk.size, chunk.start_ns, chunk.end_ns)
        first = self._seen.setdefault(key, chunk.position)
        if first == chunk.position or not chunk.crc:
            return False
        self._add_lost(
            chunk.position, after, f"the chunk at byte {first} stands there again", chunk
        )
        return True

    def _known_channel(self, channel: int) -> int | None:
        return None if self._channels.channel_number(channel) is None else channel

    def _take_content(self, chunk: Chunk, content: bytes) -> int:
        """Add the records in a chunk; returns the number of bytes in complete records."""
        position = 0
        for opcode, start, end in self._records_in(content):
            if opcode == Opcode.MESSAGE:
                _, _, channel, _, log_time, _ = MESSAGE_HEADER.unpack_from(content, position)
                self._add_row(log_time, channel, position, chunk.position)
            elif opcode in DEFINING:
                self._define(opcode, content[start:end], chunk.position)
            position = end
        self._flush()
        return position

    def _records_in(self, content: bytes) -> Iterator[tuple[int, int, int]]:
        for found in records_in(content):
            if self._records_left <= 0:
                return
            self._records_left -= 1
            yield found

    def _keep_definitions(self, content: bytes) -> None:
        """Keep schemas and channels of a damaged chunk: messages in other chunks may need them."""
        for opcode, start, end in self._records_in(content):
            if opcode in DEFINING:
                with suppress(ValueError):
                    self._channels.define_fallback(opcode, content[start:end])

    def _define(self, opcode: int, content: bytes, position: int) -> None:
        try:
            if self._in_data:
                self._channels.define(opcode, content)
            else:
                self._channels.define_fallback(opcode, content)
        except ValueError as error:
            self.losses.add_bad_definition(f"at byte {position}: {error}")

    def _add_row(self, log_time: int, channel: int, offset: int, block: int) -> None:
        if log_time > MAX_TIME_NS:
            self.losses.add_untimed()
            return
        self._rows.append((log_time, channel, block, offset))
        if len(self._rows) == _ROWS_AT_A_TIME:
            self._flush()

    def _flush(self) -> None:
        if self._rows:
            self._parts.append(np.array(self._rows, dtype=ENTRY))
            self._rows = []

    def _with_numbers(self, entries: Entries) -> Entries:
        """Replace channel ids by channel numbers; messages of undefined channels are dropped."""
        ids = entries["channel"]
        places = np.full(_CHANNEL_IDS, -1, dtype=np.int32)
        for channel in np.flatnonzero(np.bincount(ids, minlength=_CHANNEL_IDS)).tolist():
            number = self._channels.channel_number(channel)
            if number is None:
                self.losses.add_undefined_channel(channel, entries["received_ns"][ids == channel])
            else:
                places[channel] = number
        entries["channel"] = places[ids]
        has_channel = entries["channel"] >= 0
        return entries if has_channel.all() else entries[has_channel]
