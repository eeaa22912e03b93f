"""How noisy each frame of a recording is: its pairs counted by class, in the background."""

import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray, read_only
from fusion_core.model.errors import RecordingError
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.captures import frame_captures
from fusion_core.workflows.fuse.frame import FusedFrame, classify_and_repair
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.pairing_gaps import PairingStamps
from fusion_core.workflows.fuse.settings import ChainSettings
from scanloom.jobs.long_job import Cancelled
from scanloom.state.frame_runs import FrameRuns, runs_of_frame

# A strip on a wide screen has about as many columns; a frame takes 30 ms and more.
MAX_SAMPLED = 2000
# A share of fewer pairs is large by chance.
MIN_PAIRS = 20
# What one sensor sees and the other does not covers several beams; one or two are stray.
CONFLICT_PAIRS = 3


class FrameStatus(IntEnum):
    """What is known of a frame."""

    UNKNOWN = 0
    COUNTED = 1
    UNTRUSTED = 2
    """Counted, but its pairs rest on an offset that is not trusted."""
    UNMATCHED = 3
    NO_SCAN = 4
    UNREADABLE = 5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameCounts:
    """The frames of a recording as far as they are counted.

    ``counts``: (F, 4) float32, pairs by NoiseClass, NaN where unknown; a pair has the worse class
    of its two sides. ``status``: (F,) FrameStatus. ``done`` of ``total`` frames to be visited were;
    ``total`` < F where a long recording is sampled.
    """

    counts: Float32Array
    status: IntArray
    done: int
    total: int

    def __post_init__(self) -> None:
        if self.counts.shape != (self.status.size, len(NoiseClass)):
            raise ValueError("counts and status must be of the same frames")
        for array in (self.counts, self.status):
            read_only(array)

    @property
    def is_complete(self) -> bool:
        """Whether all frames to be visited were."""
        return self.done >= self.total

    @property
    def is_sampled(self) -> bool:
        """Whether frames are left out because there are too many."""
        return self.total < self.status.size

    @property
    def noise_share(self) -> FloatArray:
        """(F,) share of the pairs that are not good; NaN where unknown or without pairs."""
        pairs = self.counts.sum(axis=1, dtype=np.float64)
        noise = pairs - self.counts[:, NoiseClass.GOOD]
        share: FloatArray = np.full(pairs.shape, np.nan)
        np.divide(noise, pairs, out=share, where=pairs > 0.0)
        return share

    def worst_frame(self) -> int | None:
        """The counted frame with the largest share of noise, the first of equal ones; None where no
        frame with enough pairs has any."""
        share = self.noise_share
        with np.errstate(invalid="ignore"):
            share[~(self.counts.sum(axis=1) >= MIN_PAIRS)] = np.nan
        if not (np.nan_to_num(share) > 0.0).any():
            return None
        return int(np.nanargmax(share))

    def next_conflict(self, after: int, direction: int = 1) -> int | None:
        """The first frame of the next stretch of frames with a conflict, or of the previous one for
        ``direction`` -1, beginning again at the other end; None where no other frame is one.

        Frames that are not counted end no stretch.
        """
        conflicts = self.counts[:, NoiseClass.CONFLICT]
        counted = np.flatnonzero(np.isfinite(conflicts))
        has_conflict = conflicts[counted] >= CONFLICT_PAIRS
        begins = counted[has_conflict & ~np.concatenate([[False], has_conflict[:-1]])]
        begins = begins[begins != after]
        if not begins.size:
            return None
        place = int(np.searchsorted(begins, after))
        return int(begins[place % begins.size if direction > 0 else place - 1])


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveyInputs:
    """What a survey counts. ``pairing``: the recording's stamps, where they are known."""

    chain: CachedChain
    settings: ChainSettings
    clock_offset_ms: float = 0.0
    pairing: PairingStamps | None = None

    @property
    def key(self) -> Hashable:
        """All that the counts of one recording depend on."""
        mount, camera = self.chain.alignment.mount, self.chain.session.rig.cameras[0]
        pose = mount.vector().tobytes(), camera.T_rig_camera.tobytes()
        return self.settings.read_by("repair"), self.clock_offset_ms, pose


