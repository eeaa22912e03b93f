"""How much LiDAR and depth differ where nothing is wrong, as a function of range.

The noise of both sensors grows with range, so one threshold for all pairs is too wide at short
range and too narrow at long range. The scale is learned from the recording's own agreeing pairs;
epsilon is a multiple of it. The paper's E is inflated by the very noise that it should detect.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.robust import robust_sigma

# No pair of sensors agrees better; a scale of zero would make each rounding a disagreement.
_MIN_FLOOR_M = 1e-3
# Beyond so many standard deviations of DATASHEET_SCALE a pair is an outlier: of normal residuals
# one in two million is.
_OUTLIER_SIGMA = 5.0
# 25 pairs in each of eight bins: a median absolute deviation is then good to about a quarter.
_MIN_PAIRS = 200
_BINS = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseScale:
    """Standard deviation of a good pair's residual: sqrt(floor² + (fraction · range)²)."""

    floor_m: float
    fraction: float

    def sigma_at(self, range_m: FloatArray) -> FloatArray:
        """(N,) standard deviations at horizontal ranges."""
        return np.hypot(self.floor_m, self.fraction * range_m)

    def with_quantization(self, quantum_m: float | None) -> "NoiseScale":
        """No finer than depths in steps of ``quantum_m`` allow (None: steps that do not matter).

        A value anywhere within its step is off by quantum / sqrt(12) on average.
        """
        if quantum_m is None:
            return self
        return replace(self, floor_m=max(self.floor_m, quantum_m / np.sqrt(12.0)))


# What a URG-class LiDAR (1 % of range) and a structured-light camera state together; used where
# a recording has too few agreeing pairs to learn from.
DATASHEET_SCALE = NoiseScale(floor_m=0.015, fraction=0.012)


def learn_noise_scale(range_m: FloatArray, residual_m: FloatArray) -> NoiseScale:
    """Fit the scale to (N,) residuals by the median absolute deviation in bins of range.

    Returns DATASHEET_SCALE where fewer than 200 pairs are valid.
    """
    valid = np.isfinite(residual_m)
    # Outliers by the data sheets' scale are dropped first: conflicts and burrs are not noise.
    valid &= np.abs(residual_m) < _OUTLIER_SIGMA * DATASHEET_SCALE.sigma_at(
        np.where(valid, range_m, 0.0)
    )
    ranges, residuals = range_m[valid], residual_m[valid]
    if ranges.size < _MIN_PAIRS:
        return DATASHEET_SCALE
    edges = np.quantile(ranges, np.linspace(0.0, 1.0, _BINS + 1))
    squares = []
    for low, high in pairwise(edges):
        inside = (ranges >= low) & (ranges <= high)
        sd = robust_sigma(residuals[inside])
        squares.append([float(np.median(ranges[inside])) ** 2, sd**2])
    return _fit_line(squares)


def _fit_line(squares: Sequence[Sequence[float]]) -> NoiseScale:
    """Fit sd² = floor² + fraction² range² with neither term negative."""
    square_m2, variance_m2 = np.array(squares).T
    slope = offset = 0.0
    # Pairs at a single range do not determine the growth with range.
    if np.ptp(square_m2) > 1e-6 * square_m2.max():
        slope, offset = map(float, np.polyfit(square_m2, variance_m2, 1))
    if slope <= 0.0:
        floor_m, fraction = np.sqrt(variance_m2.mean()), 0.0
    elif offset <= 0.0:
        floor_m, fraction = 0.0, np.sqrt((square_m2 @ variance_m2) / (square_m2 @ square_m2))
    else:
        floor_m, fraction = np.sqrt(offset), np.sqrt(slope)
    return NoiseScale(floor_m=max(float(floor_m), _MIN_FLOOR_M), fraction=float(fraction))
