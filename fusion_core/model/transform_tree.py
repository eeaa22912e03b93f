"""Recorded transforms between frames, and the transform between any two of them at an instant."""

from itertools import pairwise

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import FramesNotConnected, StampOutsideRange
from fusion_core.model.geometry import invert_transform, rigid_fault
from fusion_core.model.interpolation import interpolate_transform
from fusion_core.model.sensors import Transform
from fusion_core.model.stamps import StampNeighbours, find_neighbours

_Pair = tuple[str, str]


class TransformTree:
    """Static and timed transforms, fed in any order, looked up between any two frames.

    Memory: for each pair of frames the ``samples_per_pair`` newest timed samples are kept, 136
    bytes each, so it does not grow with the recording; ``None`` keeps all of them. A look-up older
    than what is kept raises StampOutsideRange.

    Frames need not form a tree. A frame may change its parent, have several, or be part of a
    cycle: a look-up takes the shortest chain of pairs that are known at its instant, and among
    chains of one length the one whose widest gap between samples around the instant is smallest.
    A pair that was once static stays static; its latest static value counts.
    """

    def __init__(self, samples_per_pair: int | None = 4096) -> None:
        if samples_per_pair is not None and samples_per_pair < 2:
            raise ValueError(f"samples_per_pair must be at least 2, got {samples_per_pair}")
        self._samples_per_pair = samples_per_pair
        self._static: dict[_Pair, FloatArray] = {}
        self._timed: dict[_Pair, _Samples] = {}
        self._neighbours: dict[str, dict[str, None]] = {}
        self.rejected_count = 0
        """Transforms that were rejected: not finite, not rigid, or from a frame to itself."""

    @property
    def frames(self) -> tuple[str, ...]:
        """Every frame that has been named, sorted."""
        return tuple(sorted(self._neighbours))

    def add(self, sample: Transform, *, static: bool) -> None:
        """Add one transform; one that is not rigid is rejected and counted in
        ``rejected_count``."""
        if sample.parent == sample.child or rigid_fault(sample.T_parent_child):
            self.rejected_count += 1
            return
        pair = (sample.parent, sample.child)
        self._neighbours.setdefault(sample.parent, {})[sample.child] = None
        self._neighbours.setdefault(sample.child, {})[sample.parent] = None
        if static:
            self._static[pair] = sample.T_parent_child.copy()
        else:
            samples = self._timed.setdefault(pair, _Samples(self._samples_per_pair))
            samples.insert(sample.stamp_ns, sample.T_parent_child)

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray:
        """(4, 4) ``T_target_source`` at an instant, interpolated between recorded stamps.

        Raises FramesNotConnected where no chain of transforms leads from source to target, and
        StampOutsideRange where one does but not at this instant.
        """
        chain = self._find_chain(target, source, stamp_ns)
        if chain is None:
            raise self._make_error(target, source, stamp_ns)
        T_target_source = np.eye(4)
        for parent, child in pairwise(chain):
            T_target_source = T_target_source @ self._pair_transform(parent, child, stamp_ns)
        return T_target_source

    def _find_chain(self, target: str, source: str, stamp_ns: int | None) -> list[str] | None:
        """Frames from target to source, breadth first; pairs at any time if stamp_ns is None."""
        if target not in self._neighbours or source not in self._neighbours:
            return [target] if target == source else None
        next_towards_source = {source: source}
        layer = [(0, source)]
        while layer and target not in next_towards_source:
            reached: list[tuple[int, str, str]] = []
            for widest_gap_ns, frame in layer:
                for neighbour in self._neighbours[frame]:
                    if neighbour in next_towards_source:
                        continue
                    gap_ns = 0 if stamp_ns is None else self._gap_ns(frame, neighbour, stamp_ns)
                    if gap_ns is not None:
                        reached.append((max(widest_gap_ns, gap_ns), neighbour, frame))
            layer = []
            for widest_gap_ns, neighbour, frame in sorted(reached):
                if neighbour not in next_towards_source:
                    next_towards_source[neighbour] = frame
                    layer.append((widest_gap_ns, neighbour))
        if target not in next_towards_source:
            return None
        chain = [target]
        while chain[-1] != source:
            chain.append(next_towards_source[chain[-1]])
        return chain

    def _gap_ns(self, a: str, b: str, stamp_ns: int) -> int | None:
        """Time between the samples of a pair around an instant, None where it is not known."""
        gaps = []
        for pair in ((a, b), (b, a)):
            if pair in self._static:
                return 0
            if pair in self._timed:
                gaps.append(self._timed[pair].gap_ns(stamp_ns))
        return min((gap for gap in gaps if gap is not None), default=None)

    def _pair_transform(self, a: str, b: str, stamp_ns: int) -> FloatArray:
        """(4, 4) T_a_b of a pair that is known at the instant, recorded in either direction."""
        if (a, b) in self._static:
            return self._static[a, b]
        if (b, a) in self._static:
            return invert_transform(self._static[b, a])
        gap_ns = self._gap_ns(a, b, stamp_ns)
        forward = self._timed.get((a, b))
        if forward is not None and forward.gap_ns(stamp_ns) == gap_ns:
            return forward.at(stamp_ns)
        return invert_transform(self._timed[b, a].at(stamp_ns))

    def _make_error(
        self, target: str, source: str, stamp_ns: int
    ) -> FramesNotConnected | StampOutsideRange:
        chain = self._find_chain(target, source, None)
        if chain is None:
            known = ", ".join(repr(frame) for frame in self.frames) or "none"
            return FramesNotConnected(
                f"no transforms connect frame {source!r} to {target!r}; known frames: {known}.",
                advice="Name the frames or the pose topic by hand.",
            )
        a, b = next((a, b) for a, b in pairwise(chain) if self._gap_ns(a, b, stamp_ns) is None)
        recorded = [self._timed[pair] for pair in ((a, b), (b, a)) if pair in self._timed]
        return StampOutsideRange(
            f"no transform from {source!r} to {target!r}: none between {b!r} and {a!r}",
            stamp_ns=stamp_ns,
            start_ns=min(samples.start_ns for samples in recorded),
            end_ns=max(samples.end_ns for samples in recorded),
        )


