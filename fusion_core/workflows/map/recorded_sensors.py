"""The sensors of a recording, and how their frames and clocks relate."""

from dataclasses import dataclass

from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.given_extrinsics import GivenExtrinsics
from fusion_core.model.recording import Recording
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.map.extrinsics import CameraExtrinsics


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedSensors:
    """The streams of a recording with what relates cameras and LiDAR.

    ``extrinsics``: None where they were not looked for. ``given``: those that a person gave, which
    the chain of ``fuse`` uses, None where there are none. ``clock_offset_ms``: camera stamp - LiDAR
    stamp of one instant, which is subtracted from the camera's stamps.
    """

    recording: Recording
    streams: Streams
    extrinsics: CameraExtrinsics | None = None
    given: GivenExtrinsics | None = None
    clock_offset_ms: float = 0.0

    @property
    def clock_offset_ns(self) -> int:
        """The clock offset in the unit of stamps."""
        return round(self.clock_offset_ms * NS_PER_MS)

    @property
    def clock_note(self) -> tuple[str, ...]:
        """For people, where a clock offset is subtracted."""
        if not self.clock_offset_ms:
            return ()
        return (f"Camera stamps taken {self.clock_offset_ms:g} ms earlier.",)
