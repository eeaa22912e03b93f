"""A layer in place of a truth, with the truth's own labels: what is counted is the same."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from fusion_core.evaluation.label_measures import SIDES
from fusion_core.evaluation.noise import evaluate_noise
from fusion_core.evaluation.pairs import PairKind
from fusion_core.evaluation.recall_curve import recall_over_epsilon
from fusion_core.evaluation.truth import load_truth
from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import CaptureLabels, Label
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.evaluate.evaluate import EPSILON_OVER_E
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.captures import scan_capture
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from fusion_core.workflows.labels.evaluate_layer import evaluate_layer
from fusion_core.workflows.labels.labelled_frames import labelled_frames
from fusion_core.workflows.labels.measures import measure_classes, recall_by_labels
from fusion_core.workflows.labels.suggestions import suggest_thresholds
from tests.benchmarks.truth_layer import TruthLayer
from tests.workflows.label_layer import MemoryLayer

DEFAULT = PRESETS["default"]
GOOD, HOLE, BURR, CONFLICT = NoiseClass


@pytest.fixture(scope="module")
def truth(bedroom):
    return load_truth(bedroom.truth)


@pytest.fixture(scope="module")
def chain(bedroom):
    with open_recording(bedroom.recording) as recording:
        session = open_session(recording, FuseOptions(), DEFAULT)
        yield CachedChain(session, FrameReader(session), align_recording(session))


@pytest.fixture(scope="module")
def frames(chain, truth):
    """Every frame, labelled as the truth has it."""
    return list(labelled_frames(chain, DEFAULT, TruthLayer(truth)))


def test_the_confusion_is_that_of_the_written_classes(bedroom, truth, chain, frames) -> None:
    found = measure_classes(frames, chain.alignment, DEFAULT).confusion
    table = pq.read_table(bedroom.folder / "samples.parquet")
    column = {name: table[name].to_numpy() for name in table.column_names}
    scans = {stamp: place for place, stamp in enumerate(truth.scan_stamp_ns.tolist())}
    images = {stamp: place for place, stamp in enumerate(truth.cameras[0].stamp_ns.tolist())}
    expected = np.zeros((2, 4, 4), dtype=int)
    for row in range(table.num_rows):
        true = truth.kind[scans[column["scan_stamp_ns"][row]], column["lidar_beam"][row]]
        expected[0, true, column["lidar_class"][row]] += 1
        if np.isfinite(column["depth_row"][row]):
            place = images[column["stamp_ns"][row]]
            pixel = int(column["depth_row"][row]), int(column["depth_column"][row])
            true = truth.cameras[0].kind[(place, *pixel)]
            expected[1, true, int(column["depth_class"][row])] += 1
    np.testing.assert_array_equal(found, expected)
    assert found[:, BURR].sum() > 20
    assert found.shape[0] == len(SIDES)


def test_the_recalls_are_those_by_the_truth(bedroom, truth, frames) -> None:
    by_labels = recall_by_labels(frames)
    by_truth = recall_over_epsilon(bedroom.folder, truth, EPSILON_OVER_E)
    assert by_labels.noise_pairs == by_truth.noise_pairs > 10
    np.testing.assert_array_equal(by_labels.noise_found, by_truth.noise_found)
    # A conflict is good on both sides, and the truth tells it by the surfaces alone.
    conflicts = int(evaluate_noise(bedroom.folder, truth).pairs[PairKind.CONFLICT].sum())
    assert by_labels.good_pairs == by_truth.good_pairs + conflicts
    assert (by_labels.good_kept >= by_truth.good_kept).all()


def test_frames_without_a_label_are_left_out(chain, truth) -> None:
    scan = scan_capture(chain.pair(FrameChoice(number=20)).window.scan, chain.session)
    beams = np.arange(scan.columns)
    layer = MemoryLayer(CaptureLabels.of_samples(scan, np.zeros_like(beams), beams, BURR))
    found = list(labelled_frames(chain, DEFAULT, layer))
    assert found
    assert {frame.match.scan.stamp_ns for frame in found} == {scan.stamp_ns}
    for frame in found:
        assert (frame.lidar == BURR).all()
        assert (frame.depth == -1).all()
    behind = np.setdiff1d(beams, np.concatenate([own.match.correspondence.beam for own in found]))
    assert behind.size
    layer = MemoryLayer(CaptureLabels.of_samples(scan, np.zeros_like(behind), behind, BURR))
    assert not list(labelled_frames(chain, DEFAULT, layer))
    unsure = CaptureLabels.of_samples(scan, np.zeros_like(beams), beams, int(Label.UNSURE))
    measures = measure_classes(
        labelled_frames(chain, DEFAULT, MemoryLayer(unsure)), chain.alignment, DEFAULT
    )
    assert not measures.confusion.any()


def test_suggestions_are_scored_as_whole_runs_with_that_setting_are(chain, frames) -> None:
    """The score in use on the scans left out, by hand from the chain's own classes."""
    few = frames[::3]
    found = {own.setting: own.fit for own in suggest_thresholds(few, chain.alignment, DEFAULT)}
    assert next(iter(found)) == "epsilon"
    assert {"support_sigma", "burr_odds", "pixel_support"} <= found.keys()
    stamps = sorted({frame.match.scan.stamp_ns for frame in few})
    blocks = np.arange(len(stamps)) * 8 // len(stamps)
    tried = {stamp for stamp, block in zip(stamps, blocks, strict=True) if block % 2}
    for name in ("epsilon", "pixel_support"):
        fit = found[name]
        for value, score in ((fit.current, fit.score_of_current), (fit.value, fit.score_of_value)):
            kind = type(getattr(DEFAULT.noise, name))
            noise = DEFAULT.noise.model_copy(update={name: kind(value)})
            settings = DEFAULT.model_copy(update={"noise": noise})
            counts = np.zeros((2, 2, 2))
            for frame in few:
                if frame.match.scan.stamp_ns not in tried:
                    continue
                choice = FrameChoice(number=number_of(chain, frame))
                classes = chain.fused(choice, settings).classes
                pairs = frame.match.correspondence
                for side, (label, value_m, own) in enumerate(
                    (
                        (frame.lidar, pairs.lidar_range_m, classes.lidar_class),
                        (frame.depth, pairs.depth_m, classes.depth_class),
                    )
                ):
                    for true, is_right in ((BURR, own == BURR), (GOOD, own != BURR)):
                        mine = (label == true) & np.isfinite(value_m)
                        counts[side, int(true == GOOD)] += [mine.sum(), (mine & is_right).sum()]
            known = counts[:, :, 0].all(axis=1)
            recalls = counts[known, :, 1] / counts[known, :, 0]
            assert score == pytest.approx(float(np.mean(recalls.sum(axis=1) - 1.0)), abs=1e-12)


def number_of(chain, frame):
    """The number of a frame in the recording."""
    return next(
        number
        for number in range(len(chain.frames))
        if chain.frames.image(number).stamp_ns == frame.match.stamp_ns
    )


def test_of_few_labels_nothing_is_suggested(chain, frames) -> None:
    found = suggest_thresholds(frames[:1], chain.alignment, DEFAULT)
    assert {own.fit for own in found} == {None}
    published = suggest_thresholds([], chain.alignment, PRESETS["published"])
    assert [own.setting for own in published] == ["epsilon"]


def test_the_whole_report_of_a_layer(bedroom, truth) -> None:
    layer = TruthLayer(truth)
    report = evaluate_layer(bedroom.recording, layer, FuseOptions())
    assert report["layer"] == "truth"
    assert report["classes"]["lidar"]["classes"]["burr"]["labelled"] > 10
    assert report["over_epsilon"]["noise_pairs"] > 10
    assert "suggestions" not in report
    with pytest.raises(ScanLoomError, match="the layer anna has no label on a frame"):
        evaluate_layer(bedroom.recording, MemoryLayer(), FuseOptions())
