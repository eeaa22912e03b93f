"""Contested samples and majorities, against dictionaries."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from fusion_core.annotation.aligned_layers import align_layers
from fusion_core.annotation.disagreements import adjudicate, disagreements
from fusion_core.model.labels import CaptureLabels, Label
from tests.annotation.drawn_layers import Samples, layers, samples_of

several = st.lists(layers(), min_size=2, max_size=4)


def decisions_by_sample(drawn: list[list[CaptureLabels]]) -> dict[object, list[Label]]:
    found: dict[object, list[Label]] = {}
    for layer in drawn:
        for sample, label in samples_of(layer).items():
            found.setdefault(sample, [])
            if label != Label.UNSURE:
                found[sample].append(label)
    return found


@given(several, st.integers(1, 3))
def test_more_than_half_decide(drawn: list[list[CaptureLabels]], least: int) -> None:
    expected = {}
    for sample, decisions in decisions_by_sample(drawn).items():
        for label, votes in Counter(decisions).items():
            if 2 * votes > len(decisions) >= least:
                expected[sample] = label
    blocks = align_layers(dict(zip("abcd", drawn, strict=False)), samples_per_block=9)
    assert samples_of(adjudicate(blocks, least_decisions=least)) == expected


@given(several)
def test_each_contested_sample_stands_in_one_run_with_what_was_said(
    drawn: list[list[CaptureLabels]],
) -> None:
    named = dict(zip("abcd", drawn, strict=False))
    samples: dict[str, Samples] = {name: samples_of(layer) for name, layer in named.items()}
    contested = {
        sample
        for sample, decisions in decisions_by_sample(drawn).items()
        if len(set(decisions)) > 1
    }
    seen = []
    captures = []
    for run in disagreements(align_layers(named, samples_per_block=9)):
        captures.append(run.capture)
        places = list(zip(run.row.tolist(), run.column.tolist(), strict=True))
        assert places == sorted(places)
        for row, column in places:
            sample = (run.capture, row, column)
            seen.append(sample)
            assert run.said == {name: own.get(sample) for name, own in samples.items()}
            # Else it would be a run of its own.
            neighbours = {
                (row + 1, column),
                (row - 1, column),
                (row, column + 1),
                (row, column - 1),
            }
            assert len(places) == 1 or neighbours & set(places)
    assert len(seen) == len(set(seen))
    assert set(seen) == contested
    assert captures == sorted(captures)
