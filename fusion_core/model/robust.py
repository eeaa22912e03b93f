"""Robust scale: the standard deviation of a normal distribution from a median."""

import numpy as np

from fusion_core.model.conventions import FloatArray

MAD_TO_SIGMA = 1.4826
"""Standard deviation over median absolute deviation of a normal distribution, 1 / Φ⁻¹(3/4)."""

NORMAL_MEDIAN_ABS = 0.6745
"""Median absolute deviation of a unit normal distribution, Φ⁻¹(3/4)."""


def robust_sigma(residuals: FloatArray) -> float:
    """Standard deviation of (n,) residuals about zero from the median of their sizes, n >= 1."""
    return MAD_TO_SIGMA * float(np.median(np.abs(residuals)))
