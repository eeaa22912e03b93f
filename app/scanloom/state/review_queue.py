"""The queue of the review: runs of all counted frames, in the chosen order, and which are done."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from scanloom.state.frame_runs import SENSORS, FrameRuns
from scanloom.state.review_choices import ReviewChoices

# Of the known answers that the queue would not ask about, one for so many runs joins it; set by
# hand.
_RUNS_PER_GOLD = 9


class LabelSource(Protocol):
    """The labels in force, as a store has them."""

    def labels_of(self, layer: str, capture: Capture) -> CaptureLabels:
        """Those of one capture."""
        ...

    def labelled(self, layer: str) -> Iterator[CaptureLabels]:
        """All captures that have any."""
        ...


class RunTable:
    """The runs of a recording's counted frames, N in all, each by its number.

    ``frame``, ``run``: (N,) which run of which frame it is; ``sensor``, ``noise_class``,
    ``confidence``: (N,) as in FrameRuns.
    """

    def __init__(self, frames: Sequence[FrameRuns | None]) -> None:
        self.frames = frames
        counted = [(index, runs) for index, runs in enumerate(frames) if runs is not None]
        sizes = [len(runs) for _, runs in counted]
        self.frame: IntArray = np.repeat([index for index, _ in counted], sizes).astype(np.int64)
        self._first = np.zeros(len(frames) + 1, dtype=np.int64)
        for (index, _), size in zip(counted, sizes, strict=True):
            self._first[index + 1] = size
        self._first = np.cumsum(self._first)
        self.run: IntArray = np.arange(self.frame.size) - self._first[self.frame]
        self.sensor = _joined([runs.sensor for _, runs in counted])
        self.noise_class = _joined([runs.noise_class for _, runs in counted])
        self.confidence: FloatArray = np.concatenate(
            [np.zeros(0), *(runs.confidence for _, runs in counted)]
        )
        self._frames_of: dict[Capture, list[int]] = {}
        for index, runs in counted:
            for capture in (runs.scan, runs.image):
                if capture is not None:
                    self._frames_of.setdefault(capture, []).append(index)

    def __len__(self) -> int:
        return self.frame.size

    def runs(self, number: int) -> tuple[FrameRuns, int]:
        """The runs of the frame, and which of them has this number."""
        runs = self.frames[self.frame[number]]
        assert runs is not None, "it was counted"
        return runs, int(self.run[number])

    def of_frame(self, frame_index: int) -> range:
        """The numbers of a frame's runs."""
        if not 0 <= frame_index < len(self.frames):
            return range(0)
        return range(int(self._first[frame_index]), int(self._first[frame_index + 1]))

    def of_capture(self, capture: Capture) -> Iterator[int]:
        """The numbers of the runs in a scan or an image; a scan may be paired with several."""
        for index in self._frames_of.get(capture, ()):
            runs = self.frames[index]
            assert runs is not None, "it was counted"
            for number in self.of_frame(index):
                if runs.capture(int(self.run[number])) == capture:
                    yield number

    def at(self, frame_index: int, beam: int, sensor: int) -> int | None:
        """The run of a frame that holds a beam, or its pixel; None where there is none."""
        for number in self.of_frame(frame_index):
            runs, run = self.runs(number)
            if runs.sensor[run] == sensor and (runs.beam[runs.samples(run)] == beam).any():
                return number
        return None

    def judged_elsewhere(self, number: int) -> Mapping[int, int]:
        """How often the beams of a run have another class in another frame, by class."""
        runs, run = self.runs(number)
        own = runs.column[runs.samples(run)]
        found: dict[int, int] = {}
        if SENSORS[runs.sensor[run]] != "lidar":
            return found
        for other in self.of_capture(runs.capture(run)):
            code = int(self.noise_class[other])
            if self.frame[other] == self.frame[number] or code == self.noise_class[number]:
                continue
            beside, beside_run = self.runs(other)
            both = int(np.isin(beside.column[beside.samples(beside_run)], own).sum())
            if both:
                found[code] = found.get(code, 0) + both
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueProgress:
    """How many of the chosen runs are labelled whole."""

    done: int
    total: int


