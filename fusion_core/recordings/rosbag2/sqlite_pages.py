"""Rows of a damaged ROS 2 database, read from its leaf pages without its B-trees.

Layout: sqlite.org/fileformat2.html. SQLite refuses a file that is shorter than its header says,
and cannot reach the rows below a lost interior page; interior pages often come after their leaves.
But all rows are in table leaf pages, which begin with the byte 13. No other page does: an overflow
page begins with the number of the next one, whose first byte is 13 only in files beyond 100 GB.

The table of a row is recognised by its columns: a message is (id, topic_id, timestamp, data) with
two integers and a blob; a row of ``topics`` or ``message_definitions`` is an id and at least three
texts.
"""

import errno
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fusion_core.model.conventions import BoolArray, ByteArray, IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.containers import MAX_CHUNK_BYTES, damaged_file_error

HEADER_BYTES = 100
# One message and the position of its cell in the file.
ROW = np.dtype([("id", "<i8"), ("topic_id", "<i8"), ("timestamp", "<i8"), ("cell", "<i8")])
Rows = npt.NDArray[np.void]

# The bytes of a row on overflow pages, and the first of these pages.
_SPILL = np.dtype([("cell", "<i8"), ("bytes", "<i8"), ("page", "<i8")])
_LEAF = 13
_BLOCK_BYTES = 4 << 20
_DEFAULT_PAGE_BYTES = 4096
# At most seven variable-length integers of nine bytes.
_LONGEST_HEAD = 64
# Of topics and definitions together: rows of a hostile file may share the same pages.
_MAX_TEXT_BYTES = 32 << 20
_MAX_TEXTS = 20_000
_TEXT_COLUMNS = 6
# Bytes of the integers of serial types 0 to 9; 7 is a float, 8 and 9 are the constants 0 and 1.
_INTEGER_BYTES = np.array([0, 1, 2, 3, 4, 6, 8, 0, 0, 0])
_INTEGER_TYPES = np.array([0, 1, 1, 1, 1, 1, 1, 0, 1, 1], dtype=bool)


@dataclass(frozen=True, slots=True)
class FileHeader:
    """Sizes from the file header. ``claimed_bytes`` is 0 if the page count is not reliable."""

    page_bytes: int
    usable_bytes: int
    claimed_bytes: int


def read_header(head: bytes) -> FileHeader:
    """The header of a database from its first 100 bytes."""
    page_bytes = int.from_bytes(head[16:18], "big")
    page_bytes = 65536 if page_bytes == 1 else page_bytes
    if page_bytes < 512 or page_bytes & (page_bytes - 1):
        # The default of SQLite.
        page_bytes = _DEFAULT_PAGE_BYTES
    reserved = head[20] if len(head) > 20 else 0
    # The page count is valid only if the change counter equals the version-valid-for number.
    counted = len(head) == HEADER_BYTES and head[24:28] == head[92:96]
    return FileHeader(
        page_bytes=page_bytes,
        usable_bytes=page_bytes - (reserved if page_bytes - reserved >= 480 else 0),
        claimed_bytes=int.from_bytes(head[28:32], "big") * page_bytes if counted else 0,
    )


