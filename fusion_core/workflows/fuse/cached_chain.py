"""The chain on single frames, as a person moves through a recording: nothing is computed twice.

A result is kept under what its stage read and the settings of that stage and those before it, so a
new epsilon classifies and repairs again and searches nothing.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Any

from fusion_core.alignment.search import MeanField
from fusion_core.alignment.similarity import SimilarityField
from fusion_core.model.errors import AlignmentFailed, RecordingError, ScanLoomError
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import (
    FrameMatch,
    FusedFrame,
    classify_and_repair,
    match_frame,
)
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.fuse.settings import ChainSettings

# A frame of 320 x 240 with its fields takes about 2 MiB.
_FRAMES_KEPT = 48


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameChoice:
    """What of a recording is looked at. ``picked``: an offset (u, v) chosen by hand."""

    number: int
    clock_offset_ms: float = 0.0
    picked_offset: tuple[float, float] | None = None


class CachedChain:
    """The chain of one session with one alignment. Safe for threads; people may share it."""

    def __init__(
        self, session: Session, frames: FrameReader, alignment: RecordingAlignment
    ) -> None:
        self.session = session
        self.frames = frames
        self.alignment = alignment
        self._pairs = _Kept(_FRAMES_KEPT)
        self._matches = _Kept(_FRAMES_KEPT)
        self._judged = _Kept(_FRAMES_KEPT)

    def pair(self, choice: FrameChoice) -> PairedImage:
        """The frame and its scan. Raises RecordingError for a frame that cannot be read."""
        key = (choice.number, choice.clock_offset_ms)
        found: PairedImage = self._pairs.get(
            key, lambda: self.frames.pair(choice.number, choice.clock_offset_ms)
        )
        return found

    def match(self, choice: FrameChoice, settings: ChainSettings) -> FrameMatch:
        """Fields, pairs and A of a frame.

        Raises AlignmentFailed where no scan is near enough in time, or the frame has no peak.
        """
        key = (choice, settings_of_match(settings))
        found: FrameMatch = self._matches.get(
            key, lambda: self._match(self.pair(choice), choice, settings)
        )
        return found

    def fused(self, choice: FrameChoice, settings: ChainSettings) -> FusedFrame:
        """Classes and repairs of a frame. Raises as ``matched``."""
        match = self.match(choice, settings)
        key = (choice, settings_of_match(settings), settings.noise, settings.repair)
        found: FusedFrame = self._judged.get(
            key, lambda: classify_and_repair(match, self.session.rig, self.alignment, settings)
        )
        return found

    def fuse_all(
        self, settings: ChainSettings, clock_offset_ms: float = 0.0
    ) -> Iterator[FusedFrame | PairedImage]:
        """All frames in turn, those that could not be fused as they are; none of them is kept.

        A frame that cannot be read is left out: reading it has left its own warning.
        """
        for number in range(len(self.frames)):
            choice = FrameChoice(number=number, clock_offset_ms=clock_offset_ms)
            try:
                paired = self.frames.pair(number, clock_offset_ms)
            except RecordingError:
                continue
            try:
                match = self._match(paired, choice, settings)
                yield classify_and_repair(match, self.session.rig, self.alignment, settings)
            except AlignmentFailed:
                yield paired

    def _match(
        self, paired: PairedImage, choice: FrameChoice, settings: ChainSettings
    ) -> FrameMatch:
        if paired.window is None:
            raise AlignmentFailed(
                f"no scan lies within {settings.time.max_gap_ms:g} ms of this depth image.",
                advice="Widen time.max_gap_ms, or go to another frame.",
            )
        return match_frame(
            self.session.rig,
            paired.camera,
            self.session.depth_of(paired.camera, paired.image.depth_m),
            paired.window,
            paired.gap_ns,
            self.alignment,
            settings,
            image=paired.image,
            before=self.frames.before(choice.number),
            picked=choice.picked_offset,
        )


def settings_of_match(settings: ChainSettings) -> Hashable:
    """The settings that a match depends on: all but those of classes and repairs."""
    return (
        settings.time,
        settings.sampling,
        settings.search,
        settings.mount,
        settings.registration,
        settings.pairing,
    )


class _Kept:
    """The last results, by key. Two threads that ask for the same new key may both compute it."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._values: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: Hashable, compute: Callable[[], Any]) -> Any:
        with self._lock:
            if key in self._values:
                self._values.move_to_end(key)
                return self._values[key]
        value = compute()
        with self._lock:
            self._values[key] = value
            while len(self._values) > self._most:
                self._values.popitem(last=False)
        return value


def mean_field_around(
    chain: CachedChain, number: int, settings: ChainSettings, beside: int
) -> tuple[SimilarityField, int]:
    """The mean field of a frame and ``beside`` frames of its camera to either side, and how many
    they are. Frames without a scan or a peak are left out.

    Raises AlignmentFailed where none is left.
    """
    mean = MeanField()
    camera = chain.frames.camera_of(number)
    shape = None
    step = max(1, len(chain.session.rig.cameras))
    for other in range(number - beside * step, number + beside * step + 1):
        if not 0 <= other < len(chain.frames) or chain.frames.camera_of(other) != camera:
            continue
        try:
            fields = chain.match(FrameChoice(number=other), settings).search.fields
        except ScanLoomError:
            continue
        own = next(iter(fields.values())).scores.shape
        shape = shape or own
        if own == shape:
            mean.add(fields)
    return mean.mean(settings.search.metric), mean.frames
