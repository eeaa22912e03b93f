"""What a bias of the evidence does to a pose: the closed forms of normal distributions."""

import numpy as np
import pytest

from fusion_core.calibration.refinement.guess_acceptance import Candidate, best_candidate
from fusion_core.calibration.refinement.guess_uncertainty import (
    EvidenceShape,
    bearing_bias,
    risk_of_worse,
)


def positive(rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    half = rng.normal(size=(6, 8))
    return scale * half @ half.T


@pytest.mark.parametrize("seed", range(3))
def test_without_bias_the_minimum_is_the_mean_and_the_covariance_the_sandwich(seed: int) -> None:
    rng = np.random.default_rng(seed)
    curvature, scatter, precision, weight = positive(rng), positive(rng), positive(rng), 0.3
    shape = EvidenceShape(curvature=curvature, scatter=scatter)
    gain, covariance = shape.posterior(precision, weight, np.zeros((6, 6)))
    inverse = np.linalg.inv(weight * curvature + precision)
    np.testing.assert_allclose(gain, np.eye(6), atol=1e-9)
    expected = inverse @ (weight**2 * scatter + precision) @ inverse
    np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_bias_is_added_to_the_noise_of_a_measurement(seed: int) -> None:
    # A measurement m = y + b + n of y ~ N(0, P⁻¹), by Kalman's gain.
    rng = np.random.default_rng(seed)
    information, precision, bias, weight = positive(rng), positive(rng), positive(rng, 0.1), 0.4
    shape = EvidenceShape(curvature=information / weight, scatter=information / weight**2)
    gain, covariance = shape.posterior(precision, weight, bias)
    prior = np.linalg.inv(precision)
    kalman = prior @ np.linalg.inv(prior + np.linalg.inv(information) + bias)
    measured = rng.normal(size=6)
    minimum = np.linalg.solve(information + precision, information @ measured)
    np.testing.assert_allclose(gain @ minimum, kalman @ measured, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(covariance, prior - kalman @ prior, rtol=1e-6, atol=1e-9)


def test_evidence_of_nothing_leaves_the_prior() -> None:
    rng = np.random.default_rng(4)
    precision = positive(rng)
    nothing = EvidenceShape(curvature=np.zeros((6, 6)), scatter=np.zeros((6, 6)))
    _, covariance = nothing.posterior(precision, 0.3, positive(rng))
    np.testing.assert_allclose(covariance, np.linalg.inv(precision), rtol=1e-9)


def test_a_bias_moves_the_image_by_no_more_than_where_an_edge_lies_between_beams() -> None:
    rng = np.random.default_rng(5)
    metric = positive(rng)
    spacing = 0.003
    anywhere = np.var(rng.uniform(0.0, spacing, 100_000))
    root = np.linalg.cholesky(bearing_bias(metric, spacing / np.sqrt(12.0)))
    for direction in rng.normal(size=(5, 6)):
        error = root @ (direction / np.linalg.norm(direction))
        assert error @ metric @ error == pytest.approx(anywhere, rel=0.02)


def test_a_part_of_the_way_is_the_lesser_risk() -> None:
    mean, covariance = np.array([0.0, 0.0, 0.0, 3.0, 0.0, 0.0]), np.eye(6)
    shares = np.array([1.0, 0.75, 0.5, 0.25])
    risks = [risk_of_worse(share * mean, mean, covariance, np.eye(6)) for share in shares]
    assert np.all(np.diff(risks) < 0.0)
    candidates = [
        Candidate(error=share * mean, note="", risk={"translation": risk})
        for share, risk in zip(shares, risks, strict=True)
    ]
    chosen = best_candidate(candidates, mean, covariance, np.eye(6), 0.02)
    assert chosen is not None
    # The truth lies (2 - share) 3 / 2 standard deviations on this side: above 2.05 by a half.
    np.testing.assert_array_equal(chosen.error, 0.5 * mean)