class DatabasePages:
    """The rows that can still be read.

    ``rows`` are the messages with complete data, by ascending id; ``cut_rows`` those with
    incomplete data. ``texts`` are (id, columns) of all other rows that begin with three texts.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: Rows
        self.cut_rows: Rows
        self.texts: list[tuple[int, tuple[str, ...]]] = []
        self._text_bytes = 0
        # Unbuffered: seeking for holes on the descriptor would desynchronise a buffer.
        self._file = path.open("rb", buffering=0)
        try:
            self.size = self._file.seek(0, 2)
            self.header = read_header(self._read(0, HEADER_BYTES))
            pages = -(-self.size // self.header.page_bytes)
            # The first four bytes of each page, counted from 1 as the file does.
            self._next = np.zeros(pages + 1, dtype=np.uint32)
            self._spills = [np.empty(0, dtype=_SPILL)]
            rows = np.concatenate([np.empty(0, dtype=ROW), *self._scan()])
            if np.any(np.diff(rows["id"]) <= 0):
                # Stale copies of a page repeat its rows.
                _, first = np.unique(rows["id"], return_index=True)
                rows = rows[first]
            cut = np.isin(rows["cell"], self._cut_cells())
            self.rows, self.cut_rows = (rows[~cut], rows[cut]) if cut.any() else (rows, rows[:0])
            del self._next, self._spills
        except BaseException:
            self._file.close()
            raise

    def data(self, cell: int) -> bytes:
        """The data of the message at a cell. Raises RecordingError."""
        head = np.frombuffer(self._read(cell, _LONGEST_HEAD).ljust(_LONGEST_HEAD, b"\0"), np.uint8)
        record_bytes, at = _varints(head, np.zeros(1, dtype=np.int64))
        _, record = _varints(head, at)
        header_bytes, at = _varints(head, record)
        skipped = header_bytes
        for _ in range(3):
            kind, at = _varints(head, at)
            skipped = skipped + _INTEGER_BYTES[np.clip(kind, 0, 9)]
        return self._record(cell + int(record[0]), int(record_bytes[0]))[int(skipped[0]) :]

    def close(self) -> None:
        self._file.close()

    def _read(self, position: int, size: int) -> bytes:
        self._file.seek(position)
        return self._file.read(size)

    def _scan(self) -> Iterator[Rows]:
        """Yield the messages of each block; also fills ``texts`` and ``_next``."""
        page_bytes = self.header.page_bytes
        block_bytes = max(_BLOCK_BYTES, page_bytes)
        # Padding, so that varints can be decoded at the end of the last page.
        data = np.zeros(block_bytes + _LONGEST_HEAD, dtype=np.uint8)
        for start in range(0, self.size, block_bytes):
            if self._is_hole(start, block_bytes):
                continue
            self._file.seek(start)
            size = self._file.readinto(data[:block_bytes].data)
            data[size:] = 0
            pages = -(-size // page_bytes)
            first = start // page_bytes + 1
            heads = data[: pages * page_bytes].reshape(pages, page_bytes)[:, :4]
            self._next[first : first + pages] = np.ascontiguousarray(heads).view(">u4")[:, 0]
            yield self._messages(data, self._cells(data, pages), start)

    def _is_hole(self, start: int, size: int) -> bool:
        """Whether the range is a hole of a sparse file, as in an unfinished download."""
        if not hasattr(os, "SEEK_DATA"):
            return False
        try:
            return os.lseek(self._file.fileno(), start, os.SEEK_DATA) >= start + size
        except OSError as error:
            return error.errno == errno.ENXIO

    def _cells(self, data: ByteArray, pages: int) -> IntArray:
        """Positions of the cells in the leaf pages of a block."""
        page_bytes, usable = self.header.page_bytes, self.header.usable_bytes
        starts = np.arange(pages) * page_bytes
        starts = starts[data[starts] == _LEAF]
        counts = np.minimum(_be16(data, starts + 3), (usable - 8) // 6)
        first = np.cumsum(counts) - counts
        places = np.arange(int(counts.sum())) - np.repeat(first, counts)
        starts, counts = np.repeat(starts, counts), np.repeat(counts, counts)
        pointers = _be16(data, starts + 8 + 2 * places)
        fits = (pointers >= 8 + 2 * counts) & (pointers <= usable - 4)
        return (starts + pointers)[fits]

    def _messages(self, data: ByteArray, cells: IntArray, start: int) -> Rows:
        record_bytes, at = _varints(data, cells)
        ids, record = _varints(data, at)
        header_bytes, at = _varints(data, record)
        types = []
        for _ in range(4):
            kind, at = _varints(data, at)
            types.append(kind)
        local = self._local_bytes(record_bytes)
        page_end = cells - cells % self.header.page_bytes + self.header.usable_bytes
        end = record + local + 4 * (local < record_bytes)
        fits = (record_bytes > 0) & (end <= page_end) & (start + end <= self.size) & (ids >= 0)
        fits &= (header_bytes > 0) & (header_bytes <= local) & (types[0] == 0)
        self._collect_texts(types, fits, start + record, record_bytes, ids)

        fits &= _is_integer(types[1]) & _is_integer(types[2])
        fits &= (types[3] >= 12) & (types[3] % 2 == 0) & (at == record + header_bytes)
        cells, local, at, ids = cells[fits], local[fits], at[fits], ids[fits]
        record, record_bytes = record[fits], record_bytes[fits]
        topic_type, stamp_type, data_type = (kind[fits] for kind in types[1:])
        stamp_at = at + _INTEGER_BYTES[topic_type]
        data_at = stamp_at + _INTEGER_BYTES[stamp_type]
        rows = np.empty(len(ids), dtype=ROW)
        rows["id"] = ids
        rows["topic_id"] = _integers(data, at, topic_type)
        rows["timestamp"] = _integers(data, stamp_at, stamp_type)
        rows["cell"] = start + cells
        lengths = (data_type - 12) // 2
        right = (data_at - record + lengths == record_bytes) & (lengths <= MAX_CHUNK_BYTES)
        spilled = right & (local < record_bytes)
        spills = np.empty(np.count_nonzero(spilled), dtype=_SPILL)
        spills["cell"] = start + cells[spilled]
        spills["bytes"] = (record_bytes - local)[spilled]
        pointer = (record + local)[spilled]
        spills["page"] = _be16(data, pointer) << 16 | _be16(data, pointer + 2)
        self._spills.append(spills)
        kept: Rows = rows[right]
        return kept

    def _collect_texts(
        self,
        types: list[IntArray],
        fits: BoolArray,
        records: IntArray,
        record_bytes: IntArray,
        ids: IntArray,
    ) -> None:
        for kind in types[1:]:
            fits = fits & (kind >= 13) & (kind % 2 == 1)
        for place in np.flatnonzero(fits).tolist():
            self._text_bytes += int(record_bytes[place])
            if self._text_bytes > _MAX_TEXT_BYTES or len(self.texts) >= _MAX_TEXTS:
                return
            # A truncated row is lost; its messages are then reported.
            with suppress(RecordingError):
                record = self._record(int(records[place]), int(record_bytes[place]))
                texts = _texts(record)
                if len(texts) >= 3:
                    self.texts.append((int(ids[place]), texts))

    def _local_bytes(self, record_bytes: IntArray) -> IntArray:
        """Number of bytes of a record in its leaf page; the rest is on overflow pages."""
        usable = self.header.usable_bytes
        least = (usable - 12) * 32 // 255 - 23
        spilled = least + (record_bytes - least) % (usable - 4)
        spilled = np.where(spilled <= usable - 35, spilled, least)
        return np.where(record_bytes <= usable - 35, record_bytes, spilled)

    def _cut_cells(self) -> IntArray:
        """Cells of the rows with an overflow page that is not in the file."""
        usable, page_bytes = self.header.usable_bytes, self.header.page_bytes
        spills = np.concatenate(self._spills)
        first, steps = spills["page"], (spills["bytes"] - 1) // (usable - 4)
        last = first + steps
        # Most rows lie on consecutive pages, which is checked for all rows at once.
        numbers = np.arange(1, len(self._next) + 1, dtype=np.uint32)
        breaks = np.zeros(len(self._next) + 1, dtype=np.int32)
        np.cumsum(self._next != numbers, dtype=np.int32, out=breaks[1:])
        top = len(self._next) - 1
        inside = (first > 0) & (last <= top)
        straight = breaks[np.clip(first, 0, top)] == breaks[np.clip(last, 0, top)]
        taken = np.zeros(len(self._next), dtype=bool)
        for place in np.flatnonzero(~(inside & straight)).tolist():
            last[place] = self._walk(int(first[place]), int(steps[place]), taken)
        last_byte = (last - 1) * page_bytes + 4 + spills["bytes"] - steps * (usable - 4)
        cells: IntArray = spills["cell"][(last <= 0) | (last_byte > self.size)]
        return cells

    def _walk(self, page: int, steps: int, taken: BoolArray) -> int:
        """The page ``steps`` links after ``page``; 0 if the chain ends or meets another row's."""
        for _ in range(steps):
            if not 0 < page < len(taken) or taken[page]:
                return 0
            taken[page] = True
            page = int(self._next[page])
        return page if 0 < page < len(taken) else 0

    def _record(self, position: int, size: int) -> bytes:
        """A record with its overflow pages. Raises RecordingError if some are missing."""
        usable, page_bytes = self.header.usable_bytes, self.header.page_bytes
        local = int(self._local_bytes(np.array([size]))[0])
        content = self._read(position, local + 4)
        parts, rest = [content[:local]], size - local
        page = int.from_bytes(content[local:], "big") if rest else 0
        while rest > 0 and page > 0:
            content = self._read((page - 1) * page_bytes, 4 + min(rest, usable - 4))
            if len(content) <= 4:
                break
            parts.append(content[4:])
            rest -= len(content) - 4
            page = int.from_bytes(content[:4], "big")
        record = b"".join(parts)
        if len(record) < size:
            raise damaged_file_error(self.path, f"a row at byte {position} breaks off")
        return record