class ReviewQueue:
    """The chosen runs of a table in order. ``done``: (N,) runs whose every sample is labelled.
    ``gold``: (N,) those of the queue that have a known answer."""

    def __init__(
        self,
        table: RunTable,
        choices: ReviewChoices,
        source: LabelSource,
        layers: Sequence[str],
        before: "ReviewQueue | None" = None,
    ) -> None:
        """``layers``: the person's own first, then those to be compared with it. ``before``: an up
        to date queue of the same layer, whose frames need not be looked up again."""
        self.table, self._choices = table, choices
        self._source, self._layer = source, layers[0]
        self.done: BoolArray = np.zeros(len(table), dtype=np.bool_)
        if before is None:
            for labels in source.labelled(self._layer):
                self._mark(labels)
        else:
            self.update(self._take_over(before))
        self.gold: BoolArray = np.zeros(len(table), dtype=np.bool_)
        self._order = self._ordered(layers)
        # The place of each chosen run in the order, -1 of the others.
        self._place = np.full(len(table), -1)
        self._place[self._order] = np.arange(self._order.size)

    def set_only_open(self, only_open: bool) -> None:
        """Whether ``next`` passes over labelled runs."""
        self._choices = self._choices.model_copy(update={"only_open": only_open})

    @property
    def progress(self) -> QueueProgress:
        """How far the person is."""
        return QueueProgress(done=int(self.done[self._order].sum()), total=self._order.size)

    @property
    def gold_progress(self) -> QueueProgress:
        """How many of the known answers the person has given."""
        return QueueProgress(done=int(self.done[self.gold].sum()), total=int(self.gold.sum()))

    @property
    def chosen(self) -> IntArray:
        """(Q,) numbers of the chosen runs in order."""
        return self._order

    def update(self, captures: Iterable[Capture]) -> None:
        """Take in what has changed in some captures."""
        for capture in captures:
            self._mark(self._source.labels_of(self._layer, capture))

    def first_from(self, frame_index: int) -> int | None:
        """The run to begin with: in time the next one from a frame on, else the first."""
        if self._choices.order != "time":
            return self.next(None)
        later = np.flatnonzero(self.table.frame[self._order] >= frame_index)
        before = int(self._order[later[0] - 1]) if later.size and later[0] else None
        return self.next(before) if later.size else self.next(None)

    def next(self, after: int | None, direction: int = 1) -> int | None:
        """The next run, an open one where so chosen, or the previous one for -1, labelled or not:
        people go back for another look. None where there is none before the end."""
        order = self._order
        if after is None:
            place = -1 if direction > 0 else order.size
        elif self._place[after] >= 0:
            place = int(self._place[after])
        else:
            # A run that is not chosen, such as one that was clicked: go on from there in time.
            later = np.flatnonzero(order > after) if self._choices.order == "time" else order[:0]
            place = int(later[0]) - (direction > 0) if later.size else order.size
        ahead = order[place + 1 :] if direction > 0 else order[: max(place, 0)][::-1]
        for number in ahead:
            if direction < 0 or not (self._choices.only_open and self.done[number]):
                return int(number)
        return None

    def next_open(self, after: int | None) -> int | None:
        """The next open run, from the beginning again where there is none behind."""
        found = self.next(after)
        if found is None and self._choices.only_open:
            found = self.next(None)
        return None if found == after else found

    def open_part(self, number: int) -> slice:
        """The first stretch of a run's samples that are not labelled; the whole run where all
        are."""
        runs, run = self.table.runs(number)
        whole = runs.samples(run)
        labels = self._source.labels_of(self._layer, runs.capture(run))
        is_open = ~_has_label(runs, whole, labels)
        if not is_open.any():
            return whole
        first = int(np.argmax(is_open))
        closed = np.flatnonzero(~is_open[first:])
        size = int(closed[0]) if closed.size else is_open.size - first
        return slice(whole.start + first, whole.start + first + size)

    def _take_over(self, before: "ReviewQueue") -> set[Capture]:
        """Take what is known of frames that are as they were; the captures of the others."""
        others: set[Capture] = set()
        for index, runs in enumerate(self.table.frames):
            if runs is None:
                continue
            if index < len(before.table.frames) and before.table.frames[index] is runs:
                self.done[self.table.of_frame(index)] = before.done[before.table.of_frame(index)]
            else:
                others |= {capture for capture in (runs.scan, runs.image) if capture is not None}
        return others

    def _mark(self, labels: CaptureLabels) -> None:
        for number in self.table.of_capture(labels.capture):
            runs, run = self.table.runs(number)
            self.done[number] = _has_label(runs, runs.samples(run), labels).all()

    def _ordered(self, layers: Sequence[str]) -> IntArray:
        table, choices = self.table, self._choices
        of_class = np.isin(table.noise_class, [int(noise) for noise in choices.classes])
        of_sensor = np.ones(len(table), dtype=np.bool_)
        if choices.sensor != "both":
            of_sensor = table.sensor == SENSORS.index(choices.sensor)
        if choices.order == "disagreement":
            # Whatever the automatic class is.
            chosen = _disputed(table, self._source, layers)
        else:
            chosen = of_class & of_sensor
        if choices.gold_layer:
            known = self._known() & of_sensor
            if not choices.blind:
                # The class that is shown would tell it from the others.
                known &= of_class
            chosen[_drawn(known & ~chosen, int(chosen.sum()))] = True
            self.gold = known & chosen
        order: IntArray = np.flatnonzero(chosen)
        if choices.order == "least confident":
            order = order[np.argsort(table.confidence[order], kind="stable")]
        return order

    def _known(self) -> BoolArray:
        """(N,) runs whose every sample the gold layer decided on."""
        known: BoolArray = np.zeros(len(self.table), dtype=np.bool_)
        for labels in self._source.labelled(self._choices.gold_layer):
            decided = labels.subset(labels.label != Label.UNSURE)
            for number in self.table.of_capture(labels.capture):
                runs, run = self.table.runs(number)
                known[number] = _has_label(runs, runs.samples(run), decided).all()
        return known


