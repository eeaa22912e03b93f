"""The geometry of scans and images, and a filter for messages that do not have it.

A driver that is reconfigured during a recording changes the size of its images or the beams of its
scans. Messages of another geometry are left out with a warning.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.model.recording import Message, Recording
from fusion_core.model.sensors import DepthImage, LaserScan, SensorValue
from fusion_core.recordings.skipped import SkippedMessages
from fusion_core.workflows.stamp_filter import StampFilter

# Five seconds of a 10 Hz LiDAR: the majority of the first scans has the geometry of the rest.
_SCANS_SAMPLED = 50
# Drivers round their angles: no beam may be off by more than this fraction of a step.
_STEP_TOLERANCE = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanGeometry:
    """The beams of a scanner."""

    beams: int
    angle_min_rad: float
    angle_increment_rad: float

    @classmethod
    def of(cls, scan: LaserScan) -> "ScanGeometry":
        """That of one sweep."""
        return cls(
            beams=scan.ranges_m.size,
            angle_min_rad=scan.angle_min_rad,
            angle_increment_rad=scan.angle_increment_rad,
        )

    def matches(self, scan: LaserScan) -> bool:
        """Whether the beams of a scan have these angles."""
        limit_rad = _STEP_TOLERANCE * abs(self.angle_increment_rad)
        first_rad = abs(scan.angle_min_rad - self.angle_min_rad)
        last_rad = abs(scan.angle_increment_rad - self.angle_increment_rad) * self.beams
        return scan.ranges_m.size == self.beams and first_rad + last_rad <= limit_rad


def first_value(recording: Recording, topic: str) -> SensorValue | None:
    """The first value of a topic that can be read, None where there is none."""
    message = next(iter(recording.messages([topic])), None)
    return None if message is None else message.value


def first_scan(recording: Recording, topic: str) -> LaserScan:
    """The first scan of a LiDAR's topic that can be read.

    Raises MissingStream where there is none, with what is wrong with the first message.
    """
    found = first_value(recording, topic)
    if isinstance(found, LaserScan):
        return found
    problem = f"{topic} holds no scan that can be read"
    count = next(own.count for own in recording.topics if own.name == topic)
    try:
        if count:
            recording.read(topic, 0)
    except RecordingError as error:
        problem = f"{problem}, the first of its {count} messages: {error.problem}"
        raise MissingStream(problem, file=recording.path, advice=error.advice) from error
    raise MissingStream(
        f"{problem}.", file=recording.path, advice="Name another topic with --lidar."
    )


def most_common_geometry(recording: Recording, topic: str) -> ScanGeometry | None:
    """The geometry of most of a topic's first scans, None where it has no readable scan."""
    scans = (message.value for message in recording.messages([topic]))
    seen = Counter(
        ScanGeometry.of(scan)
        for scan in islice(scans, _SCANS_SAMPLED)
        if isinstance(scan, LaserScan)
    )
    return seen.most_common(1)[0][0] if seen else None


class GeometryFilter:
    """Passes on the messages of the rig's geometry that are stamped in order, and adds warnings of
    the others to the recording."""

    def __init__(
        self,
        recording: Recording,
        geometry: ScanGeometry | None,
        image_shapes: dict[str, tuple[int, int]],
    ) -> None:
        self._geometry = geometry
        self._shapes = image_shapes
        self._order = StampFilter(recording)
        self._counts = {topic.name: topic.count for topic in recording.topics}
        self._skipped = SkippedMessages(recording.warnings)

    def accepted(self, messages: Iterator[Message]) -> Iterator[Message]:
        """The messages of the rig's geometry, in order."""
        for message in self._order.accepted(messages):
            problem = self._problem(message.topic, message.value)
            if problem:
                count = self._counts[message.topic]
                error = RecordingError(problem, advice="It is of another rig than the rest.")
                self._skipped.add(message.topic, message.index, count, error)
            else:
                yield message

    def is_in_order(self, topic: str, index: int) -> bool:
        """Whether the ``index``-th message of a topic is stamped in order."""
        return self._order.is_in_order(topic, index)

    def require_most_in_order(self, topics: Iterable[str]) -> None:
        """Raise RecordingError where more than half of a topic is stamped out of order."""
        for topic in topics:
            self._order.require_most_in_order(topic)

    def _problem(self, topic: str, value: SensorValue) -> str:
        shape = self._shapes.get(topic)
        if isinstance(value, DepthImage) and shape is not None and value.depth_m.shape != shape:
            height, width = value.depth_m.shape
            return f"an image of {width} x {height} pixels, not {shape[1]} x {shape[0]}."
        usual = self._geometry
        if isinstance(value, LaserScan) and usual is not None and not usual.matches(value):
            found = ScanGeometry.of(value)
            return f"a scan of {_describe_geometry(found)}, not {_describe_geometry(usual)}."
        return ""


def _describe_geometry(geometry: ScanGeometry) -> str:
    return (
        f"{geometry.beams} beams from {geometry.angle_min_rad:.4f} rad "
        f"in steps of {geometry.angle_increment_rad:.5f} rad"
    )
