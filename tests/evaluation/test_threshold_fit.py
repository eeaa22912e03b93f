"""A threshold fitted on labels: its score against a loop, its choice, and its interval."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.threshold_fit import ThresholdSweep, fit_threshold, in_fitted_half

VALUES = np.array([0.5, 1.0, 2.0, 3.0, 5.0])


def sweep_of(noise_m, good_m, *, values=VALUES, current=2):
    """Of residuals (F, n) of one side, noise where above a value; the other side has no labels."""
    shape = (noise_m.shape[0], values.size)
    nothing = np.zeros((*shape, 1), dtype=np.int64)
    found = (noise_m[:, np.newaxis, :] > values[:, np.newaxis]).sum(axis=-1)
    kept = (good_m[:, np.newaxis, :] <= values[:, np.newaxis]).sum(axis=-1)

    def count(of):
        return np.tile([of.shape[1], 0], (of.shape[0], 1))

    return ThresholdSweep(
        values=values.copy(),
        current=current,
        noise=count(noise_m),
        good=count(good_m),
        noise_found=np.concatenate([found[..., np.newaxis], nothing], axis=-1),
        good_kept=np.concatenate([kept[..., np.newaxis], nothing], axis=-1),
    )


COUNTS = st.integers(0, 4)


@given(st.data(), st.integers(1, 5), st.integers(1, 4))
def test_the_score_is_informedness_over_the_sides_that_have_both_kinds(data, scans, count) -> None:
    def drawn(shape, most=None):
        flat = data.draw(
            st.lists(COUNTS, min_size=int(np.prod(shape)), max_size=int(np.prod(shape)))
        )
        values = np.array(flat).reshape(shape)
        return values if most is None else np.minimum(values, most)

    noise, good = drawn((scans, 2)), drawn((scans, 2))
    shape = (scans, count, 2)
    found, kept = drawn(shape, noise[:, np.newaxis]), drawn(shape, good[:, np.newaxis])
    sweep = ThresholdSweep(
        values=np.arange(1.0, count + 1.0),
        current=0,
        noise=noise,
        good=good,
        noise_found=found,
        good_kept=kept,
    )
    weights = np.array(data.draw(st.lists(COUNTS, min_size=scans, max_size=scans)), dtype=float)
    for place, score in enumerate(sweep.scores(weights)):
        by_side = []
        for side in range(2):
            totals = [
                sum(weight * float(counts[scan]) for scan, weight in enumerate(weights))
                for counts in (
                    noise[:, side],
                    good[:, side],
                    found[:, place, side],
                    kept[:, place, side],
                )
            ]
            if totals[0] and totals[1]:
                by_side.append(totals[2] / totals[0] + totals[3] / totals[1] - 1.0)
        expected = np.mean(by_side) if by_side else np.nan
        np.testing.assert_allclose(score, expected, atol=1e-12)


def test_the_value_that_separates_is_found_and_tried_on_the_rest() -> None:
    rng = np.random.default_rng(3)
    # Good residuals below 1.0 and noise above 0.8: 1.0 separates best, and 2.0 is in use.
    good_m, noise_m = rng.uniform(0.0, 1.0, (64, 30)), rng.uniform(0.8, 4.0, (64, 10))
    fit = fit_threshold(sweep_of(noise_m, good_m))
    assert (fit.current, fit.value, fit.best) == (2.0, 1.0, 1.0)
    assert fit.low <= 1.0 <= fit.high
    assert fit.is_better
    tried = ~in_fitted_half(64)
    for score, threshold in ((fit.score_of_current, 2.0), (fit.score_of_value, 1.0)):
        by_hand = (noise_m[tried] > threshold).mean() + (good_m[tried] <= threshold).mean() - 1.0
        assert score == pytest.approx(by_hand, abs=1e-12)
    assert fit.score_of_best == fit.score_of_value
    assert (fit.fitted_scans, fit.tried_scans) == (32, 32)


def test_of_equally_good_values_the_one_in_use_stays() -> None:
    # Everything between 1.0 and 4.0 separates perfectly.
    good_m, noise_m = np.full((16, 4), 0.7), np.full((16, 4), 4.5)
    for current in (1, 2, 3):
        fit = fit_threshold(sweep_of(noise_m, good_m, current=current))
        assert fit.value == fit.current == fit.low == fit.high == VALUES[current]
        assert not fit.is_better
    assert fit_threshold(sweep_of(noise_m, good_m, current=4)).value == 3.0


def test_the_halves_are_blocks_of_time() -> None:
    for scans in (2, 7, 8, 9, 60, 1000):
        fitted = in_fitted_half(scans)
        assert fitted.any()
        assert not fitted.all()
        runs = np.flatnonzero(np.diff(fitted)).size + 1
        assert runs == min(8, scans)
        assert abs(int(fitted.sum()) - scans / 2) <= 4


def test_few_scans_have_a_wide_interval_and_many_a_narrow_one() -> None:
    rng = np.random.default_rng(5)
    values = np.linspace(0.1, 5.0, 99)

    def width(scans):
        good_m, noise_m = rng.exponential(1.0, (scans, 4)), rng.exponential(1.0, (scans, 4)) + 1.5
        fit = fit_threshold(sweep_of(noise_m, good_m, values=values, current=50))
        return fit.high - fit.low

    assert width(800) < 0.6 * width(16)


def test_labels_of_one_kind_tell_nothing() -> None:
    some = np.full((16, 4), 0.7)
    assert fit_threshold(sweep_of(np.empty((16, 0)), some)) is None
    assert fit_threshold(sweep_of(some, np.empty((16, 0)))) is None
