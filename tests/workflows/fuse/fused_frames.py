"""Pass 2 with whole frames, of which a run keeps the results alone."""

from collections.abc import Iterator

from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_labels import SessionLabels
from fusion_core.workflows.fuse.frame_tasks import FrameFuser, FrameTask, frame_tasks
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import Session


def fuse_frames(
    session: Session,
    alignment: RecordingAlignment,
    clock_offset_ms: float = 0.0,
    labels: SessionLabels | None = None,
) -> Iterator[LaserScan | PairedImage | FusedFrame]:
    """Scans as they arrive, fused frames whole, and the images that could not be fused."""
    fuser = FrameFuser(setup=session.setup, alignment=alignment)
    for entry in frame_tasks(session, alignment, clock_offset_ms, labels):
        if isinstance(entry, FrameTask):
            fused = fuser.fuse(entry)
            yield from entry.images if fused is None else fused
        else:
            yield entry
