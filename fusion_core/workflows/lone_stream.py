"""Random access to a recording that has no depth images: by its scans, or by its poses alone."""

import numpy as np

from fusion_core.model.conventions import IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import LaserScan, PoseSample, SensorValue


class LoneStream:
    """The messages of one topic in the order of their log, numbered from 0. Safe for threads.

    ``topic`` is None for a recording that has nothing to show: then there are no messages.
    """

    def __init__(self, recording: Recording, topic: str | None) -> None:
        self._recording, self._topic = recording, topic
        times_ns = np.empty(0, np.int64) if topic is None else recording.received_ns(topic)
        # A file may hold what was logged at one time in any order.
        self._order = np.argsort(times_ns, kind="stable")
        self.times_ns = times_ns[self._order]

    def stamps_ns(self) -> IntArray:
        """(N,) the sensor's stamps; NO_STAMP for what cannot be read."""
        if self._topic is None:
            return self.times_ns
        return self._recording.stamps_ns(self._topic)[self._order]

    def __len__(self) -> int:
        return int(self.times_ns.size)

    def read(self, number: int) -> LaserScan | PoseSample:
        """A message's value. Raises IndexError beyond the last, RecordingError for one that cannot
        be read."""
        if self._topic is None:
            raise IndexError(number)
        value: SensorValue = self._recording.read(self._topic, int(self._order[number])).value
        if not isinstance(value, LaserScan | PoseSample):
            raise RecordingError(
                f"{self._topic}: message {number + 1} holds neither a scan nor a pose.",
                file=self._recording.path,
                advice="Go to another one.",
            )
        return value
