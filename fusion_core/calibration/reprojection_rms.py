"""The error of a reprojection as one figure."""

import numpy as np

from fusion_core.model.conventions import FloatArray


def reprojection_rms(residuals_px: FloatArray) -> float:
    """Song 2022, (18), of (N, 2) residuals: sqrt(m_u² + m_v²) with the mean squares m_u², m_v²;
    NaN for no pairs."""
    if not len(residuals_px):
        return float("nan")
    return float(np.sqrt((residuals_px**2).mean(axis=0).sum()))
