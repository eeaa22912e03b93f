"""A recording over message containers: one index in memory, messages decoded on demand."""

import threading
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fusion_core.model.conventions import NS_PER_S, IntArray, read_only
from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Message, Role, Topic
from fusion_core.model.stamps import NO_STAMP
from fusion_core.recordings.containers import (
    ENTRY,
    Channel,
    ChecksumReport,
    Container,
    Entries,
    Payload,
)
from fusion_core.recordings.decode import (
    READABLE_TYPES,
    decode_message,
    header_stamp_ns,
    image_encoding,
    stamp_of_value_ns,
)
from fusion_core.recordings.messages.types import (
    READABLE_ENCODINGS,
    Deserializer,
    UnreadableType,
    find_deserializer,
)
from fusion_core.recordings.skipped import SkippedMessages
from fusion_core.recordings.topics import role_from_encoding, role_from_type, unknown_topic_error

_BATCH = 1024
# The encoding of an image topic is read from its first message, or the next if that is damaged.
_PEEKED_MESSAGES = 5
_UNKNOWN_TYPE = "messages of its type are not read"

_Read = TypeVar("_Read")
# An entry of the index as plain numbers: log time, channel, block and offset.
_Entry = tuple[int, int, int, int]


@dataclass(slots=True)
class _IndexedTopic:
    """A topic: the positions of its messages in the index, and how to read them."""

    name: str
    message_type: str
    positions: IntArray
    deserializers: dict[int, Deserializer] = field(default_factory=dict)
    role: Role = "other"
    unreadable_reason: str = ""
    stamps_ns: IntArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SerializedMessage:
    """A message as its file holds it. ``channel`` is its place in the recording's ``channels``.

    ``published_ns`` is None where the file does not say when it was published.
    """

    channel: int
    received_ns: int
    published_ns: int | None
    payload: Payload