def _has_label(runs: FrameRuns, own: slice, labels: CaptureLabels) -> BoolArray:
    """Which samples of a frame's runs are labelled."""
    columns = labels.capture.columns
    mine = runs.row[own].astype(np.int64) * columns + runs.column[own]
    place = (labels.row * columns + labels.column)[labels.label != NO_LABEL]
    found: BoolArray = np.isin(mine, place)
    return found


def _disputed(table: RunTable, source: LabelSource, layers: Collection[str]) -> BoolArray:
    """(N,) runs with a sample to which two layers give different labels."""
    disputed: BoolArray = np.zeros(len(table), dtype=np.bool_)
    seen: dict[Capture, list[CaptureLabels]] = {}
    for layer in layers:
        for labels in source.labelled(layer):
            seen.setdefault(labels.capture, []).append(labels)
    for capture, several in seen.items():
        if len(several) < 2:
            continue
        images = np.stack([labels.as_image() for labels in several])
        least = np.where(images == NO_LABEL, np.iinfo(np.int64).max, images).min(axis=0)
        differs = images.max(axis=0) > least
        for number in table.of_capture(capture):
            runs, run = table.runs(number)
            own = runs.samples(run)
            disputed[number] = differs[runs.row[own], runs.column[own]].any()
    return disputed


def _drawn(candidates: BoolArray, runs: int) -> IntArray:
    """Some of the candidates, by chance, to join a queue of so many runs."""
    numbers = np.flatnonzero(candidates)
    count = min(numbers.size, -(-runs // _RUNS_PER_GOLD))
    drawn: IntArray = np.random.default_rng(0).choice(numbers, count, replace=False)
    return drawn


def _joined(parts: Sequence[IntArray]) -> IntArray:
    joined: IntArray = np.concatenate([np.zeros(0, dtype=np.int64), *parts]).astype(np.int64)
    return joined
