"""Robust scale: the standard deviation of a normal distribution from a median; Welsch's weights."""

import numpy as np

from fusion_core.model.conventions import FloatArray

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution, 1 / Φ⁻¹(3/4)."""

NORMAL_MEDIAN_ABS = 0.6745
"""Median absolute deviation of a unit normal distribution, Φ⁻¹(3/4)."""

WELSCH_SD = 2.985
"""Where the weight is 1 / e in standard deviations: Welsch's weights then have 95 % efficiency."""


def welsch_weight(residuals: FloatArray, sigma: FloatArray | float) -> FloatArray:
    """(n,) Welsch's weights of (n,) residuals with standard deviation ``sigma``, 1 at zero."""
    weight: FloatArray = np.exp(-((residuals / sigma / WELSCH_SD) ** 2))
    return weight


def robust_sigma(residuals: FloatArray) -> float:
    """Standard deviation of (n,) residuals about zero from the median of their sizes, n >= 1."""
    return MAD_TO_SIGMA * float(np.median(np.abs(residuals)))
