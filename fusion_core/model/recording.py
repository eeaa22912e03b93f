"""The protocol that the reader of every format implements."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from fusion_core.model.conventions import IntArray
from fusion_core.model.sensors import SensorValue

Role = Literal[
    "lidar",
    "depth",
    "color",
    "camera_info",
    "odometry",
    "pose",
    "tf",
    "tf_static",
    "points",
    "joints",
    "other",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A stream of a recording. ``rate_hz`` is None where fewer than two stamps are known."""

    name: str
    type: str
    role: Role
    count: int
    rate_hz: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """A decoded message with both clocks.

    ``received_ns`` is the log's time (None where a format has no log), ``stamp_ns`` the sensor's.
    ``index`` counts from 0 within the topic, in the order of iteration.
    """

    topic: str
    index: int
    received_ns: int | None
    stamp_ns: int
    value: SensorValue


class Recording(Protocol):
    """A recording opened read-only: the index is in memory, values are decoded on demand.

    ``start_ns`` and ``end_ns`` are log times, None where the format has no clock. ``warnings``
    name what could not be read; it may grow while messages are decoded. ``stamps_are_nominal``
    says that stamps were made from frame numbers because the format has none.
    """

    path: Path
    format: str
    topics: tuple[Topic, ...]
    warnings: list[str]
    start_ns: int | None
    end_ns: int | None
    stamps_are_nominal: bool

    def received_ns(self, topic: str) -> IntArray:
        """(count,) log times of a topic's messages, in the order of iteration, without decoding."""
        ...

    def stamps_ns(self, topic: str) -> IntArray:
        """(count,) the sensor's stamps of a topic's messages, in the order of iteration, NO_STAMP
        for what cannot be read or has none; the headers alone are read, and once."""
        ...

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
    ) -> Iterator[Message]:
        """Messages of ``topics`` (all readable if None) with start <= received < end, in order."""
        ...

    def read(self, topic: str, index: int) -> Message:
        """The ``index``-th message of a topic: the same value as iteration gives."""
        ...

    def close(self) -> None:
        """Free the file; a closed recording cannot be read."""
        ...

    def __enter__(self) -> "Recording": ...

    def __exit__(self, *exc: object) -> None: ...
