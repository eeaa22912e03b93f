"""Scores against known answers: a kept library as oracle, and what has no score."""

import numpy as np
import pytest
from hypothesis import given
from sklearn.metrics import precision_score, recall_score

from fusion_core.annotation.agreement import NO_PAIRS
from fusion_core.annotation.aligned_layers import align_layers
from fusion_core.annotation.answer_scores import (
    NEVER_KNOWN,
    NEVER_SAID,
    AnswerScore,
    score_answers,
)
from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import Capture, CaptureLabels, Label
from tests.annotation.drawn_layers import layers, samples_of

SCANS = tuple(Capture("lidar", "/scan", stamp_ns, 0, 1, 20) for stamp_ns in range(12))


def score_of(known: list[CaptureLabels], said: list[CaptureLabels]) -> AnswerScore:
    blocks = align_layers({"known": known, "said": said}, samples_per_block=9)
    return score_answers(blocks, resamples=50)


@given(layers(), layers())
def test_recall_and_precision_are_those_of_a_kept_library(
    known: list[CaptureLabels], said: list[CaptureLabels]
) -> None:
    of_known, of_said = samples_of(known), samples_of(said)
    both = [
        (label, of_said[sample], sample[0])
        for sample, label in of_known.items()
        if sample in of_said and Label.UNSURE not in (label, of_said[sample])
    ]
    if not both:
        with pytest.raises(ScanLoomError, match="no known answer"):
            score_of(known, said)
        return
    score = score_of(known, said)
    assert (score.samples, score.captures) == (len(both), len({capture for *_, capture in both}))
    truth, answers = (
        [int(label) for label in column] for column in list(zip(*both, strict=True))[:2]
    )
    assert score.percent.value == np.mean(np.equal(truth, answers))
    for one in score.classes:
        code = one.noise_class
        assert (one.known, one.said) == (truth.count(code), answers.count(code))
        for estimate, oracle, count, why in (
            (one.recall, recall_score, one.known, NEVER_KNOWN),
            (one.precision, precision_score, one.said, NEVER_SAID),
        ):
            if not count:
                assert (estimate.value, estimate.undefined) == (None, why)
                continue
            expected = oracle(truth, answers, labels=[code], average=None)[0]
            assert estimate.value == pytest.approx(expected, abs=1e-12)


def test_captures_without_a_common_sample_widen_no_interval() -> None:
    rng = np.random.default_rng(3)

    def layer(scans: tuple[Capture, ...]) -> list[CaptureLabels]:
        drawn = [(scan, rng.integers(0, 4, (1, 20))) for scan in scans]
        return [CaptureLabels.of_image(scan, image) for scan, image in drawn]

    known, said = layer(SCANS[:8]), layer(SCANS[:4])
    alone = score_of(known[:4], said)
    # Others that only one of the two has labelled say nothing.
    assert score_of(known, [*said, *layer(SCANS[8:])]) == alone
    recall = alone.classes[NoiseClass.GOOD].recall
    assert recall.value is not None
    assert recall.low is not None
    assert recall.high is not None
    assert recall.low <= recall.value <= recall.high
    assert recall.low < recall.high
    assert alone.percent.undefined != NO_PAIRS
