"""The chain on single frames with caches, for browsing a recording.

A result is cached by its input and the settings of its stage and those before it, so that a new
epsilon or a new label repeats classification and repair, but no search.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace

from fusion_core.alignment.search import MeanField
from fusion_core.alignment.similarity import SimilarityField
from fusion_core.model.bounded_cache import BoundedCache
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import AlignmentFailed, RecordingError, ScanLoomError
from fusion_core.model.labels import LabelLayer
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import FusedFrame, classify_and_repair
from fusion_core.workflows.fuse.frame_labels import FrameLabels, SessionLabels
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.match_images import match_images, split_into_frames
from fusion_core.workflows.fuse.moved_rig import align_moved
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.fuse.settings import ChainSettings

# A frame of 320 x 240 with its fields takes about 2 MiB.
_FRAMES_KEPT = 48
# Frames without a scan are few, and mostly at the start.
_FRAMES_TRIED = 8
# The frames of a panorama follow each other.
_PANORAMAS_KEPT = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameChoice:
    """A frame of a recording. ``picked_offset``: an offset (u, v) chosen by hand."""

    number: int
    clock_offset_ms: float = 0.0
    picked_offset: tuple[float, float] | None = None


class CachedChain:
    """The chain of one session with one alignment. Thread-safe, so that clients may share it."""

    def __init__(
        self, session: Session, frames: FrameReader, alignment: RecordingAlignment
    ) -> None:
        self.session = session
        self.frames = frames
        self.alignment = alignment
        self._pairs: BoundedCache[Hashable, PairedImage] = BoundedCache(_FRAMES_KEPT)
        self._matches: BoundedCache[Hashable, FrameMatch] = BoundedCache(_FRAMES_KEPT)
        self._fused: BoundedCache[Hashable, FusedFrame] = BoundedCache(_FRAMES_KEPT)
        self._panoramas: BoundedCache[Hashable, list[FrameMatch] | None] = BoundedCache(
            _PANORAMAS_KEPT
        )

    def moved(self, T_lidar_camera: FloatArray) -> "CachedChain":
        """The chain with the first camera at this pose (4, 4). It shares what was read, and keeps
        results of its own."""
        session, alignment = align_moved(self.alignment, self.session, T_lidar_camera)
        chain = CachedChain(session, self.frames, alignment)
        chain._pairs = self._pairs
        return chain

    def pair(self, choice: FrameChoice) -> PairedImage:
        """The frame and its scan. Raises RecordingError for a frame that cannot be read."""
        key = (choice.number, choice.clock_offset_ms)
        return self._pairs.get_or_compute(
            key, lambda: self.frames.pair(choice.number, choice.clock_offset_ms)
        )

    def match(self, choice: FrameChoice, settings: ChainSettings) -> FrameMatch:
        """Fields, pairs and A of a frame.

        Raises AlignmentFailed where no scan is near enough in time, or the frame has no peak.
        """
        return self._matches.get_or_compute(
            (choice, settings.read_by("match")),
            lambda: self._match(self.pair(choice), choice, settings),
        )

    def match_once(self, choice: FrameChoice, settings: ChainSettings) -> FrameMatch:
        """As ``match``, for a pass over many frames: with fields and peaks only where pairs rest
        on them, and it displaces none of the frames that are kept.

        Raises as ``match``, and RecordingError for a frame that cannot be read.
        """
        paired = self.frames.pair(choice.number, choice.clock_offset_ms)
        return self._match(paired, choice, settings, pairs_only=True)

    def fused(
        self, choice: FrameChoice, settings: ChainSettings, labels: LabelLayer | None = None
    ) -> FusedFrame:
        """Classes and repairs of a frame, by the labels that ``labels`` has now. Raises as
        ``match``."""
        match = self.match(choice, settings)
        judged = self._labels_of(match, labels)
        return self._fused.get_or_compute(
            (choice, settings.read_by("repair"), None if judged is None else judged.sha256),
            lambda: classify_and_repair(match, self.alignment, settings, judged),
        )

    def _labels_of(self, match: FrameMatch, labels: LabelLayer | None) -> FrameLabels | None:
        if labels is None:
            return None
        return SessionLabels(session=self.session, layer=labels).of_match(match)

    def prepare(self, check: Callable[[], None] = lambda: None) -> None:
        """Fuse the first frame that can be, among some: what that compiles, later frames need not
        wait for. ``check`` is called before each and may raise to end it."""
        for number in range(min(len(self.frames), _FRAMES_TRIED)):
            check()
            try:
                self.fused(FrameChoice(number=number), self.session.settings)
            except ScanLoomError:
                continue
            return

    def fuse_all(
        self,
        settings: ChainSettings,
        clock_offset_ms: float = 0.0,
        labels: LabelLayer | None = None,
    ) -> Iterator[FusedFrame | PairedImage]:
        """All frames in order, those that could not be fused as they are; none of them is cached.

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
                judged = self._labels_of(match, labels)
                yield classify_and_repair(match, self.alignment, settings, judged)
            except AlignmentFailed:
                yield paired

    def _match(
        self,
        paired: PairedImage,
        choice: FrameChoice,
        settings: ChainSettings,
        *,
        pairs_only: bool = False,
    ) -> FrameMatch:
        numbers: tuple[int, ...] = (choice.number,)
        if self.alignment.panorama is not None:
            numbers = self.frames.panorama(choice.number)
        if len(numbers) > 1:
            matches = self._panoramas.get_or_compute(
                (
                    numbers,
                    replace(choice, number=numbers[0]),
                    settings.read_by("match"),
                    pairs_only,
                ),
                lambda: self._match_panorama(numbers, choice, settings, pairs_only=pairs_only),
            )
            if matches is not None:
                return matches[numbers.index(choice.number)]
        pair = self.session.frame_pair(paired, self.frames.previous(choice.number))
        if pair is None:
            if settings.time.pair_by == "rates":
                raise AlignmentFailed(
                    "the two rates give no scan for this depth image.",
                    advice="Set time.pair_by to nearest, or go to another frame.",
                )
            raise AlignmentFailed(
                f"no scan lies within {settings.time.max_gap_ms:g} ms of this depth image.",
                advice="Widen time.max_gap_ms, or go to another frame.",
            )
        picked = choice.picked_offset
        return match_images(
            (pair,), self.alignment, settings, picked=picked, pairs_only=pairs_only
        )[0]

    def _match_panorama(
        self,
        numbers: Sequence[int],
        choice: FrameChoice,
        settings: ChainSettings,
        *,
        pairs_only: bool,
    ) -> list[FrameMatch] | None:
        """The matches of the frames of one instant, None where they make no panorama."""
        group = [self.frames.pair(number, choice.clock_offset_ms) for number in numbers]
        frame = split_into_frames(group, settings)[0]
        if len(frame) < len(group):
            return None
        pairs = []
        for number, entry in zip(numbers, frame, strict=True):
            pair = self.session.frame_pair(entry, self.frames.previous(number))
            assert pair is not None, "the image has a scan"
            pairs.append(pair)
        picked = choice.picked_offset
        return match_images(pairs, self.alignment, settings, picked=picked, pairs_only=pairs_only)


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