class _Samples:
    """Timed poses of one pair of frames, sorted by stamp, in arrays that grow up to a limit."""

    def __init__(self, limit: int | None) -> None:
        self._limit = limit
        self._size = 0
        self._dropped_until_ns = int(np.iinfo(np.int64).min)
        self._stamps_ns = np.empty(2, dtype=np.int64)
        self._poses = np.empty((2, 4, 4))

    @property
    def start_ns(self) -> int:
        return int(self._stamps_ns[0])

    @property
    def end_ns(self) -> int:
        return int(self._stamps_ns[self._size - 1])

    def insert(self, stamp_ns: int, pose: FloatArray) -> None:
        """Keep a pose; of two with one stamp the later insertion counts."""
        place = self._place(stamp_ns)
        if place < self._size and self._stamps_ns[place] == stamp_ns:
            self._poses[place] = pose
            return
        if self._size == self._stamps_ns.size:
            self._make_room()
            place = self._place(stamp_ns)
        # A sample older than the dropped ones would be interpolated across their gap.
        if stamp_ns <= self._dropped_until_ns:
            return
        self._stamps_ns[place + 1 : self._size + 1] = self._stamps_ns[place : self._size]
        self._poses[place + 1 : self._size + 1] = self._poses[place : self._size]
        self._stamps_ns[place] = stamp_ns
        self._poses[place] = pose
        self._size += 1

    def _place(self, stamp_ns: int) -> int:
        """Index of the first sample at or after an instant."""
        return int(np.searchsorted(self._stamps_ns[: self._size], stamp_ns))

    def _make_room(self) -> None:
        """Double the arrays, or at the limit drop the oldest samples."""
        capacity = self._stamps_ns.size
        if self._limit is None or capacity < self._limit:
            grown = 2 * capacity if self._limit is None else min(2 * capacity, self._limit)
            self._stamps_ns = np.resize(self._stamps_ns, grown)
            self._poses = np.resize(self._poses, (grown, 4, 4))
            return
        # A quarter at a time, so that an insertion at the end costs little on average.
        dropped = max(1, capacity // 4)
        self._dropped_until_ns = int(self._stamps_ns[dropped - 1])
        self._size -= dropped
        self._stamps_ns[: self._size] = self._stamps_ns[dropped:].copy()
        self._poses[: self._size] = self._poses[dropped:].copy()

    def _find_neighbours(self, stamp_ns: int) -> StampNeighbours | None:
        return find_neighbours(self._stamps_ns[: self._size], stamp_ns)

    def gap_ns(self, stamp_ns: int) -> int | None:
        """Time between the samples around an instant, 0 at a sample, None outside of them."""
        neighbours = self._find_neighbours(stamp_ns)
        return None if neighbours is None else neighbours.gap_ns

    def at(self, stamp_ns: int) -> FloatArray:
        """(4, 4) at an instant inside the known range."""
        neighbours = self._find_neighbours(stamp_ns)
        if neighbours is None:
            raise ValueError(f"{stamp_ns} ns is not between {self.start_ns} and {self.end_ns} ns")
        before, after, _, fraction = neighbours
        if before == after:
            exact: FloatArray = self._poses[after].copy()
            return exact
        return interpolate_transform(self._poses[before], self._poses[after], fraction)
