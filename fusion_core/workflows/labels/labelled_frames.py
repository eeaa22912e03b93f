"""The frames of a recording in which a layer has labels, matched by the chain."""

from collections.abc import Iterator
from dataclasses import dataclass

from fusion_core.model.conventions import IntArray, read_only
from fusion_core.model.errors import AlignmentFailed, RecordingError
from fusion_core.model.labels import LabelLayer
from fusion_core.model.progress import Progress, silent
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.frame_labels import SessionLabels
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.settings import ChainSettings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledFrame:
    """A matched frame. ``lidar``, ``depth``: (B,) codes of Label of its pairs' beams and pixels,
    NO_LABEL for none; at least one is labelled."""

    match: FrameMatch
    lidar: IntArray
    depth: IntArray

    def __post_init__(self) -> None:
        read_only(self.lidar)
        read_only(self.depth)


def labelled_frames(
    chain: CachedChain,
    settings: ChainSettings,
    layer: LabelLayer,
    clock_offset_ms: float = 0.0,
    progress: Progress = silent,
) -> Iterator[LabelledFrame]:
    """The frames in order. Those without a label are not matched; those that cannot be read or
    matched are left out."""
    labels = SessionLabels(session=chain.session, layer=layer)
    for number in range(len(chain.frames)):
        progress(number, len(chain.frames), "reading the labelled frames")
        try:
            paired = chain.frames.pair(number, clock_offset_ms)
            if not labels.are_on(paired):
                continue
            choice = FrameChoice(number=number, clock_offset_ms=clock_offset_ms)
            match = chain.match_once(choice, settings)
        except (AlignmentFailed, RecordingError):
            continue
        lidar, depth = labels.of_pairs(match)
        if (lidar >= 0).any() or (depth >= 0).any():
            yield LabelledFrame(match=match, lidar=lidar, depth=depth)
