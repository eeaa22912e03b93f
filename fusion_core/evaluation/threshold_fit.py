"""A threshold fitted on labelled scans, with an interval, and tried on scans that were left out.

The score is informedness (Youden 1950), noise recall + good recall - 1: 0 for guessing, 1 without a
mistake, however rare noise is. It is the mean over the sides, LiDAR and depth, that have labels of
both kinds.

Scans that follow each other show the same places, so halves of single scans would be fitted and
tried on the same; they are of whole blocks of time instead. The interval is that of the fitted
value, over resampled scans (Efron 1979).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only

# Set by hand: enough that both halves see all parts of a drive, each long against a scan.
_BLOCKS = 8
_RESAMPLES = 1000
_CONFIDENCE = 0.95
# Scores closer than this are equal, and of equal ones the nearest to the value in use is taken.
_SAME_SCORE = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThresholdSweep:
    """What becomes of the labelled samples under each value of a setting.

    ``values``: (C,) ascending; ``current``: the number of the one in use. ``noise``, ``good``:
    (F, 2) samples of each scan and side that a person calls noise, and that they call real.
    ``noise_found``, ``good_kept``: (F, C, 2) those on which each value agrees. Scans are in the
    order of time.
    """

    values: FloatArray
    current: int
    noise: IntArray
    good: IntArray
    noise_found: IntArray
    good_kept: IntArray

    def __post_init__(self) -> None:
        scans, count = self.noise.shape[0], self.values.size
        if self.noise.shape != (scans, 2) or self.good.shape != (scans, 2):
            raise ValueError("noise and good must be (F, 2)")
        if not self.noise_found.shape == self.good_kept.shape == (scans, count, 2):
            raise ValueError("noise_found and good_kept must be (F, C, 2)")
        for array in (self.values, self.noise, self.good, self.noise_found, self.good_kept):
            read_only(array)

    def scores(self, weights: FloatArray) -> FloatArray:
        """(..., C) informedness of each value over scans that count (..., F) times; NaN where no
        side has labels of both kinds."""
        with np.errstate(invalid="ignore", divide="ignore"):
            found = np.tensordot(weights, self.noise_found, axes=1)
            kept = np.tensordot(weights, self.good_kept, axes=1)
            by_side = found / (weights @ self.noise)[..., np.newaxis, :]
            by_side = by_side + kept / (weights @ self.good)[..., np.newaxis, :] - 1.0
            known = np.isfinite(by_side)
            mean: FloatArray = np.where(known, by_side, 0.0).sum(axis=-1) / known.sum(axis=-1)
        return mean


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdFit:
    """A fitted threshold. ``low``, ``high``: its 95 % interval. Scores are informedness over the
    scans left out: of the value in use, of the fitted one, and of ``best``, the value that would
    have been best there."""

    current: float
    value: float
    low: float
    high: float
    score_of_current: float
    score_of_value: float
    best: float
    score_of_best: float
    fitted_scans: int
    tried_scans: int

    @property
    def is_better(self) -> bool:
        """Whether the fitted value does better on the scans that were left out."""
        return self.score_of_value > self.score_of_current

    def to_json(self) -> dict[str, Any]:
        """Values, scores and counts by name."""
        return {
            "current": self.current,
            "value": self.value,
            "interval": [self.low, self.high],
            "held_out": {
                "current": self.score_of_current,
                "value": self.score_of_value,
                "best": self.score_of_best,
                "best_value": self.best,
                "scans": self.tried_scans,
            },
            "fitted_scans": self.fitted_scans,
        }


def fit_threshold(sweep: ThresholdSweep, seed: int = 0) -> ThresholdFit | None:
    """The value of the best score over one half of the scans, tried on the other half.

    None where either half has no side with labels of both kinds.
    """
    fitted = in_fitted_half(sweep.noise.shape[0])
    own, others = (
        sweep.scores(fitted.astype(np.float64)),
        sweep.scores((~fitted).astype(np.float64)),
    )
    if np.isnan(own).any() or np.isnan(others).any():
        return None
    value, best = _best(own, sweep), _best(others, sweep)
    low, high = _interval(sweep, np.flatnonzero(fitted), seed)
    return ThresholdFit(
        current=float(sweep.values[sweep.current]),
        value=float(sweep.values[value]),
        low=low,
        high=high,
        score_of_current=float(others[sweep.current]),
        score_of_value=float(others[value]),
        best=float(sweep.values[best]),
        score_of_best=float(others[best]),
        fitted_scans=int(fitted.sum()),
        tried_scans=int((~fitted).sum()),
    )


def in_fitted_half(scans: int) -> BoolArray:
    """(F,) whether a scan is fitted on: every second block of time."""
    blocks = min(_BLOCKS, scans)
    fitted: BoolArray = np.arange(scans) * blocks // max(scans, 1) % 2 == 0
    return fitted


def _best(scores: FloatArray, sweep: ThresholdSweep) -> int:
    """The number of the best value; of equally good ones the nearest to the one in use."""
    good = np.flatnonzero(scores >= np.nanmax(scores) - _SAME_SCORE)
    return int(good[np.argmin(np.abs(good - sweep.current))])


def _interval(sweep: ThresholdSweep, fitted: IntArray, seed: int) -> tuple[float, float]:
    """Percentiles of the value fitted on resampled scans; resamples without both kinds of labels
    are left out."""
    rng = np.random.default_rng(seed)
    weights = np.zeros((_RESAMPLES, sweep.noise.shape[0]))
    drawn = rng.choice(fitted, size=(_RESAMPLES, fitted.size))
    np.add.at(weights, (np.arange(_RESAMPLES)[:, np.newaxis], drawn), 1.0)
    scores = sweep.scores(weights)
    defined = scores[~np.isnan(scores).any(axis=1)]
    values = sweep.values[[_best(own, sweep) for own in defined]]
    tail = 0.5 * (1.0 - _CONFIDENCE)
    low, high = np.quantile(values, (tail, 1.0 - tail), method="inverted_cdf")
    return float(low), float(high)
