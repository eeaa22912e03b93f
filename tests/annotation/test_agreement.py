"""Coefficients of agreement against published examples and kept statistics libraries."""

from itertools import combinations

import krippendorff
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hypothesis_numpy
from sklearn.metrics import cohen_kappa_score
from statsmodels.stats import inter_rater

from fusion_core.annotation.agreement import (
    NO_PAIRS,
    NO_RUNS,
    NOT_COMPLETE,
    ONE_CLASS,
    Agreement,
    measure_agreement,
)
from fusion_core.annotation.agreement_counts import AgreementCounts, count_pairs
from fusion_core.annotation.aligned_layers import CodeArray, align_layers
from fusion_core.annotation.coefficients import (
    cohen_kappa,
    fleiss_kappa,
    krippendorff_alpha,
    one_vs_rest,
    percent_agreement,
)
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from tests.annotation.drawn_layers import CAPTURES, layers, samples_of

# Fleiss 1971, table 1: what six psychiatrists diagnosed of each of thirty patients.
FLEISS = """
    444444 222555 233335 555555 222444 113333 333355 113334 114444 555555 144444 124444 222333
    144444 224445 333335 111455 111112 224444 133555 555555 244444 224555 114444 144445 222224
    111155 224444 133333 555555
"""
# Krippendorff 2011, part C: four observers, twelve units.
KRIPPENDORFF = "123321412... 1233224125.3 .3332342251. 12332441251."
SCANS = tuple(Capture("lidar", "/scan", stamp_ns, 0, 1, 40) for stamp_ns in range(30))

ratings = hypothesis_numpy.arrays(
    np.int8, st.tuples(st.integers(2, 5), st.integers(1, 40)), elements=st.integers(-1, 3)
)


def sums_of(codes: CodeArray, size: int = 4) -> tuple[npt.NDArray[np.float64], ...]:
    """Pairs, complete pairs and coincidences of all samples."""
    counted = count_pairs(codes, np.zeros(codes.shape[1], int), 1, size)
    return tuple(counts[0] for counts in counted)


def codes_of(table: str) -> CodeArray:
    """One word for each rater, one digit for each unit, from 1; a point is a gap."""
    rows = [[-1 if digit == "." else int(digit) - 1 for digit in word] for word in table.split()]
    return np.array(rows, dtype=np.int8)


def agreement_of(*drawn: list[CaptureLabels], resamples: int = 50, seed: int = 0) -> Agreement:
    named = {f"layer {number}": layer for number, layer in enumerate(drawn)}
    return measure_agreement(align_layers(named), resamples=resamples, seed=seed)


def noisy_layer(seed: int, fraction: float) -> list[CaptureLabels]:
    """Scans of one truth, of which a fraction of the beams is redrawn."""
    truth = np.random.default_rng(0).integers(0, 4, (len(SCANS), 1, 40))
    rng = np.random.default_rng(seed)
    wrong = rng.random(truth.shape) < fraction
    codes = np.where(wrong, rng.integers(0, 4, truth.shape), truth)
    return [CaptureLabels.of_image(scan, image) for scan, image in zip(SCANS, codes, strict=True)]


def test_fleiss_of_his_own_table() -> None:
    codes = codes_of(FLEISS).T.copy()
    _, complete, _ = sums_of(codes, 5)
    assert fleiss_kappa(complete) == pytest.approx(0.430, abs=5e-4)
    table, _ = inter_rater.aggregate_raters(codes.T)
    assert fleiss_kappa(complete) == pytest.approx(inter_rater.fleiss_kappa(table), abs=1e-12)


def test_alpha_of_krippendorffs_own_table() -> None:
    codes = codes_of(KRIPPENDORFF)
    _, _, coincidences = sums_of(codes, 5)
    assert coincidences.sum() == pytest.approx(40.0)
    assert np.diag(coincidences) == pytest.approx([7.0, 10.0, 8.0, 4.0, 3.0], abs=1e-12)
    assert krippendorff_alpha(coincidences) == pytest.approx(0.743, abs=5e-4)


def test_cohens_kappa_by_hand() -> None:
    # p_o = 0.7, p_e = 0.6 * 0.5 + 0.4 * 0.5.
    assert cohen_kappa(np.array([[20.0, 5.0], [10.0, 15.0]])) == pytest.approx(0.4)


