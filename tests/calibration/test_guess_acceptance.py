"""What of the way to a refined pose is taken: against drawn truths, and in closed form."""

import numpy as np
import pytest

from fusion_core.calibration.refinement.guess_acceptance import best_candidate, make_candidates

ROTATION, TRANSLATION = np.arange(6) < 3, np.arange(6) >= 3
SDS = np.repeat([0.003, 0.03], 3)
RISK_MAX = 0.02


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A mean some deviations from the guess, its covariance, and an image's metric."""
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(6, 9)) * SDS[:, np.newaxis]
    sight = rng.normal(size=(40, 6)) * np.repeat([1.0, 0.1], 3)
    mean = rng.normal(size=6) * np.repeat([0.02, 0.08], 3)
    return mean, half @ half.T / 9.0, sight.T @ sight / 40.0


@pytest.mark.parametrize("seed", range(6))
def test_truths_are_rarely_nearer_to_the_guess_than_to_what_is_chosen(seed: int) -> None:
    mean, covariance, metric = drawn(seed)
    chosen = best_candidate(
        make_candidates(mean, covariance, metric), mean, covariance, metric, RISK_MAX
    )
    assert chosen is not None
    truths = np.random.default_rng(100 + seed).multivariate_normal(mean, covariance, 50_000)
    for by in (metric, np.diag(1.0 * ROTATION), np.diag(1.0 * TRANSLATION)):
        left = truths - chosen.error
        worse = np.einsum("ni,ij,nj->n", left, by, left) > np.einsum(
            "ni,ij,nj->n", truths, by, truths
        )
        # Four deviations of the drawn share.
        assert worse.mean() <= RISK_MAX + 4.0 * np.sqrt(RISK_MAX / 50_000)


def test_translations_are_means_with_a_further_prior_about_the_guess() -> None:
    mean, covariance, metric = drawn(9)
    V = covariance[3:, 3:]
    found = make_candidates(mean, covariance, metric)
    np.testing.assert_array_equal(found[0].error, mean)
    assert found[0].note == ""
    assert np.array_equal(found[-1].error[3:], np.zeros(3))
    assert "Translation stays at the guess" in found[-1].note
    for candidate in found[:-9]:
        # t = (V⁻¹ + k I)⁻¹ V⁻¹ μ for some k >= 0: V⁻¹ (μ - t) = k t.
        push = np.linalg.solve(V, mean[3:] - candidate.error[3:])
        k = push @ candidate.error[3:] / (candidate.error[3:] @ candidate.error[3:])
        assert k >= -1e-9
        np.testing.assert_allclose(push, k * candidate.error[3:], rtol=1e-6, atol=1e-6)


def test_a_sure_result_is_taken_whole_and_one_of_nothing_not_at_all() -> None:
    mean, covariance, metric = drawn(3)
    sure = make_candidates(mean, 1e-6 * covariance, metric)
    chosen = best_candidate(sure, mean, 1e-6 * covariance, metric, RISK_MAX)
    assert chosen is not None
    np.testing.assert_array_equal(chosen.error, mean)
    doubtful = make_candidates(1e-3 * mean, covariance, metric)
    assert best_candidate(doubtful, 1e-3 * mean, covariance, metric, RISK_MAX) is None
