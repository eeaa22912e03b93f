"""What a person does in the review: which run is asked about, what is marked, and the answers."""

import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from fusion_core.model.progress import Progress
from fusion_core.workflows.fuse.captures import FrameCaptures
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.events import ToolName
from scanloom.plots.drawn_mask import drawn_mask
from scanloom.scene.propagation import labels_around
from scanloom.scene.review_frame import captures_of, review_overlay
from scanloom.state.annotated_layer import AnnotatedLayer
from scanloom.state.answer_rate import AnswerRate
from scanloom.state.answered_labels import label_of_answer
from scanloom.state.asked_run import AskedRun
from scanloom.state.frame_survey import FrameSurvey
from scanloom.state.recording_labels import RecordingLabels
from scanloom.state.review_choices import Answer
from scanloom.state.review_overlay import ReviewOverlay
from scanloom.state.review_queue import QueueProgress, RunTable
from scanloom.state.selection import Selection


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
        self._own: AnnotatedLayer | None = None
        self._asked = AskedRun()
        self._selection = Selection()
        self._comment = ""
        self._rate = AnswerRate()
        # Where labels of which layer have changed, not taken in yet.
        self._heard: deque[tuple[str, Sequence[Capture]]] = deque()

    # Beginning and following

    @property
    def own(self) -> AnnotatedLayer | None:
        """The layer that answers go into, None while there is no review."""
        return self._own

    @property
    def layer(self) -> str:
        """The name of that layer; empty while there is no review."""
        return "" if self._own is None else self._own.name

    @property
    def labels(self) -> RecordingLabels | None:
        """The recording's labels, None while there is no review."""
        return None if self._own is None else self._own.labels

    @property
    def gold_layer(self) -> str:
        """The layer whose labels are known answers; empty for none."""
        own = self._own
        return "" if own is None else own.gold(self._session.view.review)

    @property
    def comment(self) -> str:
        """What the journal is to keep with the next answer; it is about that answer alone."""
        return self._comment

    @comment.setter
    def comment(self, text: str) -> None:
        self._comment = text

    @property
    def is_on(self) -> bool:
        """Whether answers are taken: the step is open, and the person has begun."""
        return self._own is not None and self._session.view.panel == "Review"

    def begin(
        self, labels: RecordingLabels, annotator: str, layer: str, progress: Progress
    ) -> None:
        """Open the labels and take this person's answers into a layer. Raises ScanLoomError for
        labels that cannot be opened."""
        labels.open(progress)
        with self._lock:
            self._own = AnnotatedLayer(labels=labels, annotator=annotator, name=layer)
            self._asked.forget()
            labels.listen(self._hear)

    def end(self) -> None:
        """Take no more answers."""
        with self._lock:
            if self._own is not None:
                self._own.labels.remove_listener(self._hear)
            self._own, self._comment = None, ""
            self._asked.forget()
            self._selection.clear()

    def end_with_known_answers(self) -> KnownAnswers | None:
        """End the review, for its score; None, and it goes on, where there are no known answers."""
        with self._lock:
            own, queue, known = self._own, self._asked.queue, self.gold_layer
            if own is None or queue is None or not known:
                return None
            self.end()
            return KnownAnswers(
                labels=own.labels, layer=own.name, known=known, runs=queue.gold_progress
            )

    def follow(self, frame_view: FrameView, survey: FrameSurvey | None) -> None:
        """Take in what is displayed, and the frames that were counted since."""
        with self._lock:
            if self._own is None or survey is None:
                return
            self._own.labels.take_in_others()
            self._take_in_heard()
            choices = frame_view.view.review
            self._asked.follow(survey, choices, self._own)
            # What is asked for, which what is displayed lags behind: else each of several quick
            # answers would be taken for a click on the run before.
            view = self._session.view
            self._asked.take_clicked(view.frame_index, view.selected_beam, view.review.sensor)

    def state(self) -> ReviewState:
        """What is to be shown."""
        with self._lock:
            queue = self._asked.queue
            frames = () if queue is None else queue.table.frames
            return ReviewState(
                table=None if queue is None else queue.table,
                number=self._asked.number,
                part=self._asked.part,
                selected=self._selection.counts(),
                progress=QueueProgress(done=0, total=0) if queue is None else queue.progress,
                a_minute=self._rate.a_minute(),
                counted=(sum(runs is not None for runs in frames), len(frames)),
            )

    def overlay(self, frame_view: FrameView) -> ReviewOverlay | None:
        """The labels of the displayed frame and what is marked in it; None while there is no
        review."""
        with self._lock:
            own = self._own
            if own is None or frame_view.view.panel != "Review":
                return None
            marked = self._selection.labels(Label.GOOD) or self._asked.marked()
            return review_overlay(frame_view, partial(own.labels.labels_of, own.name), marked)

    # Moving

    def go(self, direction: int) -> None:
        """Go to the next run of the queue, or to the previous one for -1."""
        with self._lock:
            self._take_in_heard()
            if self._asked.queue is None:
                return
            found = self._asked.neighbour(direction, self._session.view.frame_index)
            if found is None:
                end = "after" if direction > 0 else "before"
                self._session.notify("Review", f"There is no run {end} this one in the queue.")
            else:
                self._ask(found)

    def split(self) -> None:
        """Ask about the first part of the run alone: up to the selected beam, or its half."""
        with self._lock:
            if self._asked.number is None:
                return
            if not self._asked.split(self._session.view.selected_beam):
                self._session.notify("Review", "One sample cannot be split.")
                return
        self._session.refresh()

    # Marking

    def draw(
        self, tool: ToolName, places: Sequence[tuple[float, float]], *, is_added: bool
    ) -> None:
        """Mark pixels of the upright depth image, drawn at (column, row). A box begins anew unless
        ``is_added``; the strokes of a brush add to each other."""
        captures = self._displayed()
        with self._lock:
            if captures is None or self._own is None:
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
            if captures is None or captures.scan is None or self._own is None:
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

    def answer(self, answer: Answer) -> None:
        """Say what the marked samples, or those of the run, are, and go on to the next run."""
        with self._lock:
            if not self.is_on:
                return
            self._take_in_heard()
            is_marked = bool(self._selection)
            labels = self._labels_of_marked(answer) if is_marked else self._labels_of_asked(answer)
            before = self._asked.number
            if labels is None or not self._write(labels):
                return
            if is_marked:
                self._selection.clear()
            else:
                self._go_on(before)
        self._session.refresh()

    def answer_all(self, answer: Answer) -> None:
        """Say one thing of all open runs of the queue, as one action."""
        with self._lock:
            if self._own is None or self._asked.queue is None:
                return
            found = [self._labels_of_run(number, answer, None) for number in self.open_numbers()]
            labels = [one for one in found if one is not None]
            self._write(labels, "all that the queue showed")
        self._session.refresh()

    def answer_around(self, answer: Answer, beside: int) -> None:
        """Say one thing of the run and of the same place in ``beside`` frames before and after, as
        one action: of what is of its sensor and class there. The poses say where that is, where the
        recording has any; else the LiDAR is taken to stand still."""
        frame_view = self._session.frame_view
        with self._lock:
            own = self._labels_of_asked(answer)
            queue, number, part = self._asked.queue, self._asked.number, self._asked.part
            if own is None or frame_view is None or self._own is None or queue is None:
                return
            assert number is not None, "a run was asked about"
            label = int(own[0].label[0])
            around = labels_around(frame_view, queue.table, number, part, label, beside)
            # The run's own last, which counts.
            scope = f"the same place in up to {beside} frames before and after"
            if self._write([*around, *own], scope):
                self._go_on(number)
        self._session.refresh()

    def open_numbers(self) -> list[int]:
        """The runs of the queue that are not labelled."""
        with self._lock:
            queue = self._asked.queue
            return [] if queue is None else [int(n) for n in queue.chosen if not queue.done[n]]

    def label_of_run(self, number: int) -> str:
        """The person's labels of a run, in words; empty without any."""
        with self._lock:
            if self._own is None or self._asked.queue is None:
                return ""
            return self._own.words(self._own.name, *self._asked.queue.table.runs(number))

    def labels_of_others(self, number: int) -> dict[str, str]:
        """What other layers say of a run, by layer, but for known answers."""
        with self._lock:
            own, queue = self._own, self._asked.queue
            if own is None or queue is None:
                return {}
            told = own.told(self._session.view.review)
            words = {name: own.words(name, *queue.table.runs(number)) for name in told}
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

    def _hear(self, layer: str, captures: Sequence[Capture]) -> None:
        # Without the lock: whoever tells of it holds that of their own desk.
        self._heard.append((layer, captures))
        self._session.refresh()

    # Inside, with the lock held

    def _write(self, labels: Sequence[CaptureLabels], scope: str = "") -> bool:
        """Write one action; whether it could be. ``scope``: what the comment says beside the
        person's own."""
        assert self._own is not None, "the review has begun"
        comment = ": ".join(text for text in (scope, self._comment.strip()) if text)
        try:
            self._own.write(labels, self._session.view.settings_sha256, comment)
        except ScanLoomError as error:
            self._session.show_failure(error, until_dismissed=True)
            return False
        self._take_in_heard()
        self._comment = ""
        self._rate.count()
        return True

    def _displayed(self) -> FrameCaptures | None:
        frame_view = self._session.frame_view
        return None if frame_view is None else captures_of(frame_view)

    def _step_back(self, step: Literal["undo", "redo"]) -> None:
        with self._lock:
            if self._own is None:
                return
            try:
                is_done = self._own.undo() if step == "undo" else self._own.redo()
            except ScanLoomError as error:
                self._session.show_failure(error, until_dismissed=True)
                return
        if not is_done:
            self._session.notify("Labels", f"There is nothing to {step}.")

    def _take_in_heard(self) -> None:
        while self._heard:
            layer, captures = self._heard.popleft()
            if self._own is not None and layer == self._own.name:
                self._asked.update(captures)

    def _ask(self, number: int) -> None:
        frame, beam = self._asked.ask(number)
        self._session.pass_to_frame(frame, selected_beam=beam)

    def _go_on(self, before: int | None) -> None:
        """To the rest of the run that was answered in part, else to the next open one, where the
        person wants to."""
        if before is None or not self._session.view.review.auto_advance:
            return
        found = self._asked.after_answer(before)
        if found is not None:
            self._ask(found)

    def _labels_of_asked(self, answer: Answer) -> list[CaptureLabels] | None:
        if self._asked.number is None:
            self._session.notify("Review", "No run is chosen: J goes to the first one.")
            return None
        found = self._labels_of_run(self._asked.number, answer, self._asked.part)
        if found is None:
            self._session.notify(
                "Not good", "Say what it is instead: 2 hole, 3 burr, 4 conflict, or U unsure."
            )
            return None
        return [found]

    def _labels_of_run(
        self, number: int, answer: Answer, part: slice | None
    ) -> CaptureLabels | None:
        assert self._asked.queue is not None, "there is a queue"
        runs, run = self._asked.queue.table.runs(number)
        label = label_of_answer(answer, int(runs.noise_class[run]))
        return None if label is None else runs.labels(run, label, part)

    def _labels_of_marked(self, answer: Answer) -> list[CaptureLabels] | None:
        if answer == "accept" or answer == "reject":
            self._session.notify(
                "Marked samples", "Say what they are: 1 good, 2 hole, 3 burr, 4 conflict, U unsure."
            )
            return None
        return self._selection.labels(NO_LABEL if answer == "clear" else answer)