@given(ratings)
def test_kappas_are_those_of_the_libraries(codes: CodeArray) -> None:
    pairs, complete, _ = sums_of(codes)
    for own, (first, second) in zip(pairs, combinations(codes, 2), strict=True):
        both = (first >= 0) & (second >= 0)
        a, b = first[both], second[both]
        assert own.sum() == both.sum()
        if not both.any():
            assert np.isnan(percent_agreement(own))
            assert np.isnan(cohen_kappa(own))
            continue
        assert percent_agreement(own) == pytest.approx((a == b).mean())
        if len(np.unique([a, b])) == 1:
            assert np.isnan(cohen_kappa(own))
            continue
        assert cohen_kappa(own) == pytest.approx(cohen_kappa_score(a, b), abs=1e-12)
        for code in range(4):
            binary = cohen_kappa(one_vs_rest(own, code))
            if len(np.unique([a == code, b == code])) == 1:
                assert np.isnan(binary)
            else:
                expected = cohen_kappa_score(a == code, b == code)
                assert binary == pytest.approx(expected, abs=1e-12)
    whole = codes[:, (codes >= 0).all(axis=0)]
    if len(np.unique(whole)) < 2:
        assert np.isnan(fleiss_kappa(complete))
    else:
        table, _ = inter_rater.aggregate_raters(whole.T)
        assert fleiss_kappa(complete) == pytest.approx(inter_rater.fleiss_kappa(table), abs=1e-9)


@given(ratings)
def test_alpha_is_that_of_the_library(codes: CodeArray) -> None:
    _, _, coincidences = sums_of(codes)
    paired = codes[:, (codes >= 0).sum(axis=0) > 1]
    if len(np.unique(paired[paired >= 0])) < 2:
        assert np.isnan(krippendorff_alpha(coincidences))
        return
    expected = krippendorff.alpha(
        np.where(codes < 0, np.nan, codes), level_of_measurement="nominal"
    )
    assert krippendorff_alpha(coincidences) == pytest.approx(expected, abs=1e-9)


@given(st.lists(layers(), min_size=2, max_size=4))
def test_unsure_is_a_gap_and_counts_add_up_over_captures(drawn: list[list[CaptureLabels]]) -> None:
    assume(any(drawn))
    named = {str(number): layer for number, layer in enumerate(drawn)}
    counts = AgreementCounts.of(align_layers(named, samples_per_block=8))
    samples = [samples_of(layer) for layer in drawn]
    everything = sorted(set().union(*samples))
    codes = np.array([[own.get(sample, NO_LABEL) for sample in everything] for own in samples])
    codes[codes == Label.UNSURE] = NO_LABEL
    for found, expected in zip(
        (counts.pairs, counts.complete, counts.coincidences), sums_of(codes), strict=True
    ):
        np.testing.assert_allclose(found.sum(axis=0), expected, atol=1e-12)
    for layer, own in enumerate(samples):
        said = list(own.values())
        assert counts.labels.sum(axis=0)[layer].tolist() == [said.count(label) for label in Label]
    whole = AgreementCounts.of(align_layers(named))
    np.testing.assert_array_equal(whole.runs, counts.runs)


def test_runs_match_where_they_share_more_than_half() -> None:
    def scan(codes: str) -> list[CaptureLabels]:
        image = np.array([[int(code) for code in codes]])
        return [CaptureLabels.of_image(Capture("lidar", "/scan", 0, 0, 1, len(codes)), image)]

    # Good: 3 of 4, a run of the second alone. Hole: 2 of 4, which is not more than half.
    # Burr: the same run. The last beam: UNSURE in one.
    (pair,) = agreement_of(scan("0000111220"), scan("0001110224")).pairs
    good, hole, burr = (pair.by_class[name] for name in ("good", "hole", "burr"))
    assert good["panoptic_quality"].value == pytest.approx(0.75 / (1 + 0.5))
    assert good["matched_iou"].value == pytest.approx(0.75)
    assert hole["panoptic_quality"].value == 0.0
    assert hole["matched_iou"].value is None
    assert hole["sample_iou"].value == pytest.approx(0.5)
    assert burr["panoptic_quality"].value == 1.0
    assert pair.by_class["conflict"]["panoptic_quality"].undefined == NO_RUNS
    assert pair.coefficients["panoptic_quality"].value == pytest.approx(1.75 / (2 + 1.5))


def test_what_is_not_defined_says_why() -> None:
    def same(code: int, capture: Capture = CAPTURES[4]) -> list[CaptureLabels]:
        return [CaptureLabels.of_image(capture, np.full((capture.rows, capture.columns), code))]

    alike = agreement_of(same(2), same(2))
    assert alike.coefficients["percent"].value == 1.0
    assert {
        alike.coefficients[name].undefined for name in ("fleiss_kappa", "krippendorff_alpha")
    } == {ONE_CLASS}
    apart = agreement_of(same(2), same(2, CAPTURES[0]))
    assert apart.coefficients["percent"].undefined == NO_PAIRS
    assert apart.coefficients["fleiss_kappa"].undefined == NOT_COMPLETE
    assert apart.pairs[0].coefficients["cohen_kappa"].to_json() == {
        "value": None,
        "low": None,
        "high": None,
        "undefined": NO_PAIRS,
    }


