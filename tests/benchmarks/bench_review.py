"""Time on task: samples that a person labels rightly in a minute, singly, by run, along frames.

    python -m tests.benchmarks.bench_review RECORDING --truth TRUTH.npz

Nobody sits here: a person is played who knows the truth, by the keystroke-level model (Card, Moran
and Newell 1980), in which each act takes a fixed time. What the program itself takes is measured
beside it. The person answers the queue's runs of noise in time order until so many are labelled,
and every answer is the truth's: a run that the truth parts is split first, and a propagation that
labels a sample wrongly is taken back, after it was looked at, and answered run by run.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from fusion_core.evaluation.truth import load_truth
from fusion_core.model.conventions import IntArray
from fusion_core.model.labels import Capture, CaptureLabels
from fusion_core.workflows.labels.open_store import Author, LabelStore, open_labels
from scanloom.frame_view import compute_frame_view
from scanloom.scene.propagation import labels_around
from scanloom.state.frame_survey import FrameSurvey, SurveyInputs
from scanloom.state.library import Library
from scanloom.state.open_recording import OpenRecording
from scanloom.state.review_choices import ReviewChoices
from scanloom.state.review_queue import ReviewQueue, RunTable
from scanloom.state.view import View
from tests.benchmarks.truth_layer import TruthLayer

# Seconds, Card, Moran and Newell 1980: a key of an average typist; pointing; making up one's mind.
KEY_S, POINT_S, MIND_S = 0.28, 1.10, 1.35
# A look at a frame in which something was labelled along; set by hand.
GLANCE_S = 0.40
BESIDE = 5
PERSON = "played"


class Played:
    """A person at one review, whose time is counted."""

    def __init__(self, opened: OpenRecording, table: RunTable, truth: TruthLayer) -> None:
        self._folder = tempfile.TemporaryDirectory()
        address = Path(self._folder.name) / "labels.sqlite"
        self.store: LabelStore = open_labels(opened.recording.path, address, create=True)
        self.queue = ReviewQueue(table, ReviewChoices(), self.store, [PERSON])
        self.opened, self.table, self.truth = opened, table, truth
        self.time_s, self.acts_s = 0.0, list[float]()
        self.runs = self.samples = self.taken_back = 0
        self._truths: dict[Capture, IntArray] = {}

    def codes(self, capture: Capture, row: IntArray, column: IntArray) -> IntArray:
        """What the truth says of samples."""
        if capture not in self._truths:
            self._truths[capture] = self.truth.labels_of(capture).as_image()
        return self._truths[capture][row, column]

    def act(self, labels: Sequence[CaptureLabels]) -> None:
        """Write an action, and measure until the queue knows it."""
        begin = time.perf_counter()
        action = self.store.label(PERSON, labels, Author(PERSON))
        if action is not None:
            self.queue.update(action.captures)
            self.samples += action.samples
        self.queue.next_open(None)
        self.acts_s.append(time.perf_counter() - begin)

    def undo(self) -> None:
        action = self.store.undo(PERSON, PERSON)
        assert action is not None, "there was something to take back"
        self.queue.update(action.captures)
        self.samples -= action.samples
        self.taken_back += 1
        self.time_s += MIND_S + KEY_S

    def parts(self, number: int) -> list[tuple[slice, int]]:
        """The stretches of a run's open samples that the truth gives one label."""
        runs, run = self.table.runs(number)
        own = self.queue.open_part(number)
        codes = self.codes(runs.capture(run), runs.row[own], runs.column[own])
        ends = np.concatenate([[0], np.flatnonzero(np.diff(codes)) + 1, [codes.size]])
        return [
            (slice(own.start + int(a), own.start + int(b)), int(codes[a]))
            for a, b in pairwise(ends)
        ]

    def by_sample(self, number: int) -> None:
        """One decision and one key for each sample, as where there are no runs."""
        runs, run = self.table.runs(number)
        for own, code in self.parts(number):
            for at in range(own.start, own.stop):
                self.time_s += MIND_S + KEY_S
                self.act([runs.labels(run, code, slice(at, at + 1))])

    def by_run(self, number: int) -> None:
        """One decision and one key for each run, and a split wherever the truth parts it."""
        runs, run = self.table.runs(number)
        parts = self.parts(number)
        for place, (own, code) in enumerate(parts):
            is_split = place < len(parts) - 1
            self.time_s += MIND_S + KEY_S + is_split * (POINT_S + KEY_S)
            self.act([runs.labels(run, code, own)])

    def by_propagation(self, number: int) -> None:
        """The same place in neighbouring frames along with the run, if that is right there."""
        runs, run = self.table.runs(number)
        parts = self.parts(number)
        (own, code), frame = parts[0], int(self.table.frame[number])
        around = []
        if len(parts) == 1:
            view = View(recording=self.opened.recording.path.name, frame_index=frame)
            frame_view = compute_frame_view(view, self.opened)
            around = labels_around(frame_view, self.table, number, own, code, BESIDE)
        if not around:
            self.by_run(number)
            return
        self.time_s += MIND_S + KEY_S + GLANCE_S * len(around)
        self.act([*around, runs.labels(run, code, own)])
        is_right = all(
            (self.codes(labels.capture, labels.row, labels.column) == labels.label).all()
            for labels in around
        )
        if not is_right:
            self.undo()
            self.by_run(number)

    def work(self, answer: Callable[[int], None], runs: int) -> None:
        """Answer until so many runs are labelled."""
        at = self.queue.next(None)
        while at is not None and self.queue.progress.done < runs:
            answer(at)
            at = self.queue.next_open(at)
        self.runs = self.queue.progress.done

    def wrong(self) -> int:
        """Samples whose label is not the truth's."""
        return sum(
            int((self.codes(labels.capture, labels.row, labels.column) != labels.label).sum())
            for labels in self.store.labelled(PERSON)
        )

    def close(self) -> None:
        self.store.close()
        self._folder.cleanup()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--runs", type=int, default=500)
    options = parser.parse_args()
    library = Library([options.recording], [])
    opened = library.open(View(recording=options.recording.name), viewer="bench")
    opened.align(lambda: None)
    opened.wait(600.0)
    assert opened.chain is not None, opened.failure
    inputs = SurveyInputs(
        chain=opened.chain, settings=opened.fuse_session.settings, pairing=opened.pairing
    )
    survey = FrameSurvey(inputs)
    while survey.advance():
        pass
    table = RunTable(survey.runs)
    truth = TruthLayer(load_truth(options.truth))
    print(f"{options.runs} runs of {options.recording.name}; look {MIND_S} s, key {KEY_S} s")
    for name in ("by_sample", "by_run", "by_propagation"):
        played = Played(opened, table, truth)
        played.work(getattr(played, name), options.runs)
        minutes = played.time_s / 60.0
        print(
            f"{name:15} {played.runs:4d} runs, {played.samples:5d} samples in {minutes:5.1f} min: "
            f"{played.samples / minutes:6.0f} samples, {played.runs / minutes:5.1f} runs a minute; "
            f"wrong {played.wrong()}, taken back {played.taken_back}; program 95 % within "
            f"{1e3 * np.quantile(played.acts_s, 0.95):.1f} ms"
        )
        played.close()
    library.close()


if __name__ == "__main__":
    main()