class FrameSurvey:
    """Counts the pairs of a recording's frames, coarse to fine. Thread-safe.

    Of a long recording MAX_SAMPLED frames are visited, evenly spread.
    """

    def __init__(self, inputs: SurveyInputs) -> None:
        frames = inputs.chain.frames
        self.inputs = inputs
        self._lock = threading.Lock()
        self._counts = np.full((len(frames), len(NoiseClass)), np.nan, dtype=np.float32)
        self._status = np.full(len(frames), FrameStatus.UNKNOWN, dtype=np.int8)
        self._status[_without_scan(inputs)] = FrameStatus.NO_SCAN
        cameras = len(inputs.chain.session.rig.cameras)
        self._runs: list[FrameRuns | None] = [None] * len(frames)
        self._runs_bytes = 0
        self._order = visiting_order(len(frames), cameras).tolist()
        self._total = len(self._order)
        self._place = 0
        self._snapshot: FrameCounts | None = None

    @property
    def counts(self) -> FrameCounts:
        """What is known by now; the same object until more is."""
        with self._lock:
            if self._snapshot is None:
                self._snapshot = FrameCounts(
                    counts=self._counts.copy(),
                    status=self._status.astype(np.int64),
                    done=self._place,
                    total=self._total,
                )
            return self._snapshot

    @property
    def runs(self) -> tuple[FrameRuns | None, ...]:
        """The runs of each frame that is counted, None of the others."""
        with self._lock:
            return tuple(self._runs)

    @property
    def nbytes(self) -> int:
        """Bytes of what is kept of all frames, but for Python's objects around it."""
        with self._lock:
            return self._counts.nbytes + self._status.nbytes + self._runs_bytes

    @property
    def done(self) -> int:
        """How many frames were visited."""
        return self._place

    @property
    def is_complete(self) -> bool:
        """Whether all frames to be visited were."""
        return self._place >= self._total

    def advance(self, give_way: Callable[[], None] = lambda: None) -> bool:
        """Count the next frame. False when there is none.

        ``give_way`` is called between the steps; it may raise Cancelled, and the frame is left.
        """
        while True:
            with self._lock:
                if self._place >= self._total:
                    return False
                number = self._order[self._place]
                is_known = self._status[number] != FrameStatus.UNKNOWN
                if is_known:
                    self._place += 1
                    self._snapshot = None
            if not is_known:
                break
        for beside in self._numbers_with(number):
            give_way()
            self._count(beside, give_way)
        with self._lock:
            self._place += 1
            self._snapshot = None
        return True

    def note(self, number: int, frame: FusedFrame) -> None:
        """Take over a frame that was computed for somebody, with the inputs' settings."""
        found = self._found_in(frame)
        with self._lock:
            if self._status[number] == FrameStatus.UNKNOWN:
                self._set(number, found)

    def _numbers_with(self, number: int) -> tuple[int, ...]:
        """The frames that are matched together with one: the chain keeps them for a moment."""
        if self.inputs.chain.alignment.panorama is None:
            return (number,)
        try:
            return self.inputs.chain.frames.panorama(number)
        except RecordingError:
            return (number,)

    def _count(self, number: int, give_way: Callable[[], None]) -> None:
        chain, settings = self.inputs.chain, self.inputs.settings
        try:
            choice = FrameChoice(number=number, clock_offset_ms=self.inputs.clock_offset_ms)
            if chain.frames.pair(number, self.inputs.clock_offset_ms).window is None:
                found = _Found(status=FrameStatus.NO_SCAN)
            else:
                match = chain.match_once(choice, settings)
                give_way()
                found = self._found_in(classify_and_repair(match, chain.alignment, settings))
        except RecordingError:
            found = _Found(status=FrameStatus.UNREADABLE)
        except Cancelled:
            raise
        except Exception:  # noqa: BLE001  # whoever goes to the frame is told why
            found = _Found(status=FrameStatus.UNMATCHED)
        with self._lock:
            self._set(number, found)

    def _found_in(self, frame: FusedFrame) -> "_Found":
        is_trusted = is_offset_trusted(frame.match, self.inputs.settings)
        captures = frame_captures(frame.match, self.inputs.chain.session)
        return _Found(
            status=FrameStatus.COUNTED if is_trusted else FrameStatus.UNTRUSTED,
            counts=pairs_by_class(frame),
            runs=runs_of_frame(frame, captures),
        )

    def _set(self, number: int, found: "_Found") -> None:
        self._status[number] = found.status
        if found.counts is not None:
            self._counts[number] = found.counts
        for runs, sign in ((self._runs[number], -1), (found.runs, 1)):
            self._runs_bytes += 0 if runs is None else sign * runs.nbytes
        self._runs[number] = found.runs
        self._snapshot = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Found:
    """What is known of one frame; no counts and no runs of one that could not be matched."""

    status: FrameStatus
    counts: IntArray | None = None
    runs: FrameRuns | None = None


