"""The runs of one automatic class in a frame: what a person reviews one by one."""

from dataclasses import dataclass, fields

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import FloatArray, Int32Array, IntArray, read_only
from fusion_core.model.labels import Capture, CaptureLabels, SensorKind
from fusion_core.workflows.fuse.captures import FrameCaptures
from fusion_core.workflows.fuse.frame import FusedFrame

SENSORS: tuple[SensorKind, ...] = ("lidar", "depth")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameRuns:
    """A frame's R runs of neighbouring beams, or of pixels along the curve, of one class each.

    ``sensor``: (R,) indices into SENSORS. ``noise_class``: (R,) codes. ``confidence``: (R,) the
    least of a run's samples. The samples of run r are those from ``start[r]`` to ``start[r + 1]``
    of ``row``, ``column`` (S,), as labels name them, and ``beam`` (S,), the beam of each pixel's
    pair. ``start``: (R + 1,).
    """

    scan: Capture | None
    image: Capture
    sensor: IntArray
    noise_class: IntArray
    confidence: FloatArray
    start: Int32Array
    row: Int32Array
    column: Int32Array
    beam: Int32Array

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name not in {"scan", "image"}:
                read_only(getattr(self, field.name))

    def __len__(self) -> int:
        return self.sensor.size

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        arrays = (getattr(self, field.name) for field in fields(self))
        return sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))

    def capture(self, run: int) -> Capture:
        """The scan or the image that a run is in."""
        if SENSORS[self.sensor[run]] == "depth":
            return self.image
        assert self.scan is not None, "a virtual LiDAR has no runs"
        return self.scan

    def samples(self, run: int) -> slice:
        """Where a run's samples are."""
        return slice(int(self.start[run]), int(self.start[run + 1]))

    def labels(self, run: int, label: int, part: slice | None = None) -> CaptureLabels:
        """One label for the samples of a run, or for ``part`` of all samples."""
        own = self.samples(run) if part is None else part
        row, column = self.row[own].astype(np.int64), self.column[own].astype(np.int64)
        return CaptureLabels.of_samples(self.capture(run), row, column, label)


def runs_of_frame(frame: FusedFrame, captures: FrameCaptures) -> FrameRuns:
    """The runs of both sensors, the LiDAR's first, in the order of the beams."""
    classes, on_scan = frame.classes, captures.scan is not None
    has_pixel = np.flatnonzero(captures.row >= 0)
    beams = np.arange(captures.beam.size) if on_scan else np.arange(0)
    place = np.concatenate([beams, has_pixel])
    sensor = np.repeat([0, 1], [beams.size, has_pixel.size])
    noise_class = np.concatenate([classes.lidar_class[beams], classes.depth_class[has_pixel]])
    confidence = np.concatenate(
        [classes.lidar_confidence[beams], classes.depth_confidence[has_pixel]]
    )
    beam = captures.beam[place]
    # Beyond the seam of a full circle beam 0 follows the last.
    step = np.diff(beam)
    count = 0 if captures.scan is None else captures.scan.columns
    follows = (np.abs(step) == 1) | ((count > 0) & (np.abs(step) == count - 1))
    parted = (np.diff(sensor) != 0) | (np.diff(noise_class) != 0) | ~follows
    start = np.concatenate([[0], np.flatnonzero(parted) + 1])[: place.size]
    is_lidar = sensor == 0
    return FrameRuns(
        scan=captures.scan,
        image=captures.image,
        sensor=sensor[start],
        noise_class=noise_class[start],
        confidence=np.minimum.reduceat(confidence, start) if start.size else confidence,
        start=np.append(start, place.size).astype(np.int32),
        row=np.where(is_lidar, 0, captures.row[place]).astype(np.int32),
        column=np.where(is_lidar, beam, captures.column[place]).astype(np.int32),
        beam=beam.astype(np.int32),
    )


def class_name(code: int) -> str:
    """A class in words."""
    return NoiseClass(code).name.lower()