class IndexedRecording:
    """Recording over one or more containers, in the order of log time, then of the files.

    A topic that cannot be read is listed in ``topics`` with role "other", and has a line in
    ``unreadable_topic_warnings``. A message that cannot be read is skipped by iteration with a
    warning; ``read`` raises RecordingError. ``serialized_messages`` reads any topic.
    """

    stamps_are_nominal = False

    def __init__(
        self,
        path: Path,
        format: str,
        containers: list[Container],
        warnings: Collection[str] = (),
    ) -> None:
        self.path = path
        self.format = format
        self.warnings = list(warnings)
        self._containers = containers
        self._lock = threading.Lock()
        self._closed = False
        self._skipped = SkippedMessages(self.warnings)
        try:
            channels, self._files, self._entries = _merge_indexes(containers)
            self.warnings.extend(line for file in containers for line in file.warnings)
            received = self._entries["received_ns"]
            self.start_ns = int(received[0]) if len(received) else None
            self.end_ns = int(received[-1]) if len(received) else None
            self.channels = tuple(channels)
            self._streams = self._read_streams(channels)
            self.unreadable_topic_warnings = self._list_unreadable_topics(self._streams)
            self.warnings.extend(self.unreadable_topic_warnings)
        except BaseException:
            self.close()
            raise
        self.topics = tuple(self._topic(stream) for stream in self._streams.values())

    def received_ns(self, topic: str) -> IntArray:
        """(count,) log times of a topic's messages, in the order of iteration."""
        positions = self._stream(topic).positions
        return self._entries["received_ns"][positions].astype(np.int64)

    def stamps_ns(self, topic: str) -> IntArray:
        """(count,) the sensor's stamps of a topic's messages, in the order of iteration, NO_STAMP
        for what cannot be read or has none. The first call reads the topic's messages."""
        stream = self._require_readable(topic)
        if stream.stamps_ns is None:
            stamps_ns = np.full(len(stream.positions), NO_STAMP, dtype=np.int64)
            for index, position in enumerate(stream.positions):
                # Iteration warns of damaged messages.
                with suppress(RecordingError):
                    stamps_ns[index] = header_stamp_ns(
                        self._deserialize(stream, self._entries[position].item())
                    )
            self._require_open()
            read_only(stamps_ns)
            stream.stamps_ns = stamps_ns
        return stream.stamps_ns

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Message]:
        """Messages with start <= received < end, in order; damaged ones are skipped with a
        warning."""
        self._require_open()
        if topics is None:
            streams = [s for s in self._streams.values() if not s.unreadable_reason]
        else:
            streams = [self._require_readable(name) for name in dict.fromkeys(topics)]
        return self._iterate(streams, start_ns, end_ns, self._decode)

    def serialized_messages(
        self,
        topics: Collection[str],
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[SerializedMessage]:
        """Messages of any type with start <= received < end, in order, without decoding."""
        streams = [self._stream(name) for name in dict.fromkeys(topics)]
        return self._iterate(streams, start_ns, end_ns, self._serialized)

    def read(self, topic: str, index: int) -> Message:
        """The ``index``-th message of a topic. Raises IndexError beyond its count."""
        stream = self._require_readable(topic)
        if not 0 <= index < len(stream.positions):
            raise IndexError(f"{topic} has {len(stream.positions)} messages, there is no {index}")
        return self._decode(stream, index, self._entries[stream.positions[index]].item())

    def verify(self) -> ChecksumReport:
        """Read the files whole, and compare them with their checksums and their indexes."""
        verified = ChecksumReport()
        first = 0
        for container in self._containers:
            channel = self._entries["channel"]
            own = self._entries[(channel >= first) & (channel < first + len(container.channels))]
            own["channel"] -= first
            first += len(container.channels)
            with self._lock:
                self._require_open()
                verified.add(container.verify(own))
        return verified

    def close(self) -> None:
        """Free the files."""
        with self._lock:
            self._closed = True
            for container in self._containers:
                container.close()

    def __enter__(self) -> "IndexedRecording":
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _first_position_at(self, time_ns: int) -> int:
        return int(np.searchsorted(self._entries["received_ns"], time_ns, side="left"))

    def _iterate(
        self,
        streams: list[_IndexedTopic],
        start_ns: int | None,
        end_ns: int | None,
        read: Callable[[_IndexedTopic, int, _Entry], _Read],
    ) -> Iterator[_Read]:
        first = 0 if start_ns is None else self._first_position_at(start_ns)
        last = len(self._entries) if end_ns is None else self._first_position_at(end_ns)
        chosen = [s.positions[(s.positions >= first) & (s.positions < last)] for s in streams]
        positions = np.sort(np.concatenate([np.empty(0, dtype=np.int64), *chosen]))
        next_index = {s.name: int(np.searchsorted(s.positions, first)) for s in streams}
        stream_of = [self._streams[channel.topic] for channel in self.channels]
        for start in range(0, len(positions), _BATCH):
            batch = self._entries[positions[start : start + _BATCH]]
            for entry in batch.tolist():
                stream = stream_of[entry[1]]
                index = next_index[stream.name]
                next_index[stream.name] = index + 1
                try:
                    message = read(stream, index, entry)
                except RecordingError as error:
                    self._require_open()
                    self._skipped.add(stream.name, index, len(stream.positions), error)
                else:
                    yield message

    def _payload(self, stream: _IndexedTopic, entry: _Entry) -> Payload:
        _, channel, block, offset = entry
        with self._lock:
            self._require_open()
            try:
                return self._files[channel].payload(block, offset)
            except OSError as error:
                raise RecordingError(
                    f"{stream.name}: reading failed, {error.strerror or error}.",
                    file=self.path,
                    advice="Check the disk or the network that holds the file.",
                ) from error

    def _serialized(
        self,
        stream: _IndexedTopic,
        index: int,
        entry: _Entry,
    ) -> SerializedMessage:
        payload = self._payload(stream, entry)
        received_ns, channel, block, offset = entry
        with self._lock:
            self._require_open()
            published_ns = self._files[channel].published_ns(block, offset)
        return SerializedMessage(
            channel=channel, received_ns=received_ns, published_ns=published_ns, payload=payload
        )

    def _deserialize(self, stream: _IndexedTopic, entry: _Entry) -> Any:
        payload = self._payload(stream, entry)
        try:
            return stream.deserializers[entry[1]](payload)
        except ValueError as error:
            raise RecordingError(
                f"{stream.name}: a message cannot be read, {error}.",
                file=self.path,
                advice="Check the driver that recorded it.",
            ) from error

    def _decode(
        self,
        stream: _IndexedTopic,
        index: int,
        entry: _Entry,
    ) -> Message:
        received_ns = entry[0]
        raw = self._deserialize(stream, entry)
        value = decode_message(raw, stream.message_type, topic=stream.name, received_ns=received_ns)
        stamp = stamp_of_value_ns(value)
        return Message(
            topic=stream.name,
            index=index,
            received_ns=received_ns,
            stamp_ns=received_ns if stamp is None else stamp,
            value=value,
        )

    def _stream(self, topic: str) -> _IndexedTopic:
        self._require_open()
        if topic not in self._streams:
            raise unknown_topic_error(topic, self.topics, self.path)
        return self._streams[topic]

    def _require_readable(self, topic: str) -> _IndexedTopic:
        stream = self._stream(topic)
        if stream.unreadable_reason:
            raise RecordingError(
                f"{topic} cannot be read: {stream.unreadable_reason}.",
                file=self.path,
                advice="Name another topic.",
            )
        return stream

    def _require_open(self) -> None:
        if self._closed:
            raise RecordingError("is closed.", file=self.path, advice="Open it again.")

    def _read_streams(self, channels: list[Channel]) -> dict[str, _IndexedTopic]:
        numbers = defaultdict(list)
        for number, channel in enumerate(channels):
            numbers[channel.topic].append(number)
        order = np.argsort(self._entries["channel"], kind="stable")
        bounds = np.searchsorted(self._entries["channel"][order], np.arange(len(channels) + 1))
        streams = {}
        for name, own in sorted(numbers.items()):
            positions = [order[bounds[n] : bounds[n + 1]] for n in own]
            streams[name] = stream = _IndexedTopic(
                name=name,
                message_type=" and ".join(sorted({channels[n].message_type for n in own})),
                positions=np.sort(np.concatenate(positions)).astype(np.int64),
            )
            self._find_deserializers(stream, {n: channels[n] for n in own})
        return streams

    def _find_deserializers(self, stream: _IndexedTopic, channels: dict[int, Channel]) -> None:
        """Find the stream's role and deserialisers, or why there are none."""
        if len({channel.message_type for channel in channels.values()}) > 1:
            stream.unreadable_reason = "its messages are of several types"
        elif stream.message_type not in READABLE_TYPES and READABLE_ENCODINGS.issuperset(
            channel.serialization for channel in channels.values()
        ):
            known = stream.message_type != ""
            stream.unreadable_reason = _UNKNOWN_TYPE if known else "the file does not tell its type"
        else:
            try:
                stream.deserializers = {
                    n: find_deserializer(channel) for n, channel in channels.items()
                }
            except UnreadableType as error:
                stream.unreadable_reason = str(error)
        if stream.unreadable_reason:
            return
        role = role_from_type(stream.message_type, stream.name)
        stream.role = role or self._role_of_images(stream)
        if stream.role == "other" and len(stream.positions):
            stream.unreadable_reason = "its images are of an encoding that is not read"

    def _role_of_images(self, stream: _IndexedTopic) -> Role:
        for position in stream.positions[:_PEEKED_MESSAGES]:
            try:
                raw = self._deserialize(stream, self._entries[position].item())
                role = role_from_encoding(image_encoding(raw), stream.name)
            except (RecordingError, AttributeError, TypeError):
                # Damaged, or the file's own definition has other fields: reading it reports that.
                continue
            if role != "other":
                return role
        return "other"

    def _list_unreadable_topics(self, streams: dict[str, _IndexedTopic]) -> tuple[str, ...]:
        lines = []
        unknown_types = set()
        for stream in streams.values():
            if stream.unreadable_reason == _UNKNOWN_TYPE:
                unknown_types.add(stream.message_type)
            elif stream.unreadable_reason:
                lines.append(f"{stream.name} is left out: {stream.unreadable_reason}.")
        if unknown_types:
            listed = ", ".join(sorted(unknown_types))
            lines.append(f"Topics of these types are left out: {listed}.")
        return tuple(lines)

    def _topic(self, stream: _IndexedTopic) -> Topic:
        count = len(stream.positions)
        rate_hz = None
        if count >= 2:
            first, last = self._entries["received_ns"][stream.positions[[0, -1]]].tolist()
            rate_hz = (count - 1) * NS_PER_S / (last - first) if last > first else None
        return Topic(
            name=stream.name,
            type=stream.message_type,
            role=stream.role,
            count=count,
            rate_hz=rate_hz,
        )


def _merge_indexes(containers: list[Container]) -> tuple[list[Channel], list[Container], Entries]:
    """Channels of all containers, the container of each, and their entries in order of time."""
    channels: list[Channel] = []
    files: list[Container] = []
    parts = [np.empty(0, dtype=ENTRY)]
    for container in containers:
        entries = container.index()
        entries["channel"] += len(channels)
        channels.extend(container.channels)
        files.extend([container] * len(container.channels))
        parts.append(entries)
    entries = np.concatenate(parts)
    return channels, files, entries[np.argsort(entries["received_ns"], kind="stable")]