def _texts(record: bytes) -> tuple[str, ...]:
    """The leading text columns of a record, after its id."""
    data = np.frombuffer(record + bytes(64), dtype=np.uint8)
    header, at = _varints(data, np.zeros(1, dtype=np.int64))
    end = end_of_header = int(header[0])
    texts: list[str] = []
    while at[0] < end_of_header and len(texts) < _TEXT_COLUMNS:
        kind, at = _varints(data, at)
        length = (int(kind[0]) - 13) // 2
        if kind[0] == 0 and not texts:
            continue
        if kind[0] < 13 or kind[0] % 2 == 0 or end + length > len(record):
            break
        texts.append(record[end : end + length].decode(errors="replace"))
        end += length
    return tuple(texts)


def _be16(data: ByteArray, at: IntArray) -> IntArray:
    return data[at].astype(np.int64) << 8 | data[at + 1]


def _varints(data: ByteArray, at: IntArray) -> tuple[IntArray, IntArray]:
    """The variable-length integers (varints) at ``at``, and the end of each."""
    values = np.zeros(len(at), dtype=np.int64)
    ends = at.copy()
    more = np.ones(len(at), dtype=bool)
    for place in range(9):
        byte = data[np.minimum(at + place, len(data) - 1)].astype(np.int64)
        # Eight bytes carry seven bits each, the ninth carries eight.
        longer = values << 8 | byte if place == 8 else values << 7 | byte & 127
        values = np.where(more, longer, values)
        ends += more
        more &= byte >= 128
        if not more.any():
            break
    return values, ends


def _is_integer(kind: IntArray) -> BoolArray:
    last = len(_INTEGER_TYPES) - 1
    integer: BoolArray = (kind >= 0) & (kind <= last) & _INTEGER_TYPES[np.clip(kind, 0, last)]
    return integer


def _integers(data: ByteArray, at: IntArray, kind: IntArray) -> IntArray:
    """Big-endian integers of serial types for which ``_is_integer`` holds."""
    sizes = _INTEGER_BYTES[kind]
    negative = (sizes > 0) & (data[at] >= 128)
    values = np.where(negative, -1, np.where(kind == 9, 1, 0)).astype(np.int64)
    for place in range(8):
        values = np.where(place < sizes, values << 8 | data[at + place], values)
    return values
