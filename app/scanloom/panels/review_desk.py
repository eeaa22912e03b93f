"""What a person does in the review: which run is asked about, what is marked, and the answers."""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from fusion_core.model.progress import Progress
from fusion_core.workflows.fuse.captures import FrameCaptures
from fusion_core.workflows.labels.open_store import Author
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.events import ToolName
from scanloom.plots.drawn_mask import drawn_mask
from scanloom.scene.propagation import labels_around
from scanloom.scene.review_frame import captures_of, review_overlay
from scanloom.state.frame_runs import SENSORS
from scanloom.state.frame_survey import FrameSurvey
from scanloom.state.recording_labels import RecordingLabels
from scanloom.state.review_choices import Answer, ReviewChoices
from scanloom.state.review_overlay import ReviewOverlay
from scanloom.state.review_queue import QueueProgress, ReviewQueue, RunTable
from scanloom.state.selection import Selection

# The rate is that of the last answers within this time; whoever pauses longer has begun anew.
_RATE_OVER_S = 300.0
_RATE_ANSWERS = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class ReviewState:
    """What the panel shows. ``number``: the run of ``table`` that is asked about, None for none,
    and ``part`` its samples. ``selected``: marked beams and pixels. ``a_minute``: answers, None
    before there are enough."""

    table: RunTable | None
    number: int | None
    part: slice
    selected: tuple[int, int]
    progress: QueueProgress
    a_minute: float | None
    counted: tuple[int, int]
    """Frames whose runs are known, of how many."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownAnswers:
    """What a person's ``layer`` of ``labels`` is to be scored against: ``known``, another layer.
    ``runs``: with a known answer, how many of them are labelled."""

    labels: RecordingLabels
    layer: str
    known: str
    runs: QueueProgress


class ReviewDesk:
    """The review of one browser. Thread-safe.

    It begins with a name: a person's labels are a layer of that name, unless they name another.
    Undo takes back the person's actions in that layer, by whatever window they were made.
    """

    def __init__(self, session: ClientSession) -> None:
        self._session = session
        self._lock = threading.RLock()
        self._labels: RecordingLabels | None = None
        self._annotator = self._layer = ""
        self._survey: FrameSurvey | None = None
        self._counted = -1
        self._queue: ReviewQueue | None = None
        self._queue_of: tuple[object, ...] = ()
        self._number: int | None = None
        self._part = slice(0)
        # The frame and the beam that were shown for it.
        self._shown_for: tuple[int, int | None] = -1, None
        self._selection = Selection()
        self._answered_s: deque[float] = deque(maxlen=_RATE_ANSWERS)
        self._on_change: Callable[[], None] = lambda: None

    # Beginning and following

    @property
    def layer(self) -> str:
        """The layer that answers go into; empty before the beginning."""
        return self._layer

    @property
    def gold_layer(self) -> str:
        """The layer whose labels are known answers; empty for none."""
        with self._lock:
            return self._gold_layer(self._session.view.review)

    @property
    def other_layers(self) -> tuple[str, ...]:
        """All layers but the person's own."""
        with self._lock:
            layers = () if self._labels is None else self._labels.layers
            return tuple(name for name in layers if name != self._layer)

    @property
    def told_layers(self) -> tuple[str, ...]:
        """The other layers that the person may know of: all but that of known answers."""
        gold = self.gold_layer
        return tuple(name for name in self.other_layers if name != gold)

    @property
    def labels(self) -> RecordingLabels | None:
        """The recording's labels, None before the beginning."""
        return self._labels

    @property
    def is_on(self) -> bool:
        """Whether answers are taken: the step is open, and the person has begun."""
        return self._labels is not None and self._session.view.panel == "Review"

    def begin(
        self, labels: RecordingLabels, annotator: str, layer: str, progress: Progress
    ) -> None:
        """Open the labels and take this person's answers into a layer. Raises ScanLoomError for
        labels that cannot be opened."""
        labels.open(progress)
        with self._lock:
            self._labels, self._annotator, self._layer = labels, annotator, layer
            self._queue, self._queue_of = None, ()
            labels.listen(self._hear)

    def end(self) -> None:
        """Take no more answers, as the recording is another."""
        with self._lock:
            if self._labels is not None:
                self._labels.remove_listener(self._hear)
            self._labels, self._queue, self._number = None, None, None
            self._selection.clear()

    def follow(self, frame_view: FrameView, survey: FrameSurvey | None) -> None:
        """Take in what is displayed, and the frames that were counted since."""
        with self._lock:
            if self._labels is None or survey is None:
                return
            self._labels.take_in_others()
            self._update_queue(frame_view.view.review, survey)
            # What is asked for, which what is displayed lags behind: else each of several quick
            # answers would be taken for a click on the run before.
            view = self._session.view
            shown = view.frame_index, view.selected_beam
            if self._queue is not None and shown != self._shown_for:
                self._shown_for = shown
                self._take_clicked(view.frame_index, view.selected_beam)

    def end_with_known_answers(self) -> KnownAnswers | None:
        """End the review, for its score; None, and it goes on, where there are no known answers."""
        with self._lock:
            known = self.gold_layer
            if self._labels is None or self._queue is None or not known:
                return None
            answers = KnownAnswers(
                labels=self._labels, layer=self._layer, known=known, runs=self._queue.gold_progress
            )
            self.end()
        return answers

    def state(self) -> ReviewState:
        """What is to be shown."""
        with self._lock:
            queue = self._queue
            frames = () if queue is None else queue.table.frames
            return ReviewState(
                table=None if queue is None else queue.table,
                number=self._number,
                part=self._part,
                selected=self._selection.counts(),
                progress=QueueProgress(done=0, total=0) if queue is None else queue.progress,
                a_minute=self._a_minute(),
                counted=(sum(runs is not None for runs in frames), len(frames)),
            )

    def overlay(self, frame_view: FrameView) -> ReviewOverlay | None:
        """The labels of the displayed frame and what is marked in it; None while there is no
        review."""
        with self._lock:
            labels, layer = self._labels, self._layer
            if labels is None or frame_view.view.panel != "Review":
                return None
            marked = self._selection.labels(Label.GOOD)
            if not marked and self._queue is not None and self._number is not None:
                runs, run = self._queue.table.runs(self._number)
                marked = [runs.labels(run, Label.GOOD, self._part)]
            return review_overlay(frame_view, partial(labels.labels_of, layer), marked)

    # Moving

    def go(self, direction: int) -> None:
        """Go to the next run of the queue, or to the previous one for -1."""
        with self._lock:
            if self._queue is None:
                return
            if self._number is None:
                found = self._queue.first_from(self._session.view.frame_index)
            else:
                found = self._queue.next(self._number, direction)
            if found is None:
                end = "after" if direction > 0 else "before"
                self._session.notify("Review", f"There is no run {end} this one in the queue.")
            else:
                self._ask(found)

    def split(self) -> None:
        """Ask about the first part of the run alone: up to the selected beam, or its half."""
        with self._lock:
            if self._queue is None or self._number is None:
                return
            runs, _ = self._queue.table.runs(self._number)
            size = self._part.stop - self._part.start
            if size < 2:
                self._session.notify("Review", "One sample cannot be split.")
                return
            at = np.flatnonzero(runs.beam[self._part] == self._session.view.selected_beam)
            # A run is asked about with its middle selected, which splits it into halves.
            cut = int(at[0]) if at.size and 0 < at[0] < size else size // 2
            self._part = slice(self._part.start, self._part.start + cut)
        self._session.refresh()

    # Marking

    def draw(
        self, tool: ToolName, places: Sequence[tuple[float, float]], *, is_added: bool
    ) -> None:
        """Mark pixels of the upright depth image, drawn at (column, row). A box begins anew unless
        ``is_added``; the strokes of a brush add to each other."""
        captures = self._displayed()
        with self._lock:
            if captures is None or self._labels is None:
                return
            if not is_added and tool == "box":
                self._selection.clear()
            shape = captures.view.intrinsics.height, captures.view.intrinsics.width
            drawn = drawn_mask(shape, tool, places, self._session.view.review.brush_px)
            self._selection.add(captures.image, *captures.view.stored_pixels(*np.nonzero(drawn)))
        self._session.refresh()

    def mark_beams(self, beams: Sequence[int], *, is_added: bool) -> None:
        """Mark beams of the displayed scan."""
        captures = self._displayed()
        with self._lock:
            if captures is None or captures.scan is None or self._labels is None:
                return
            if not is_added:
                self._selection.clear()
            column = np.array(beams, dtype=np.int64)
            self._selection.add(captures.scan, np.zeros_like(column), column)
        self._session.refresh()

    def clear_selection(self) -> None:
        """Mark nothing: the next answer is about the run."""
        with self._lock:
            self._selection.clear()
        self._session.refresh()

    # Answers

    def answer(self, answer: Answer, comment: str = "") -> None:
        """Say what the marked samples, or those of the run, are, and go on to the next run."""
        with self._lock:
            if self._labels is None or not self.is_on:
                return
            is_marked = bool(self._selection)
            labels = self._marked(answer) if is_marked else self._asked(answer)
            if labels is None:
                return
            before = self._number
            if not self._write(labels, comment):
                return
            if is_marked:
                self._selection.clear()
            elif self._session.view.review.auto_advance:
                self._go_on(before)
        self._session.refresh()

    def answer_all(self, answer: Answer) -> None:
        """Say one thing of all open runs of the queue, as one action."""
        with self._lock:
            if self._labels is None or self._queue is None:
                return
            labels: dict[Capture, list[CaptureLabels]] = {}
            for number in self.open_numbers():
                found = self._of_run(number, answer, None)
                if found is not None:
                    labels.setdefault(found.capture, []).append(found)
            self._write([_united(parts) for parts in labels.values()], "all that the queue showed")
        self._session.refresh()

    def answer_around(self, answer: Answer, beside: int) -> None:
        """Say one thing of the run and of the same place in ``beside`` frames before and after, as
        one action: of what is of its sensor and class there. The poses say where that is, where the
        recording has any; else the LiDAR is taken to stand still."""
        frame_view = self._session.frame_view
        with self._lock:
            own = self._asked(answer)
            if own is None or frame_view is None or self._labels is None or self._queue is None:
                return
            number = self._number
            assert number is not None, "a run was asked about"
            label = int(own[0].label[0])
            around = labels_around(frame_view, self._queue.table, number, self._part, label, beside)
            by_capture: dict[Capture, list[CaptureLabels]] = {}
            # The run's own last: of samples that are labelled twice, the last label counts.
            for labels in (*around, *own):
                by_capture.setdefault(labels.capture, []).append(labels)
            whole = [_united(parts) for parts in by_capture.values()]
            comment = f"the same place in up to {beside} frames before and after"
            if self._write(whole, comment) and self._session.view.review.auto_advance:
                self._go_on(number)
        self._session.refresh()

    def majority(self, least_decisions: int) -> int:
        """How many samples ``adjudicate`` would label now."""
        if self._labels is None:
            return 0
        added = self._labels.majority(self.told_layers, self._layer, least_decisions)
        return sum(labels.label.size for labels in added)

    def adjudicate(self, least_decisions: int) -> int:
        """Label what has no label in the layer as most of the others say, where so many of them
        decided, in one action; how many samples. Raises ScanLoomError where it cannot be written.
        """
        if self._labels is None:
            return 0
        author = replace(
            self._author(f"what most say of {', '.join(self.told_layers)}"), source="automatic"
        )
        return self._labels.adjudicate(self.told_layers, self._layer, author, least_decisions)

    def open_numbers(self) -> list[int]:
        """The runs of the queue that are not labelled."""
        with self._lock:
            queue = self._queue
            return [] if queue is None else [int(n) for n in queue.chosen if not queue.done[n]]

    def label_of_run(self, number: int) -> str:
        """The person's labels of a run, in words; empty without any."""
        return self._words(self._layer, number)

    def labels_of_others(self, number: int) -> dict[str, str]:
        """What other layers say of a run, by layer, but for known answers."""
        words = {name: self._words(name, number) for name in self.told_layers}
        return {name: said for name, said in words.items() if said}

    def undo(self) -> None:
        """Take back the person's last action."""
        self._step_back("undo")

    def redo(self) -> None:
        """Do again what was taken back."""
        self._step_back("redo")

    def close(self) -> None:
        """Hear of no more labels."""
        self.end()

    # Inside, with the lock held

    def _gold_layer(self, choices: ReviewChoices) -> str:
        return choices.gold_layer if choices.gold_layer in self.other_layers else ""

    def _words(self, layer: str, number: int) -> str:
        with self._lock:
            if self._labels is None or self._queue is None:
                return ""
            runs, run = self._queue.table.runs(number)
            image = self._labels.labels_of(layer, runs.capture(run)).as_image()
            own = runs.samples(run)
            codes, counts = np.unique(image[runs.row[own], runs.column[own]], return_counts=True)
        said = {Label(c).name.lower(): int(n) for c, n in zip(codes, counts, strict=True) if c >= 0}
        if len(codes) == 1:
            return "".join(said)
        return ", ".join(f"{name} {count}" for name, count in said.items())

    def _write(self, labels: Sequence[CaptureLabels], comment: str) -> bool:
        """Write one action; whether it could be."""
        assert self._labels is not None, "the review has begun"
        try:
            self._labels.label(self._layer, labels, self._author(comment))
        except ScanLoomError as error:
            self._session.show_failure(error, until_dismissed=True)
            return False
        self._answered_s.append(time.monotonic())
        return True

    def _displayed(self) -> FrameCaptures | None:
        frame_view = self._session.frame_view
        return None if frame_view is None else captures_of(frame_view)

    def _step_back(self, step: Literal["undo", "redo"]) -> None:
        with self._lock:
            if self._labels is None:
                return
            act = self._labels.undo if step == "undo" else self._labels.redo
            try:
                is_done = act(self._layer, self._annotator)
            except ScanLoomError as error:
                self._session.show_failure(error, until_dismissed=True)
                return
        if not is_done:
            self._session.notify("Labels", f"There is nothing to {step}.")

    def _hear(self, layer: str, captures: Sequence[Capture]) -> None:
        with self._lock:
            if layer == self._layer and self._queue is not None:
                self._queue.update(captures)
                if self._number is not None:
                    self._part = self._queue.open_part(self._number)
        self._session.refresh()

    def _update_queue(self, choices: ReviewChoices, survey: FrameSurvey) -> None:
        assert self._labels is not None, "the review has begun"
        # How it is worked through makes no other queue.
        fixed = {"tool": "point", "brush_px": 1, "auto_advance": True, "only_open": True}
        queue_of = survey, survey.done, choices.model_copy(update=fixed), self._labels.layers
        if self._queue is not None and queue_of == self._queue_of:
            self._queue.set_only_open(choices.only_open)
            return
        self._queue_of = queue_of
        before, number = self._queue, self._number
        gold = self._gold_layer(choices)
        table = RunTable(survey.runs)
        layers = [self._layer, *self.told_layers]
        chosen = choices.model_copy(update={"gold_layer": gold})
        self._queue = ReviewQueue(table, chosen, self._labels, layers, before)
        self._number = None
        if before is not None and number is not None:
            # The same place, though its run may be another with other settings.
            runs, run = before.table.runs(number)
            own = runs.beam[runs.samples(run)]
            frame = int(before.table.frame[number])
            self._number = table.at(frame, int(own[own.size // 2]), int(runs.sensor[run]))
            if self._number is not None:
                self._part = self._queue.open_part(self._number)

    def _take_clicked(self, frame_index: int, beam: int | None) -> None:
        """Ask about the run of the beam that was clicked, on the side that is not good."""
        assert self._queue is not None, "there is a queue"
        if beam is None:
            return
        sides = [self._queue.table.at(frame_index, beam, sensor) for sensor in range(len(SENSORS))]
        found = [number for number in sides if number is not None]
        wanted = self._session.view.review.sensor
        if wanted != "both":
            found = [n for n in found if self._queue.table.sensor[n] == SENSORS.index(wanted)]
        if found:
            noise = [n for n in found if self._queue.table.noise_class[n] != NoiseClass.GOOD]
            self._number = (noise or found)[0]
            self._part = self._queue.open_part(self._number)

    def _ask(self, number: int) -> None:
        assert self._queue is not None, "there is a queue"
        self._number = number
        self._part = self._queue.open_part(number)
        runs, _ = self._queue.table.runs(number)
        own = runs.beam[self._part]
        frame, beam = int(self._queue.table.frame[number]), int(own[own.size // 2])
        self._shown_for = frame, beam
        self._session.pass_to_frame(frame, selected_beam=beam)

    def _go_on(self, before: int | None) -> None:
        """To the rest of the run that was answered in part, else to the next open one."""
        queue = self._queue
        if queue is None or before is None:
            return
        if not queue.done[before]:
            self._ask(before)
            return
        found = queue.next_open(before)
        if found is not None:
            self._ask(found)

    def _asked(self, answer: Answer) -> list[CaptureLabels] | None:
        if self._queue is None or self._number is None:
            self._session.notify("Review", "No run is chosen: J goes to the first one.")
            return None
        found = self._of_run(self._number, answer, self._part)
        if found is None:
            self._session.notify(
                "Not good", "Say what it is instead: 2 hole, 3 burr, 4 conflict, or U unsure."
            )
            return None
        return [found]

    def _of_run(self, number: int, answer: Answer, part: slice | None) -> CaptureLabels | None:
        assert self._queue is not None, "there is a queue"
        runs, run = self._queue.table.runs(number)
        label = _label_of(answer, int(runs.noise_class[run]))
        return None if label is None else runs.labels(run, label, part)

    def _marked(self, answer: Answer) -> list[CaptureLabels] | None:
        if answer == "accept" or answer == "reject":
            self._session.notify(
                "Marked samples", "Say what they are: 1 good, 2 hole, 3 burr, 4 conflict, U unsure."
            )
            return None
        return self._selection.labels(NO_LABEL if answer == "clear" else answer)

    def _author(self, comment: str) -> Author:
        return Author(
            annotator=self._annotator,
            settings_sha256=self._session.view.settings_sha256,
            comment=comment,
        )

    def _a_minute(self) -> float | None:
        now_s = time.monotonic()
        recent = [at_s for at_s in self._answered_s if now_s - at_s < _RATE_OVER_S]
        if len(recent) < 3 or recent[-1] <= recent[0]:
            return None
        return 60.0 * (len(recent) - 1) / (recent[-1] - recent[0])


def _label_of(answer: Answer, automatic: int) -> int | None:
    """The label that an answer gives to samples of an automatic class; None where it gives none:
    what is not good may be anything else."""
    match answer:
        case "accept":
            return automatic
        case "reject":
            return None if automatic == NoiseClass.GOOD else int(Label.GOOD)
        case "clear":
            return NO_LABEL
    return int(answer)


def _united(parts: Sequence[CaptureLabels]) -> CaptureLabels:
    return CaptureLabels.of_samples(
        parts[0].capture,
        np.concatenate([part.row for part in parts]),
        np.concatenate([part.column for part in parts]),
        np.concatenate([part.label for part in parts]),
    )
