"""The robust standard deviation against normal samples with and without outliers."""

import numpy as np
import pytest
from scipy.stats import norm

from fusion_core.model.robust import MAD_TO_SIGMA, NORMAL_MEDIAN_ABS, robust_sigma


def test_the_constants_are_those_of_the_normal_distribution():
    assert pytest.approx(norm.ppf(0.75), abs=5e-5) == NORMAL_MEDIAN_ABS
    assert pytest.approx(1.0 / norm.ppf(0.75), abs=5e-5) == MAD_TO_SIGMA


def test_outliers_hardly_change_it():
    residuals = np.random.default_rng(1).normal(0.0, 0.02, 10_000)
    assert robust_sigma(residuals) == pytest.approx(0.02, rel=0.03)
    residuals[:500] = 100.0
    assert robust_sigma(residuals) == pytest.approx(0.02, rel=0.1)
