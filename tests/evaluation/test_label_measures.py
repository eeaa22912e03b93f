"""Classes against labels, against a plain loop."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.label_measures import LabelMeasures, count_confusion
from fusion_core.model.classes import NoiseClass
from fusion_core.model.labels import NO_LABEL, Label

LABELS = st.sampled_from([NO_LABEL, *(int(label) for label in Label)])
SAMPLES = st.lists(st.tuples(LABELS, st.integers(-1, 3)), max_size=40)


@given(SAMPLES, SAMPLES)
def test_precision_and_recall_are_those_of_a_plain_loop(lidar, depth) -> None:
    sides = {"lidar": lidar, "depth": depth}
    confusion = np.stack(
        [
            count_confusion(*np.array(samples, dtype=np.int64).reshape(-1, 2).T)
            for samples in sides.values()
        ]
    )
    measures = LabelMeasures(confusion=confusion)
    for side, samples in sides.items():
        decided = [(given_, own) for given_, own in samples if given_ in range(4) and own >= 0]
        assert measures.to_json()[side]["samples"] == len(decided)
        for noise in NoiseClass:
            right = sum(given_ == own == noise for given_, own in decided)
            labelled = sum(given_ == noise for given_, _ in decided)
            automatic = sum(own == noise for _, own in decided)
            assert measures.recall(side, noise) == (right / labelled if labelled else None)
            assert measures.precision(side, noise) == (right / automatic if automatic else None)
            entry = measures.to_json()[side]["classes"][noise.name.lower()]
            assert (entry["labelled"], entry["automatic"]) == (labelled, automatic)
