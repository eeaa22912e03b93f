"""A recording made of files or lines with one stamp each, read on demand."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fusion_core.model.conventions import NS_PER_S, IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Message, Role, Topic
from fusion_core.model.sensors import SensorValue
from fusion_core.recordings.skipped import SkippedMessages
from fusion_core.recordings.topics import unknown_topic_error


@dataclass(frozen=True, slots=True, kw_only=True)
class StampedStream:
    """One topic: its clocks, and how the ``index``-th value is read.

    ``stamps_ns``: (count,) the sensor's clock. ``received_ns``: (count,) log times, None where the
    format has no log. Messages are ordered and selected by log time, else by stamp; that clock
    must ascend. ``read_value`` raises RecordingError for a message that cannot be read.
    """

    name: str
    type: str
    role: Role
    stamps_ns: IntArray
    received_ns: IntArray | None = None
    read_value: Callable[[int], SensorValue] = field(repr=False)

    @property
    def ordering_times_ns(self) -> IntArray:
        """(count,) the clock that orders the messages."""
        return self.stamps_ns if self.received_ns is None else self.received_ns


class StampedRecording:
    """Recording over streams whose stamps are known in advance, in the order of their times.

    At equal times messages are in the order of their topics' names. ``on_close`` frees the files
    of the streams.
    """

    def __init__(
        self,
        path: Path,
        format: str,
        streams: Sequence[StampedStream],
        warnings: Collection[str] = (),
        *,
        stamps_are_nominal: bool = False,
        on_close: Callable[[], None] | None = None,
    ) -> None:
        self.path = path
        self.format = format
        self.stamps_are_nominal = stamps_are_nominal
        self.warnings = list(warnings)
        self._skipped = SkippedMessages(self.warnings)
        self._on_close = on_close
        self._closed = False
        self._streams = {stream.name: stream for stream in sorted(streams, key=lambda s: s.name)}
        self.topics = tuple(_topic(stream, stamps_are_nominal) for stream in self._streams.values())
        clocks = [s.ordering_times_ns for s in self._streams.values() if len(s.stamps_ns)]
        timeless = stamps_are_nominal or not clocks
        self.start_ns = None if timeless else min(int(clock.min()) for clock in clocks)
        self.end_ns = None if timeless else max(int(clock.max()) for clock in clocks)

    def received_ns(self, topic: str) -> IntArray:
        """(count,) log times of a topic's messages; the sensor's stamps where there is no log."""
        return self._stream(topic).ordering_times_ns

    def stamps_ns(self, topic: str) -> IntArray:
        """(count,) the sensor's stamps of a topic's messages."""
        return self._stream(topic).stamps_ns

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Message]:
        """Messages with start <= time < end, in order; damaged ones are skipped with a warning."""
        self._require_open()
        names = sorted(self._streams if topics is None else set(topics))
        return self._iterate([self._stream(name) for name in names], start_ns, end_ns)

    def read(self, topic: str, index: int) -> Message:
        """The ``index``-th message of a topic. Raises IndexError beyond its count."""
        stream = self._stream(topic)
        count = len(stream.stamps_ns)
        if not 0 <= index < count:
            raise IndexError(f"{topic} has {count} messages, there is no {index}")
        return Message(
            topic=topic,
            index=index,
            received_ns=None if stream.received_ns is None else int(stream.received_ns[index]),
            stamp_ns=int(stream.stamps_ns[index]),
            value=stream.read_value(index),
        )

    def close(self) -> None:
        """Refuse further reading and free what is held open."""
        if not self._closed and self._on_close is not None:
            self._on_close()
        self._closed = True

    def __enter__(self) -> "StampedRecording":
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _iterate(
        self, streams: Sequence[StampedStream], start_ns: int | None, end_ns: int | None
    ) -> Iterator[Message]:
        sizes = [len(stream.stamps_ns) for stream in streams]
        empty = np.empty(0, dtype=np.int64)
        times = np.concatenate([empty, *[stream.ordering_times_ns for stream in streams]])
        owners = np.repeat(np.arange(len(streams)), sizes)
        indexes = np.concatenate([empty, *[np.arange(size) for size in sizes]])
        for place in np.lexsort((indexes, owners, times)):
            if start_ns is not None and times[place] < start_ns:
                continue
            if end_ns is not None and times[place] >= end_ns:
                return
            stream, index = streams[owners[place]], int(indexes[place])
            try:
                message = self.read(stream.name, index)
            except RecordingError as error:
                self._require_open()
                self._skipped.add(stream.name, index, len(stream.stamps_ns), error)
            else:
                yield message

    def _stream(self, topic: str) -> StampedStream:
        self._require_open()
        if topic not in self._streams:
            raise unknown_topic_error(topic, self.topics, self.path)
        return self._streams[topic]

    def _require_open(self) -> None:
        if self._closed:
            raise RecordingError("is closed.", file=self.path, advice="Open it again.")


def _topic(stream: StampedStream, stamps_are_nominal: bool) -> Topic:
    count = len(stream.stamps_ns)
    rate_hz = None
    if count >= 2 and not stamps_are_nominal:
        span_ns = int(stream.ordering_times_ns[-1] - stream.ordering_times_ns[0])
        rate_hz = (count - 1) * NS_PER_S / span_ns if span_ns > 0 else None
    return Topic(name=stream.name, type=stream.type, role=stream.role, count=count, rate_hz=rate_hz)
