"""Draws: fair samples, the number that is needed, and a replay that equals the original."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare

from fusion_core.registration import ransac
from fusion_core.registration.draws import count_draws_needed, draw_samples
from fusion_core.registration.models import MODELS, fit_transform
from fusion_core.registration.ransac import RegistrationSettings, register


@given(
    pairs=st.integers(2, 60), fraction=st.floats(0.0, 1.0), draws=st.integers(1, 30), data=st.data()
)
def test_a_sample_has_distinct_pairs_of_those_given(pairs, fraction, draws, data):
    size = max(1, round(fraction * pairs))
    samples = draw_samples(pairs, size, draws, (data.draw(st.integers(0, 2**40)), 0))
    assert samples.shape == (draws, size)
    assert samples.min() >= 0
    assert samples.max() < pairs
    assert all(len(set(sample)) == size for sample in samples.tolist())


def test_each_subset_is_equally_likely():
    samples = draw_samples(6, 3, 20_000, (7, 0))
    seen = Counter(tuple(sorted(sample)) for sample in samples.tolist())
    assert len(seen) == 20
    assert chisquare(list(seen.values())).pvalue > 0.001


def test_the_number_of_draws_of_the_paper():
    assert np.ceil(count_draws_needed(0.6, 6, 0.975)) == 78
    assert np.ceil(count_draws_needed(0.6, 6, 1.0 - np.exp(-4.0))) == 84
    assert count_draws_needed(0.0, 6, 0.99) == np.inf
    assert count_draws_needed(1.0, 6, 0.99) == 1.0


def test_the_draws_contain_a_clean_one_with_the_confidence():
    """Brute force: 60 good of 100 pairs, draws of 3, clean by their indices."""
    draws = int(np.ceil(count_draws_needed(0.6, 3, 0.9)))
    held = [(draw_samples(100, 3, draws, (seed, 0)) < 60).all(axis=1).any() for seed in range(2000)]
    # Draws without replacement are clean a little less often than c to the n: 0.211 for 0.216.
    assert np.mean(held) == pytest.approx(1.0 - (1.0 - 0.2116) ** draws, abs=0.02)


def noisy_pairs(count=90, fraction=0.4, seed=5):
    rng = np.random.default_rng(seed)
    lidar = rng.uniform([-2.0, 1.0], [2.0, 5.0], size=(count, 2))
    depth = lidar + np.array([0.05, -0.03]) + rng.normal(0.0, 0.01, (count, 2))
    burr = rng.random(count) < fraction
    depth[burr] += rng.normal(0.0, 1.0, (burr.sum(), 2))
    lidar[3] = np.nan
    depth[17, 1] = np.nan
    return lidar, depth


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("stopping", ["fixed", "adaptive"])
def test_a_replay_equals_the_original_draws(model, stopping, monkeypatch):
    originals = []

    def recorded(*arguments):
        found = ransac_evaluate(*arguments)
        originals.append((arguments[3], *found))
        return found

    ransac_evaluate = ransac.evaluate_samples
    monkeypatch.setattr(ransac, "evaluate_samples", recorded)
    lidar, depth = noisy_pairs()
    settings = RegistrationSettings(
        model=model, stopping=stopping, draws=50, draws_max=130, confidence=0.9999, seed=9
    )
    result = register(lidar, depth, settings)
    samples, A, agree = (np.concatenate(parts) for parts in zip(*originals, strict=True))
    valid = np.flatnonzero(np.isfinite(lidar[:, 0]) & np.isfinite(depth[:, 1]))

    assert len(result.draws) == len(samples) == (50 if stopping == "fixed" else 130)
    for i, draw in enumerate(result.draws):
        assert draw.index == i
        np.testing.assert_array_equal(draw.pairs, valid[samples[i]])
        np.testing.assert_array_equal(draw.A, A[i])
        np.testing.assert_array_equal(np.flatnonzero(draw.is_inlier), valid[agree[i]])
        assert draw.inliers == agree[i].sum()
    for i in (0, 49, len(result.draws) - 1, -1):
        np.testing.assert_array_equal(result.draws[i].A, A[i])
    with pytest.raises(IndexError, match="of"):
        result.draws[len(result.draws)]

    most = max(draw.inliers for draw in result.draws)
    assert result.draws[result.best_draw].inliers == most


def test_a_draw_is_what_its_pairs_say():
    lidar, depth = noisy_pairs()
    result = register(lidar, depth, RegistrationSettings(model="affine"))
    for draw in list(result.draws)[:20]:
        alone = fit_transform("affine", lidar[draw.pairs], depth[draw.pairs]).A
        np.testing.assert_allclose(draw.A, alone, atol=1e-8)
        distance = [
            np.hypot(*((np.array([*a, 1.0]) @ alone)[:2] - b))
            for a, b in zip(lidar, depth, strict=True)
        ]
        np.testing.assert_array_equal(draw.is_inlier, np.array(distance) <= 0.10)
