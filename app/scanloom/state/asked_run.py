"""The queue of a review, and which of its runs the person is asked about."""

from collections.abc import Iterable

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.labels import Capture, CaptureLabels, Label
from scanloom.state.annotated_layer import AnnotatedLayer
from scanloom.state.frame_runs import SENSORS
from scanloom.state.frame_survey import FrameSurvey
from scanloom.state.review_choices import ReviewChoices
from scanloom.state.review_queue import ReviewQueue, RunTable


class AskedRun:
    """``queue``: None before the first frames are counted. ``number``: the run of its table that is
    asked about, None for none, and ``part`` its samples. Not thread-safe."""

    def __init__(self) -> None:
        self.queue: ReviewQueue | None = None
        self.number: int | None = None
        self.part = slice(0)
        # What the queue was made of.
        self._made_of: tuple[object, ...] = ()
        # The frame and the beam that were shown for the run.
        self._shown_for: tuple[int, int | None] = -1, None

    def forget(self) -> None:
        """Ask about nothing, of no queue."""
        self.queue, self._made_of, self.number = None, (), None

    def follow(self, survey: FrameSurvey, choices: ReviewChoices, layer: AnnotatedLayer) -> None:
        """Make the queue anew where frames were counted since, or where it is to be another."""
        # How it is worked through makes no other queue.
        fixed = {"tool": "point", "brush_px": 1, "auto_advance": True, "only_open": True}
        made_of = survey, survey.done, choices.model_copy(update=fixed), layer.labels.layers
        if self.queue is not None and made_of == self._made_of:
            self.queue.set_only_open(choices.only_open)
            return
        self._made_of = made_of
        before, number = self.queue, self.number
        table = RunTable(survey.runs)
        layers = [layer.name, *layer.told(choices)]
        known = choices.model_copy(update={"gold_layer": layer.gold(choices)})
        self.queue = ReviewQueue(table, known, layer.labels, layers, before)
        self.number = None
        if before is not None and number is not None:
            # The same place, though its run may be another with other settings.
            runs, run = before.table.runs(number)
            own = runs.beam[runs.samples(run)]
            frame = int(before.table.frame[number])
            self.number = table.at(frame, int(own[own.size // 2]), int(runs.sensor[run]))
            self._open_part()

    def update(self, captures: Iterable[Capture]) -> None:
        """Take in what has been labelled in some captures."""
        if self.queue is not None:
            self.queue.update(captures)
            self._open_part()

    def take_clicked(self, frame_index: int, beam: int | None, sensor: str) -> None:
        """Ask about the run of the beam that was clicked, on the side that is not good; of
        ``sensor``, unless that is "both"."""
        shown = frame_index, beam
        if self.queue is None or shown == self._shown_for:
            return
        self._shown_for = shown
        if beam is None:
            return
        table = self.queue.table
        sides = [table.at(frame_index, beam, side) for side in range(len(SENSORS))]
        found = [number for number in sides if number is not None]
        if sensor != "both":
            found = [number for number in found if table.sensor[number] == SENSORS.index(sensor)]
        if found:
            noise = [number for number in found if table.noise_class[number] != NoiseClass.GOOD]
            self.number = (noise or found)[0]
            self._open_part()

    def neighbour(self, direction: int, frame_index: int) -> int | None:
        """The next run, or the previous one for -1; the first from a frame on while none is asked
        about. None where there is none."""
        if self.queue is None:
            return None
        if self.number is None:
            return self.queue.first_from(frame_index)
        return self.queue.next(self.number, direction)

    def after_answer(self, number: int) -> int | None:
        """The run to go on to from one that was answered: the same where it is open in part, else
        the next open one."""
        if self.queue is None:
            return None
        return self.queue.next_open(number) if self.queue.done[number] else number

    def ask(self, number: int) -> tuple[int, int]:
        """Ask about a run of the queue; the frame and the beam to be shown."""
        assert self.queue is not None, "there is a queue"
        self.number = number
        self._open_part()
        runs, _ = self.queue.table.runs(number)
        own = runs.beam[self.part]
        frame, beam = int(self.queue.table.frame[number]), int(own[own.size // 2])
        self._shown_for = frame, beam
        return frame, beam

    def split(self, beam: int | None) -> bool:
        """Ask about the first part alone: up to a beam, or its half. Whether it has two."""
        size = self.part.stop - self.part.start
        if self.queue is None or self.number is None or size < 2:
            return False
        runs, _ = self.queue.table.runs(self.number)
        at = np.flatnonzero(runs.beam[self.part] == beam)
        # A run is asked about with its middle selected, which splits it into halves.
        cut = int(at[0]) if at.size and 0 < at[0] < size else size // 2
        self.part = slice(self.part.start, self.part.start + cut)
        return True

    def marked(self) -> list[CaptureLabels]:
        """The samples that are asked about, as labels of any kind."""
        if self.queue is None or self.number is None:
            return []
        runs, run = self.queue.table.runs(self.number)
        return [runs.labels(run, Label.GOOD, self.part)]

    def _open_part(self) -> None:
        if self.queue is not None and self.number is not None:
            self.part = self.queue.open_part(self.number)
