"""Fig. 6 of Xu 2024: the recalls of good and of noise pairs over the threshold epsilon."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.associated_truth import AssociatedTruth, associate_truth
from fusion_core.evaluation.fuse_folder import (
    FuseFolder,
    open_fuse_folder,
    read_frames,
    read_samples,
)
from fusion_core.evaluation.pairs import PairKind, true_pairs
from fusion_core.evaluation.truth import Truth
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only

PAPER_BAND = (1.0, float(np.sqrt(2.0)))
"""Bounds of epsilon / E that Xu 2024 §2.3.2 gives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecallCurve:
    """Both recalls over epsilon / E, as counts, so that recordings can be pooled.

    ``factors``: (K,) values of epsilon / E. ``good_kept``, ``noise_found``: (K,) counts.
    """

    factors: FloatArray
    good_kept: IntArray
    noise_found: IntArray
    good_pairs: int
    noise_pairs: int

    def __post_init__(self) -> None:
        for array in (self.factors, self.good_kept, self.noise_found):
            if array.shape != self.factors.shape:
                raise ValueError("factors, good_kept and noise_found must have one length")
            read_only(array)

    def to_json(self) -> dict[str, Any]:
        """The curves as lists, None where there are no such pairs; ``band`` is the paper's."""
        return {
            "epsilon_over_E": self.factors.tolist(),
            "xi": _fractions(self.good_kept, self.good_pairs),
            "eta": _fractions(self.noise_found, self.noise_pairs),
            "good_pairs": self.good_pairs,
            "noise_pairs": self.noise_pairs,
            "band": list(PAPER_BAND),
        }


class RecallCounter:
    """Counts pairs as they come, as ``recall_over_epsilon`` thresholds them."""

    def __init__(self, factors: FloatArray) -> None:
        self._factors = factors
        self._kept = np.zeros(factors.shape, dtype=np.int64)
        self._found = np.zeros(factors.shape, dtype=np.int64)
        self._good_pairs = self._noise_pairs = 0

    def add(
        self,
        residual_m: FloatArray,
        mean_error_m: FloatArray,
        *,
        is_good: BoolArray,
        is_noise: BoolArray,
    ) -> None:
        """Add (n,) pairs, each with the E of its frame; both NaN where there is none."""
        epsilon_m = mean_error_m[:, np.newaxis] * self._factors
        residual_m = np.abs(residual_m)[:, np.newaxis]
        self._kept += (residual_m[is_good] <= epsilon_m[is_good]).sum(axis=0)
        self._found += (residual_m[is_noise] > epsilon_m[is_noise]).sum(axis=0)
        self._good_pairs += int(is_good.sum())
        self._noise_pairs += int(is_noise.sum())

    def curve(self) -> RecallCurve:
        """The curve of all pairs so far."""
        return RecallCurve(
            factors=self._factors.copy(),
            good_kept=self._kept.copy(),
            noise_found=self._found.copy(),
            good_pairs=self._good_pairs,
            noise_pairs=self._noise_pairs,
        )


def recall_over_epsilon(fuse_dir: Path, truth: Truth, factors: FloatArray) -> RecallCurve:
    """Threshold the recorded residuals at ``factors`` times each frame's own E.

    A good pair is kept where residual <= epsilon, a noise pair found where residual > epsilon: the
    paper's eq. (6) only, without what the classes take from neighbours and other frames. E is
    ``mean_error_m`` of the frame. A pair without a residual, or in a frame without an E, counts as
    neither. Raises as ``evaluate_noise``.
    """
    folder = open_fuse_folder(fuse_dir)
    associated = associate_truth(truth, folder)
    mean_error_m = _mean_errors_m(folder, associated)
    counter = RecallCounter(factors)
    for samples in read_samples(folder):
        row = samples.paired
        pairs = true_pairs(samples, associated)
        counter.add(
            samples.residual_m[row],
            mean_error_m[samples.camera[row], pairs.image],
            is_good=pairs.kind == PairKind.GOOD,
            is_noise=pairs.kind >= PairKind.LIDAR_BURR,
        )
    return counter.curve()


def pool_recall(curves: Sequence[RecallCurve]) -> RecallCurve:
    """One curve over the pairs of several recordings, which must share their factors."""
    factors = curves[0].factors
    if any(not np.array_equal(curve.factors, factors) for curve in curves):
        raise ValueError("curves over different factors cannot be pooled")
    return RecallCurve(
        factors=factors.copy(),
        good_kept=np.sum([curve.good_kept for curve in curves], axis=0),
        noise_found=np.sum([curve.noise_found for curve in curves], axis=0),
        good_pairs=sum(curve.good_pairs for curve in curves),
        noise_pairs=sum(curve.noise_pairs for curve in curves),
    )


def _mean_errors_m(folder: FuseFolder, associated: AssociatedTruth) -> FloatArray:
    """(cameras, images) E of each depth image in the truth's order, NaN where it has none."""
    frames = read_frames(folder)
    longest = max(camera.truth.stamp_ns.size for camera in associated.cameras)
    errors_m = np.full((len(associated.cameras), longest), np.nan)
    image = associated.image_index(frames.camera, frames.stamp_ns)
    errors_m[frames.camera, image] = frames.number["mean_error_m"]
    return errors_m


def _fractions(counts: IntArray, whole: int) -> list[float] | None:
    return (counts / whole).tolist() if whole else None
