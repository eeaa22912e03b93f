"""The connections of a ROS 1 bag: topic and type by connection number.

Their records have no checksum, but each is in the bag twice: in the index at the end, and in the
chunk with its first message (by some writers in the first chunk). If the two differ, the one that
is consistent in itself is preferred, then the one in the chunk.
"""

import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import BinaryIO

from fusion_core.recordings.containers import Channel, ros2_type_name
from fusion_core.recordings.messages.types import UnreadableType, ros1_checksum
from fusion_core.recordings.rosbag1.records import MAX_NAME_BYTES, BagRecord, read_fields

_MAX_CHANNELS = 4096
_MAX_DEFINITIONS_BYTES = 8 << 20
_MAX_LISTED = 5
_TOPIC_NAME = re.compile(r"[~/]?[A-Za-z][A-Za-z0-9_/]*")
_TYPE_NAME = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class _ConnectionRecord:
    """The description of a connection in one of its records.

    ``repeated_topic`` is the topic in the record's data, empty if there is none. ``chunk`` is the
    position of the chunk with the record; None for a record outside of chunks, at ``start`` to
    ``end`` of the file.
    """

    channel: Channel
    repeated_topic: str
    md5sum: str
    chunk: int | None
    start: int
    end: int

    def count_plausible_names(self) -> int:
        """Number of plausible names: valid in ROS, or repeated consistently."""
        return sum(
            (
                _TOPIC_NAME.fullmatch(self.channel.topic) is not None,
                _TYPE_NAME.fullmatch(self.channel.message_type) is not None,
                self.repeated_topic in ("", self.channel.topic),
            )
        )

    def has_matching_md5sum(self) -> bool:
        """Whether its MD5 sum matches its definition."""
        try:
            return ros1_checksum(self.channel) == self.md5sum
        except UnreadableType:
            return False


class Connections:
    """All records of the connections of a bag, by connection number."""

    def __init__(self) -> None:
        self._descriptions: dict[int, list[_ConnectionRecord]] = {}
        self._channels: set[Channel] = set()
        self._definition_bytes = 0

    def __contains__(self, number: int) -> bool:
        return number in self._descriptions

    def __iter__(self) -> Iterator[int]:
        return iter(self._descriptions)

    def __len__(self) -> int:
        return len(self._descriptions)

    def add(self, stream: BinaryIO, record: BagRecord, chunk: int | None) -> None:
        """Add a record in ``stream``: the content of ``chunk``, or the file if that is None."""
        description = _read(stream, record, chunk)
        if description is None:
            return
        known = self._descriptions.get(record.number(b"conn"), [])
        same = (i for i, other in enumerate(known) if other.channel == description.channel)
        if (place := next(same, None)) is not None:
            if known[place].chunk is None:
                known[place] = description
            return
        if description.channel not in self._channels:
            self._definition_bytes += len(description.channel.definition)
            is_excessive = self._definition_bytes > _MAX_DEFINITIONS_BYTES
            if is_excessive or len(self._channels) >= _MAX_CHANNELS:
                return
            self._channels.add(description.channel)
        self._descriptions.setdefault(record.number(b"conn"), []).append(description)

    def places(self, number: int) -> list[tuple[int, int]]:
        """Start and end of the records of a connection outside of chunks."""
        known = self._descriptions.get(number, [])
        return [(one.start, one.end) for one in known if one.chunk is None]

    def remove(self, numbers: Collection[int]) -> None:
        for number in numbers:
            self._descriptions.pop(number, None)

    def resolve(self) -> tuple[list[Channel], dict[int, int], list[str]]:
        """The channels, the channel index of each connection, and warnings of contradictions."""
        channels: dict[Channel, int] = {}
        numbers = {}
        warnings = []
        for number, known in self._descriptions.items():
            best = known[0]
            if len(known) > 1:
                best = max(known, key=_credibility(known))
                warnings.append(_describe_contradiction(number, best, known))
            numbers[number] = channels.setdefault(best.channel, len(channels))
        rest = len(warnings) - _MAX_LISTED
        if rest > 0:
            warnings[_MAX_LISTED:] = [
                f"{rest} more connections are described in contradictory ways."
            ]
        return list(channels), numbers, warnings


def _credibility(known: list[_ConnectionRecord]) -> Callable[[_ConnectionRecord], tuple[int, bool]]:
    # Definitions are slow to parse, and comparing helps only if they differ.
    differ = len({one.channel.definition for one in known}) > 1
    return lambda one: (
        one.count_plausible_names() + (differ and one.has_matching_md5sum()),
        one.chunk is not None,
    )


def _read(stream: BinaryIO, record: BagRecord, chunk: int | None) -> _ConnectionRecord | None:
    """Parse a connection record; None if its content is damaged."""
    stream.seek(record.data_start)
    fields = read_fields(stream.read(record.data_size), needs_op=False)
    if fields is None or not {b"type", b"message_definition"} <= fields.keys():
        return None
    if len(fields[b"type"]) > MAX_NAME_BYTES:
        return None
    channel = Channel(
        topic=_topic(record.fields[b"topic"]),
        message_type=ros2_type_name(fields[b"type"].decode(errors="replace")),
        serialization="ros1",
        definition=fields[b"message_definition"].decode(errors="replace"),
    )
    return _ConnectionRecord(
        channel=channel,
        repeated_topic=_topic(fields.get(b"topic", b"")),
        md5sum=fields.get(b"md5sum", b"").decode(errors="replace"),
        chunk=chunk,
        start=record.start,
        end=record.end,
    )


def _topic(name: bytes) -> str:
    """A topic's name with single slashes: old recorders wrote doubled ones."""
    topic = name.decode(errors="replace")
    return "/" * topic.startswith("/") + "/".join(part for part in topic.split("/") if part)


def _describe_contradiction(
    number: int, best: _ConnectionRecord, known: list[_ConnectionRecord]
) -> str:
    names = {(one.channel.topic, one.channel.message_type) for one in known}
    described = " and ".join(
        f"{one.channel.topic} ({one.channel.message_type}) in {_describe_place(one)}"
        for one in known
    )
    if len(names) == 1:
        described = (
            f"{best.channel.topic}, of which {' and '.join(map(_describe_place, known))} differ"
        )
    return f"Damaged: connection {number} is {described}; that in {_describe_place(best)} is taken."


def _describe_place(one: _ConnectionRecord) -> str:
    if one.chunk is None:
        return f"the record at byte {one.start}"
    return f"the chunk at byte {one.chunk}"
