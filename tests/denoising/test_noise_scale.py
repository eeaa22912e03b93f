"""The noise scale: simulated residuals of a known scale, and what must never come out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.denoising.noise_scale import DATASHEET_SCALE, NoiseScale, learn_noise_scale


def simulated(scale, *, count=6000, outliers=0.1, seed=0):
    """Residuals of a known scale, with outliers spread over four metres."""
    rng = np.random.default_rng(seed)
    range_m = rng.uniform(0.5, 5.5, count)
    residual_m = rng.normal(0.0, np.sqrt(scale.floor_m**2 + (scale.fraction * range_m) ** 2))
    outlier = rng.random(count) < outliers
    residual_m[outlier] = rng.uniform(-2.0, 2.0, outlier.sum())
    return range_m, residual_m


def test_the_scale_is_the_root_of_two_squares():
    scale = NoiseScale(floor_m=0.03, fraction=0.01)
    np.testing.assert_allclose(scale.sigma_at(np.array([0.0, 4.0])), [0.03, 0.05], rtol=1e-12)
    assert np.isnan(scale.sigma_at(np.array([np.nan]))).all()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("floor_m", [0.008, 0.02])
@pytest.mark.parametrize("fraction", [0.004, 0.015])
def test_floor_and_fraction_are_recovered_among_outliers(floor_m, fraction, seed):
    truth = NoiseScale(floor_m=floor_m, fraction=fraction)
    learned = learn_noise_scale(*simulated(truth, seed=seed))
    range_m = np.array([1.0, 2.0, 3.5, 5.0])
    # Outliers below the first threshold count as noise: a few percent more than the truth.
    np.testing.assert_allclose(learned.sigma_at(range_m), truth.sigma_at(range_m), rtol=0.15)


def test_without_outliers_the_parameters_themselves_are_near():
    truth = NoiseScale(floor_m=0.012, fraction=0.01)
    learned = learn_noise_scale(*simulated(truth, count=60_000, outliers=0.0))
    assert learned.floor_m == pytest.approx(truth.floor_m, rel=0.1)
    assert learned.fraction == pytest.approx(truth.fraction, rel=0.05)


def test_conflicts_far_beyond_the_noise_do_not_count():
    range_m, residual_m = simulated(DATASHEET_SCALE, outliers=0.0)
    with_conflicts = np.concatenate([residual_m, np.full(4000, 0.9)])
    ranges = np.concatenate([range_m, np.linspace(1.0, 5.0, 4000)])
    assert learn_noise_scale(ranges, with_conflicts) == learn_noise_scale(range_m, residual_m)


def test_constant_noise_has_no_fraction_and_proportional_noise_no_floor():
    rng = np.random.default_rng(4)
    range_m = rng.uniform(1.0, 5.0, 5000)
    shrinking = rng.normal(0.0, 0.03 - 0.004 * range_m)
    assert learn_noise_scale(range_m, shrinking).fraction == 0.0
    assert learn_noise_scale(range_m, shrinking).floor_m == pytest.approx(0.018, rel=0.15)
    steeper = rng.normal(0.0, 0.002 * range_m**2)
    learned = learn_noise_scale(range_m, steeper)
    assert learned.floor_m == pytest.approx(1e-3)
    assert 0.002 < learned.fraction < 0.010


@pytest.mark.parametrize("valid", [0, 1, 199])
def test_too_few_pairs_give_the_stated_scale(valid):
    range_m, residual_m = simulated(
        NoiseScale(floor_m=0.002, fraction=0.001), count=400, outliers=0.0
    )
    residual_m[valid:] = np.nan
    assert learn_noise_scale(range_m, residual_m) is DATASHEET_SCALE


def test_two_hundred_pairs_are_enough():
    range_m, residual_m = simulated(
        NoiseScale(floor_m=0.002, fraction=0.001), count=200, outliers=0.0
    )
    assert learn_noise_scale(range_m, residual_m) != DATASHEET_SCALE


@given(
    seed=st.integers(0, 10_000),
    count=st.integers(0, 500),
    spread=st.floats(0.0, 0.2),
    growth=st.floats(-2.0, 3.0),
)
def test_a_scale_is_positive_whatever_it_is_learned_from(seed, count, spread, growth):
    rng = np.random.default_rng(seed)
    range_m = rng.uniform(0.1, 10.0, count)
    residual_m = spread * rng.standard_normal(count) * range_m**growth
    residual_m[rng.random(count) < 0.1] = np.nan
    range_m[np.isnan(residual_m) & (rng.random(count) < 0.5)] = np.nan
    learned = learn_noise_scale(range_m, residual_m)
    assert learned.floor_m > 0.0
    assert learned.fraction >= 0.0


def test_a_room_without_noise_keeps_a_positive_floor():
    range_m = np.linspace(1.0, 5.0, 400)
    assert learn_noise_scale(range_m, np.zeros(400)).floor_m > 0.0


def test_a_single_range_gives_its_own_deviation():
    residual_m = np.random.default_rng(1).normal(0.0, 0.02, 2000)
    learned = learn_noise_scale(np.full(2000, 2.0), residual_m)
    assert float(learned.sigma_at(np.array([2.0]))[0]) == pytest.approx(0.02, rel=0.1)


@given(seed=st.integers(0, 10_000))
def test_the_order_of_the_pairs_does_not_matter(seed):
    range_m, residual_m = simulated(DATASHEET_SCALE, count=600, seed=seed)
    order = np.random.default_rng(seed).permutation(range_m.size)
    learned, shuffled = (
        learn_noise_scale(range_m, residual_m),
        learn_noise_scale(range_m[order], -residual_m[order]),
    )
    assert shuffled == learned


def test_coarse_depth_keeps_the_scale_above_its_steps():
    fine = NoiseScale(floor_m=0.004, fraction=0.01)
    rng = np.random.default_rng(0)
    true_m = rng.uniform(1.0, 1.2, 20_000)
    stored_m = 0.039 * (np.floor(true_m / 0.039) + 0.5)
    coarse = fine.with_quantization(0.039)
    assert coarse.floor_m == pytest.approx(np.std(stored_m - true_m), rel=0.02)
    assert coarse.fraction == fine.fraction
    assert coarse.with_quantization(0.001) == coarse
    assert fine.with_quantization(None) == fine