def pairs_by_class(frame: FusedFrame) -> IntArray:
    """(4,) pairs by NoiseClass."""
    counts: IntArray = np.bincount(frame.pair_class, minlength=len(NoiseClass))
    return counts


def is_offset_trusted(match: FrameMatch, settings: ChainSettings) -> bool:
    """Whether a frame's pairs lie where they should.

    Pairs along the curve rest on the recording's mount. Those in a row rest on the frame's own
    offset, which is trusted where the best one anywhere is the one near the recording's.
    """
    if match.row_model == "curve":
        return True
    peak = match.search.peaks.get(settings.search.metric)
    alone = match.search.peaks_without_prior.get(settings.search.metric)
    if peak is None or alone is None:
        return False
    return bool(abs(match.curve.difference(alone.u, peak.u)) <= settings.search.prior_samples)


def visiting_order(frames: int, cameras: int = 1) -> IntArray:
    """(<= MAX_SAMPLED,) distinct frames, evenly spread, in an order in which any beginning is
    spread over the recording, too."""
    numbers = np.arange(frames)
    if frames > MAX_SAMPLED:
        numbers = np.linspace(0, frames - 1, MAX_SAMPLED).astype(np.int64)
        # The frames of cameras that take turns must not be those of one camera only.
        numbers = np.unique(np.minimum(numbers + np.arange(MAX_SAMPLED) % cameras, frames - 1))
    bits = max(int(numbers.size - 1).bit_length(), 1)
    places = np.arange(1 << bits)
    reversed_ = np.zeros_like(places)
    for bit in range(bits):
        reversed_ |= ((places >> bit) & 1) << (bits - 1 - bit)
    order: IntArray = numbers[reversed_[reversed_ < numbers.size]]
    return order


def _without_scan(inputs: SurveyInputs) -> BoolArray:
    """(F,) frames that have no scan near enough, by the stamps of the first pass."""
    times_ns = inputs.chain.frames.times_ns
    if inputs.pairing is None or inputs.chain.session.virtual_row is not None:
        return np.zeros(times_ns.size, dtype=np.bool_)
    gaps = inputs.pairing.gaps(inputs.clock_offset_ms, inputs.settings.time)
    unpaired_ns, paired_ns = gaps.time_ns[~gaps.is_paired], gaps.time_ns[gaps.is_paired]
    # Cameras may log at one time: then the frame itself has to be looked at.
    found: BoolArray = np.isin(times_ns, unpaired_ns) & ~np.isin(times_ns, paired_ns)
    return found