def test_one_layer_or_none_is_refused() -> None:
    with pytest.raises(ScanLoomError, match="two layers"):
        agreement_of(noisy_layer(1, 0.1))
    with pytest.raises(ScanLoomError, match="none of the layers has a label"):
        agreement_of([], [])


def test_intervals_hold_the_value_and_narrow_with_the_captures() -> None:
    drawn = [noisy_layer(seed, 0.3) for seed in (1, 2, 3)]
    found = agreement_of(*drawn, resamples=400)
    few = agreement_of(*(layer[:6] for layer in drawn), resamples=400)
    one = agreement_of(*(layer[:1] for layer in drawn))
    for name, estimate in found.coefficients.items():
        assert estimate.value is not None
        assert estimate.low is not None
        assert estimate.high is not None
        assert estimate.low < estimate.value < estimate.high
        wide = few.coefficients[name]
        assert wide.low is not None
        assert wide.high is not None
        assert wide.high - wide.low > estimate.high - estimate.low
        assert one.coefficients[name].low is None
    again = agreement_of(*drawn, resamples=400)
    assert again.to_json() == found.to_json()
    other = agreement_of(*drawn, resamples=400, seed=1)
    assert other.coefficients != found.coefficients


def test_captures_are_resampled_whole() -> None:
    """Beams of one scan that all agree or all differ tell no more than one beam does."""
    agree = np.arange(30) % 2 == 0
    narrow, wide = (
        tuple(Capture("lidar", "/scan", number, 0, 1, width) for number in range(30))
        for width in (2, 40)
    )

    def interval(scans: tuple[Capture, ...]) -> tuple[float | None, float | None]:
        def layer(swap: bool) -> list[CaptureLabels]:
            return [
                CaptureLabels.of_image(
                    scan, (np.arange(scan.columns) + (swap and not same)).reshape(1, -1) % 2
                )
                for scan, same in zip(scans, agree, strict=True)
            ]

        percent = agreement_of(layer(False), layer(True), resamples=200).coefficients["percent"]
        return percent.low, percent.high

    assert interval(narrow) == interval(wide)


def test_the_coverage_of_the_interval() -> None:
    """Drawn again and again, about 95 % of the intervals hold the true percent agreement."""
    rng = np.random.default_rng(3)
    held = 0
    for draw in range(400):
        counts = np.zeros((60, 1, 4, 4))
        counts[:, 0, 0, 0] = rng.binomial(10, rng.beta(8, 2, 60))
        counts[:, 0, 0, 1] = 10 - counts[:, 0, 0, 0]
        none = np.zeros((60, 4, 4))
        sums = AgreementCounts(
            labels=np.zeros((60, 2, 5)),
            pairs=counts,
            complete=none,
            coincidences=none,
            runs=np.zeros((60, 1, 4, 4)),
        ).resampled(200, draw)
        low, high = np.quantile(percent_agreement(sums.pairs[1:, 0]), [0.025, 0.975])
        held += bool(low <= 0.8 <= high)
    assert 0.90 <= held / 400 <= 0.98


def test_the_confusion_has_the_first_layers_classes_in_its_rows() -> None:
    (pair,) = agreement_of(*(noisy_layer(seed, 0.4) for seed in (1, 2))).pairs
    first, second = (samples_of(noisy_layer(seed, 0.4)) for seed in (1, 2))
    expected = np.zeros((4, 4), dtype=int)
    for sample, code in first.items():
        expected[code, second[sample]] += 1
    np.testing.assert_array_equal(pair.confusion, expected)


def test_each_layer_is_compared_with_the_others_taken_for_one() -> None:
    drawn = [noisy_layer(seed, fraction) for seed, fraction in ((1, 0.1), (2, 0.1), (3, 0.6))]
    found = agreement_of(*drawn)
    first, second, third = (samples_of(layer) for layer in drawn)
    own = [code for code in third.values() for _ in range(2)]
    others = [code for sample in third for code in (first[sample], second[sample])]
    worst = found.layers["layer 2"]
    assert worst.coefficients["cohen_kappa"].value == pytest.approx(cohen_kappa_score(own, others))
    assert worst.labels["good"] == list(third.values()).count(Label.GOOD)
    percents = [layer.coefficients["percent"].value or 0.0 for layer in found.layers.values()]
    assert min(percents) == percents[2]
