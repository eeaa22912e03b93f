"""Records of ROS 1 bags, version 2.0 (wiki.ros.org/Bags/Format/2.0).

A record is: header length, header, data length, data. A header is a sequence of fields, each a
length and ``name=value``. Numbers are little-endian. All lengths and counts are checked before
they are used, because the file may be damaged.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from typing import BinaryIO

from fusion_core.recordings.containers import MAX_CHUNK_BYTES

MAGIC = b"#ROSBAG V2.0\n"
# The offset of a message outside of chunks; its block is its own position in the file.
NOT_IN_A_CHUNK = -1

OP_MESSAGE, OP_BAG, OP_INDEX, OP_CHUNK, OP_CHUNK_INFO, OP_CONNECTION = range(2, 8)

LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")
_NS_PER_S = 1_000_000_000
# Required fields of each record type and their sizes in bytes; None for text.
_FIELDS: dict[int, dict[bytes, int | None]] = {
    OP_MESSAGE: {b"conn": 4, b"time": 8},
    OP_BAG: {b"index_pos": 8, b"conn_count": 4, b"chunk_count": 4},
    OP_INDEX: {b"ver": 4, b"conn": 4, b"count": 4},
    OP_CHUNK: {b"compression": None, b"size": 4},
    OP_CHUNK_INFO: {b"ver": 4, b"chunk_pos": 8, b"count": 4},
    OP_CONNECTION: {b"conn": 4, b"topic": None},
}
# Bytes per entry in the data of records that have a ``count``.
_COUNTED = {OP_INDEX: 12, OP_CHUNK_INFO: 8}
_COUNTED_VERSION = 1
_MAX_HEADER_BYTES = 4096
MAX_NAME_BYTES = 1024
# Real definitions have a few KB; their parser takes a second for each 100 KB.
_MAX_DEFINITION_BYTES = 1 << 17

_OP_FIELD = b"\x04\0\0\0op="
_ANY_OP_FIELD = re.compile(re.escape(_OP_FIELD) + rb"[\x02-\x07]")
_CONNECTION_FIELD = _OP_FIELD + bytes([OP_CONNECTION])
_HEADER_START = re.compile(
    rb"(?=..\0\0..\0\0(?:op|conn|time|topic|ver|count|size|compression"
    rb"|index_pos|conn_count|chunk_count|chunk_pos|start_time|end_time)=)",
    re.DOTALL,
)
_PLACES_PER_SEARCH = 10
_SEARCH_BLOCK = 1 << 16
# A header starts at most this many bytes before its opcode.
_SEARCH_OVERLAP = MAX_NAME_BYTES + 256


@dataclass(frozen=True, slots=True)
class BagRecord:
    """A record whose header has all required fields. Positions are bytes from the file's start.

    The data of a chunk may extend beyond the end of the file; that of other records does not.
    """

    op: int
    fields: dict[bytes, bytes]
    start: int
    data_start: int
    data_size: int

    @property
    def end(self) -> int:
        return self.data_start + self.data_size

    def number(self, name: bytes) -> int:
        return int.from_bytes(self.fields[name], "little")

    def time_ns(self, name: bytes) -> int:
        seconds, nanoseconds = _TIME.unpack(self.fields[name])
        return int(seconds) * _NS_PER_S + int(nanoseconds)


def op_field(op: int) -> bytes:
    """The header field with the type (opcode) of the record."""
    return _OP_FIELD + bytes([op])


def read_record(stream: BinaryIO, start: int, end: int) -> BagRecord | None:
    """The record at ``start`` of a stream that ends at ``end``; None if there is no valid one."""
    record = _record_by_its_lengths(stream, start, end)
    if record is None:
        return None
    if record.op in _COUNTED and {b"ver", b"count"} <= record.fields.keys():
        record = _by_its_count(stream, record, end)
    return record if _is_plausible(record, end) else None


def _by_its_count(stream: BinaryIO, record: BagRecord, end: int) -> BagRecord:
    """The record with its data length computed from its count, if a record follows there.

    The first recorders of bags 2.0 stated the in-memory length of index data, but wrote 12 bytes
    per entry. The readers of ROS use the count alone.
    """
    counted = replace(record, data_size=record.number(b"count") * _COUNTED[record.op])
    if counted.data_size == record.data_size or counted.end > end:
        return record
    is_followed = counted.end == end or _record_by_its_lengths(stream, counted.end, end) is not None
    return counted if is_followed else record


def _record_by_its_lengths(stream: BinaryIO, start: int, end: int) -> BagRecord | None:
    """The record at ``start`` by its stated lengths; its fields are not checked."""
    if end - start < 2 * LENGTH.size:
        return None
    stream.seek(start)
    (header_size,) = LENGTH.unpack(stream.read(LENGTH.size))
    data_start = start + header_size + 2 * LENGTH.size
    if header_size > _MAX_HEADER_BYTES or data_start > end:
        return None
    head = stream.read(header_size + LENGTH.size)
    if len(head) < header_size + LENGTH.size:
        return None
    fields = read_fields(head[:header_size])
    if fields is None:
        return None
    (data_size,) = LENGTH.unpack_from(head, header_size)
    return BagRecord(fields[b"op"][0], fields, start, data_start, data_size)


@dataclass(slots=True)
class SearchBudget:
    """Remaining search effort, bounded because a hostile file may have millions of candidates."""

    places: int = 100_000
    file_bytes: int = 2 << 30


def find_record(
    stream: BinaryIO,
    start: int,
    end: int,
    budget: SearchBudget,
    ops: frozenset[int] = frozenset(_FIELDS),
) -> int:
    """Position of the next record with an opcode in ``ops`` at or after ``start``, or ``end``.

    Another record must follow it, because compressed data may contain single records verbatim.
    Only a chunk may be the last record in the file.
    """
    budget.places -= _PLACES_PER_SEARCH
    if budget.places < 0:
        return end
    for position in range(start, end, _SEARCH_BLOCK):
        stream.seek(position)
        block = stream.read(min(_SEARCH_BLOCK + _SEARCH_OVERLAP, end - position))
        budget.file_bytes -= len(block)
        # Position of the previous opcode field.
        last = 0
        for field in _ANY_OP_FIELD.finditer(block):
            window = max(last, field.start() - _SEARCH_OVERLAP)
            for header in _HEADER_START.finditer(block, window, field.end()):
                record = read_record(stream, position + header.start(), end)
                if record is not None and record.op in ops and _is_followed(stream, record, end):
                    return record.start
                budget.places -= 1
            budget.places -= 1
            if budget.places < 0:
                return end
            last = field.start()
        if budget.file_bytes < 0:
            return end
    return end


def connection_records(content: bytes, budget: SearchBudget) -> Iterator[BagRecord]:
    """Candidate connection records in a chunk's content, without parsing all of it.

    A message may contain such bytes too: to be sure, parse the records before it.
    """
    stream, end = BytesIO(content), len(content)
    field = content.find(_CONNECTION_FIELD)
    while field >= 0 and budget.places > 0:
        budget.places -= 1
        window = max(field - _SEARCH_OVERLAP, 0), field + len(_CONNECTION_FIELD)
        for header in _HEADER_START.finditer(content, *window):
            record = read_record(stream, header.start(), end)
            if record and record.op == OP_CONNECTION and record.data_start > field:
                yield record
                break
            budget.places -= 1
        field = content.find(_CONNECTION_FIELD, field + 1)


def _is_followed(stream: BinaryIO, record: BagRecord, end: int) -> bool:
    is_last = record.op == OP_CHUNK or record.end == end
    return is_last or read_record(stream, record.end, end) is not None


def read_fields(header: bytes, needs_op: bool = True) -> dict[bytes, bytes] | None:
    """Values by name; None if the field lengths do not add up to the header's length."""
    fields = {}
    position, end = 0, len(header)
    while position + LENGTH.size <= end:
        (size,) = LENGTH.unpack_from(header, position)
        position += LENGTH.size + size
        name, separator, value = header[position - size : position].partition(b"=")
        if position > end or not separator:
            return None
        fields[name] = value
    if position != end or (needs_op and len(fields.get(b"op", b"")) != 1):
        return None
    return fields


def _is_plausible(record: BagRecord, end: int) -> bool:
    needed = _FIELDS.get(record.op)
    if needed is None:
        return False
    for name, size in needed.items():
        value = record.fields.get(name)
        if value is None or (size is not None and len(value) != size):
            return False
    if record.op == OP_CHUNK:
        return True
    if record.end > end or record.data_size > MAX_CHUNK_BYTES:
        return False
    if record.op in _COUNTED:
        counted = record.number(b"count") * _COUNTED[record.op]
        return record.number(b"ver") == _COUNTED_VERSION and record.data_size == counted
    if record.op == OP_CONNECTION:
        is_short = len(record.fields[b"topic"]) <= MAX_NAME_BYTES
        return is_short and record.data_size <= _MAX_DEFINITION_BYTES
    return True
