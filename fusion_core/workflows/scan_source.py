"""The scans that motion and SLAM work on, read anew each time they are needed."""

from collections.abc import Iterator
from typing import Literal, Protocol

from fusion_core.model.errors import MissingStream
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import LaserScan
from fusion_core.recordings.topics import Streams

ScanKind = Literal["lidar", "camera", "repaired", "merged"]


class Scans(Protocol):
    """Scans with stamps that increase, any number of times.

    ``frame_id``: the frame in which they lie. ``notes``: for people, complete once the scans were
    read to their end.
    """

    frame_id: str

    @property
    def notes(self) -> tuple[str, ...]: ...

    def __iter__(self) -> Iterator[LaserScan]: ...


class LidarScans:
    """The scans of a topic as they were recorded."""

    def __init__(self, recording: Recording, streams: Streams) -> None:
        if streams.lidar is None:
            raise MissingStream(
                "holds no LaserScan.",
                file=recording.path,
                advice="scanloom info lists what it holds.",
            )
        self._recording, self._topic = recording, streams.lidar
        self._out_of_order = 0
        first = next(iter(self), None)
        if first is None:
            raise MissingStream(f"{streams.lidar} holds no scan.", file=recording.path)
        self.frame_id = first.frame_id

    @property
    def notes(self) -> tuple[str, ...]:
        if not self._out_of_order:
            return ()
        return (f"{self._out_of_order} scans out of order in time are left out.",)

    def __iter__(self) -> Iterator[LaserScan]:
        last_ns: int | None = None
        self._out_of_order = 0
        for message in self._recording.messages([self._topic]):
            if not isinstance(message.value, LaserScan):
                continue
            if last_ns is not None and message.value.stamp_ns <= last_ns:
                self._out_of_order += 1
                continue
            last_ns = message.value.stamp_ns
            yield message.value
