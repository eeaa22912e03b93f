"""The review's runs and queue, against dictionaries of samples."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.model.labels import Capture, CaptureLabels, Label
from fusion_core.workflows.fuse.cached_chain import FrameChoice
from fusion_core.workflows.fuse.captures import frame_captures
from fusion_core.workflows.fuse.frame import FusedFrame
from scanloom.state.frame_runs import SENSORS, FrameRuns, runs_of_frame
from scanloom.state.library import Library
from scanloom.state.review_choices import ReviewChoices
from scanloom.state.review_queue import ReviewQueue, RunTable
from scanloom.state.view import View
from tests.patience import ENOUGH_S

FRAMES = (0, 3, 7)


@dataclass
class Labels:
    """Labels in memory, as a store has them."""

    by_layer: dict[str, dict[Capture, CaptureLabels]] = field(default_factory=dict)

    def give(self, layer: str, labels: CaptureLabels) -> None:
        image = self.labels_of(layer, labels.capture).as_image()
        image[labels.row, labels.column] = labels.label
        whole = CaptureLabels.of_image(labels.capture, image)
        self.by_layer.setdefault(layer, {})[labels.capture] = whole

    def labels_of(self, layer: str, capture: Capture) -> CaptureLabels:
        nothing = np.zeros(0, dtype=np.int64)
        empty = CaptureLabels(capture=capture, row=nothing, column=nothing, label=nothing)
        return self.by_layer.get(layer, {}).get(capture, empty)

    def labelled(self, layer: str) -> Iterator[CaptureLabels]:
        yield from self.by_layer.get(layer, {}).values()


@pytest.fixture(scope="module")
def fused(small_scene: Path) -> Iterator[dict[int, tuple[FusedFrame, FrameRuns]]]:
    """Some frames with their runs, by number."""
    library = Library([small_scene], [])
    opened = library.open(View(recording=small_scene.name), viewer="the tests")
    opened.align(lambda: None)
    assert opened.wait(ENOUGH_S)
    assert opened.chain is not None
    frames = {}
    for number in FRAMES:
        frame = opened.chain.fused(FrameChoice(number=number), opened.fuse_session.settings)
        frames[number] = (
            frame,
            runs_of_frame(frame, frame_captures(frame.match, opened.fuse_session)),
        )
    yield frames
    library.close()


@pytest.fixture
def table(fused: dict[int, tuple[FusedFrame, FrameRuns]]) -> RunTable:
    frames: list[FrameRuns | None] = [None] * 10
    for number, (_, runs) in fused.items():
        frames[number] = runs
    return RunTable(frames)


def test_runs_hold_each_sample_once_in_stretches_of_one_class(
    fused: dict[int, tuple[FusedFrame, FrameRuns]],
) -> None:
    for frame, runs in fused.values():
        beams = frame.match.correspondence.beam
        expected: list[tuple[str, int, int]] = []
        for sensor, codes in zip(
            SENSORS, (frame.classes.lidar_class, frame.classes.depth_class), strict=True
        ):
            before: tuple[int, int] | None = None
            for beam, code in zip(beams.tolist(), codes.tolist(), strict=True):
                if code < 0:
                    continue
                if before is None or before[0] != code or abs(beam - before[1]) != 1:
                    expected.append((sensor, code, 0))
                sensor_, code_, size = expected[-1]
                expected[-1] = sensor_, code_, size + 1
                before = code, beam
        found = [
            (
                SENSORS[runs.sensor[run]],
                int(runs.noise_class[run]),
                np.arange(9999)[runs.samples(run)].size,
            )
            for run in range(len(runs))
        ]
        assert found == expected


def test_a_run_labels_the_samples_that_it_was_made_of(
    fused: dict[int, tuple[FusedFrame, FrameRuns]],
) -> None:
    for frame, runs in fused.values():
        assert runs.scan is not None
        scan = np.full(runs.scan.columns, -1)
        for run in range(len(runs)):
            if SENSORS[runs.sensor[run]] == "lidar":
                labels = runs.labels(run, int(runs.noise_class[run]))
                assert labels.capture == runs.scan
                scan[labels.column] = labels.label
        expected = np.full(runs.scan.columns, -1)
        expected[frame.match.correspondence.beam] = frame.classes.lidar_class
        np.testing.assert_array_equal(scan, expected)


def test_the_confidence_of_a_run_is_the_least_of_its_samples(
    fused: dict[int, tuple[FusedFrame, FrameRuns]],
) -> None:
    frame, runs = fused[FRAMES[0]]
    place = {int(beam): at for at, beam in enumerate(frame.match.correspondence.beam)}
    for run in range(len(runs)):
        own = [place[int(beam)] for beam in runs.beam[runs.samples(run)]]
        is_lidar = SENSORS[runs.sensor[run]] == "lidar"
        of = frame.classes.lidar_confidence if is_lidar else frame.classes.depth_confidence
        assert runs.confidence[run] == of[own].min()


def queue_of(table: RunTable, labels: Labels, *layers: str, **choices: object) -> ReviewQueue:
    chosen = ReviewChoices.model_validate(choices)
    return ReviewQueue(table, chosen, labels, layers or ("anna",))


def walked(queue: ReviewQueue) -> list[int]:
    """All runs that J goes to."""
    found, at = [], queue.next(None)
    while at is not None:
        found.append(at)
        at = queue.next(at)
    return found


def test_the_queue_is_walked_in_time_and_back(table: RunTable) -> None:
    queue = queue_of(table, Labels())
    there = walked(queue)
    assert there == [n for n in range(len(table)) if table.noise_class[n] != NoiseClass.GOOD]
    assert len(there) > 10
    back, at = [], queue.next(None, -1)
    while at is not None:
        back.append(at)
        at = queue.next(at, -1)
    assert back == there[::-1]


def test_the_least_confident_come_first(table: RunTable) -> None:
    there = walked(queue_of(table, Labels(), order="least confident", classes=list(NoiseClass)))
    assert len(there) == len(table)
    assert (np.diff(table.confidence[there]) >= 0.0).all()


@pytest.mark.parametrize("sensor", SENSORS)
def test_one_class_of_one_sensor(table: RunTable, sensor: str) -> None:
    there = walked(queue_of(table, Labels(), sensor=sensor, classes=[NoiseClass.HOLE]))
    assert there
    for number in there:
        assert SENSORS[table.sensor[number]] == sensor
        assert table.noise_class[number] == NoiseClass.HOLE


def test_labelled_runs_are_passed_over_and_counted(table: RunTable) -> None:
    labels = Labels()
    queue = queue_of(table, labels)
    total = queue.progress.total
    first = walked(queue)[0]
    runs, run = table.runs(first)
    labels.give("anna", runs.labels(run, Label.BURR))
    queue.update([runs.capture(run)])
    assert queue.done[first]
    assert first not in walked(queue)
    assert (queue.progress.done, queue.progress.total) == (
        int(queue.done[queue.chosen].sum()),
        total,
    )
    # A queue that is made anew says the same.
    np.testing.assert_array_equal(queue_of(table, labels).done, queue.done)
    assert first in walked(queue_of(table, labels, only_open=False))
    # And so does one that takes over what another knows, of frames that both have.
    known = queue_of(table, labels)
    more = RunTable([*table.frames, *table.frames[:1]])
    taken = ReviewQueue(more, ReviewChoices(), labels, ["anna"], known)
    np.testing.assert_array_equal(taken.done, queue_of(more, labels).done)
    assert taken.done.sum() > known.done.sum()
    # Somebody else's labels are not this person's.
    assert not queue_of(table, labels, "ben", "anna").done.any()


def test_a_run_that_is_labelled_in_part_is_open_and_asks_for_the_rest(table: RunTable) -> None:
    labels = Labels()
    queue = queue_of(table, labels)
    number = next(n for n in walked(queue) if _size(table, n) >= 3)
    runs, run = table.runs(number)
    whole = runs.samples(run)
    assert queue.open_part(number) == whole
    labels.give("anna", runs.labels(run, Label.GOOD, slice(whole.start + 1, whole.start + 2)))
    queue.update([runs.capture(run)])
    assert not queue.done[number]
    assert queue.open_part(number) == slice(whole.start, whole.start + 1)
    labels.give("anna", runs.labels(run, Label.GOOD, slice(whole.start, whole.start + 1)))
    assert queue.open_part(number) == slice(whole.start + 2, whole.stop)


def test_disagreements_are_those_of_two_layers(table: RunTable) -> None:
    labels = Labels()
    one, other, alike = walked(queue_of(table, labels))[:3]
    for number, answers in ((one, (2, 0)), (alike, (1, 1))):
        runs, run = table.runs(number)
        for layer, answer in zip(("anna", "ben"), answers, strict=True):
            labels.give(layer, runs.labels(run, answer))
    runs, run = table.runs(other)
    labels.give("ben", runs.labels(run, Label.BURR))
    queue = queue_of(table, labels, "anna", "ben", order="disagreement", only_open=False)
    there = walked(queue)
    runs, run = table.runs(one)
    assert one in there
    assert alike not in there
    # A beam may be in runs of several frames.
    own = set(runs.column[runs.samples(run)].tolist())
    for number in there:
        beside, beside_run = table.runs(number)
        assert beside.capture(beside_run) == runs.capture(run)
        assert own & set(beside.column[beside.samples(beside_run)].tolist())


def known(table: RunTable, numbers: list[int], label: int = Label.GOOD) -> Labels:
    """A layer "gold" that knows these runs."""
    labels = Labels()
    for number in numbers:
        runs, run = table.runs(number)
        labels.give("gold", runs.labels(run, label))
    return labels


def test_known_answers_join_a_blind_queue_in_its_order(table: RunTable) -> None:
    good = [n for n in range(len(table)) if table.noise_class[n] == NoiseClass.GOOD]
    labels = known(table, good)
    plain = walked(queue_of(table, labels))
    for order in ("time", "least confident"):
        queue = queue_of(table, labels, gold_layer="gold", blind=True, order=order)
        mixed = walked(queue)
        added = set(mixed) - set(plain)
        # One for nine, of many.
        assert len(added) == -(-len(plain) // 9) < len(good)
        assert added <= set(good)
        assert set(plain) <= set(mixed)
        expected = sorted(mixed)
        if order == "least confident":
            expected = sorted(expected, key=lambda number: table.confidence[number])
        assert mixed == expected
        assert set(np.flatnonzero(queue.gold).tolist()) >= added
        assert queue.gold_progress.total == queue.gold.sum()


def test_known_answers_are_not_told_by_their_class_or_sensor(table: RunTable) -> None:
    labels = known(table, list(range(len(table))))
    for choices in ({}, {"sensor": "lidar"}):
        plain = walked(queue_of(table, labels, **choices))
        queue = queue_of(table, labels, gold_layer="gold", **choices)
        assert walked(queue) == plain
        assert queue.gold[plain].all()
    blind = walked(queue_of(table, labels, gold_layer="gold", blind=True, sensor="lidar"))
    assert len(blind) > len(plain)
    assert {SENSORS[table.sensor[number]] for number in blind} == {"lidar"}


def test_what_the_gold_layer_leaves_open_is_no_known_answer(table: RunTable) -> None:
    numbers = walked(queue_of(table, Labels()))
    queue = queue_of(table, known(table, numbers, Label.UNSURE), gold_layer="gold")
    assert walked(queue) == numbers
    assert not queue.gold.any()


def test_answers_to_known_runs_are_counted(table: RunTable) -> None:
    numbers = walked(queue_of(table, Labels()))[:3]
    labels = known(table, numbers)
    queue = queue_of(table, labels, gold_layer="gold")
    total = queue.gold_progress.total
    assert total >= 3
    assert queue.gold_progress.done == 0
    runs, run = table.runs(numbers[1])
    labels.give("anna", runs.labels(run, Label.HOLE))
    queue.update([runs.capture(run)])
    assert queue.gold_progress.done >= 1
    assert queue.done[numbers[1]]
    assert queue.gold_progress.total == total


def _size(table: RunTable, number: int) -> int:
    runs, run = table.runs(number)
    own = runs.samples(run)
    return own.stop - own.start
