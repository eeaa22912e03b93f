"""The similarity field S[v, u] of Xu 2024 §2.2, eqs. (2)-(4): how well each depth row fits each
place of the LiDAR curve, over the samples that both have.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.alignment.centred_curves import CentredCurves, centre
from fusion_core.alignment.masked_products import scores_along_curve, scores_of_windows
from fusion_core.alignment.masked_scores import COSINE, EUCLIDEAN, INVERSE_COSINE, PEARSON
from fusion_core.model.conventions import Float32Array, FloatArray, read_only
from fusion_core.model.errors import AlignmentFailed

Metric = Literal["pearson", "cosine", "inverse_cosine", "euclidean"]

_KERNELS: dict[Metric, int] = {
    "pearson": PEARSON,
    "cosine": COSINE,
    "inverse_cosine": INVERSE_COSINE,
    "euclidean": EUCLIDEAN,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SimilarityField:
    """Scores of H depth rows at U offsets along the LiDAR curve.

    ``scores``: (H, U), NaN where there is no score; greater is better for every metric.
    ``overlap``: (H, U) fraction of the row's samples valid on both sides.
    ``u_first``: the offset u of column 0: 0, or negative with partial overlaps.
    ``turn_samples``: where the curve is a full circle, the offsets of one turn: the last column is
    beside the first.
    """

    scores: FloatArray
    overlap: FloatArray
    u_first: int
    turn_samples: float | None = None

    def __post_init__(self) -> None:
        if self.scores.ndim != 2 or self.scores.shape != self.overlap.shape:
            raise ValueError(
                f"scores and overlap must be (H, U), got {self.scores.shape}, {self.overlap.shape}"
            )
        read_only(self.scores)
        read_only(self.overlap)


def similarity_field(
    curve_m: FloatArray | Float32Array,
    rows_m: FloatArray | Float32Array,
    *,
    metric: Metric,
    min_overlap: float = 0.5,
    partial: bool = False,
) -> SimilarityField:
    """One metric's field; see :func:`similarity_fields`."""
    fields = similarity_fields(
        curve_m, rows_m, metrics=(metric,), min_overlap=min_overlap, partial=partial
    )
    return fields[metric]


def similarity_fields(
    curve_m: FloatArray | Float32Array,
    rows_m: FloatArray | Float32Array | CentredCurves,
    *,
    metrics: Sequence[Metric],
    min_overlap: float = 0.5,
    partial: bool = False,
    turn_samples: float | None = None,
) -> dict[Metric, SimilarityField]:
    """The fields of several metrics, from the same sums.

    ``curve_m``: (Ψ,) LiDAR samples, ``rows_m``: (H, W) depth samples, both left to right in metres,
    NaN where missing; rows that are compared with several curves are centred before. Sample w of a
    row lies on sample u + w of the curve; each score is over the pairs that are valid on both
    sides:

    * ``pearson``: Xu 2024 eq. (2), in [-1, 1];
    * ``cosine``: D·L / (‖D‖ ‖L‖);
    * ``inverse_cosine``: 1 - cosine, eq. (3) as printed: a dissimilarity that the paper maximises;
    * ``euclidean``: 1 - ‖D - L‖ / max(‖D‖, ‖L‖), eq. (4).

    There is no score (NaN) where fewer than ``min_overlap`` of the row's W samples are valid on
    both sides, where a side is constant (Pearson) or all zero (the others).

    ``turn_samples``: of a curve that is a full circle, as in SimilarityField.

    u runs over 0 … Ψ - W, or with ``partial`` from ``k - W`` to ``Ψ - k``, where k is the least
    number of samples that ``min_overlap`` asks for, at least 1.

    Raises ValueError for arrays of the wrong shape or a ``min_overlap`` outside [0, 1], and
    AlignmentFailed where the curve is too short for any offset.
    """
    shape = rows_m.values.shape if isinstance(rows_m, CentredCurves) else rows_m.shape
    if curve_m.ndim != 1 or len(shape) != 2 or 0 in shape:
        raise ValueError(f"need a (Ψ,) curve and (H, W) rows, got {curve_m.shape}, {shape}")
    width = shape[1]
    min_samples = _min_samples(min_overlap, width)
    shortest = min_samples if partial else width
    if curve_m.size < shortest:
        raise AlignmentFailed(
            f"the LiDAR curve has {curve_m.size} samples, a depth row of {width} needs {shortest}.",
            advice="Sample the curve finer or the rows coarser, or allow partial overlaps.",
        )
    margin = width - min_samples if partial else 0
    curve = curve_m.astype(np.float64, copy=False)
    if margin:
        curve = np.pad(curve, margin, constant_values=np.nan)
    if not isinstance(rows_m, CentredCurves):
        rows_m = centre(rows_m.astype(np.float64, copy=False))
    kernels = [_KERNELS[metric] for metric in metrics]
    scores, overlap = scores_along_curve(curve, rows_m, kernels, min_samples)
    return {
        metric: SimilarityField(
            scores=score, overlap=overlap, u_first=-margin, turn_samples=turn_samples
        )
        for metric, score in zip(metrics, scores, strict=True)
    }


def similarity_of_windows(
    curves_m: FloatArray,
    rows: CentredCurves,
    *,
    metrics: Sequence[Metric],
    min_overlap: float = 0.5,
) -> list[dict[Metric, SimilarityField]]:
    """The fields of K short curves, (K, Ψ) with W <= Ψ, over the same rows: ``similarity_fields``
    without partial overlaps. For few offsets: it then takes a fraction of the time.
    """
    kernels = [_KERNELS[metric] for metric in metrics]
    min_samples = _min_samples(min_overlap, rows.width)
    scores, overlap = scores_of_windows(curves_m, rows, kernels, min_samples)
    fields = []
    for k in range(curves_m.shape[0]):
        seen = overlap[:, k].copy()
        fields.append(
            {
                metric: SimilarityField(scores=scores[i, :, k].copy(), overlap=seen, u_first=0)
                for i, metric in enumerate(metrics)
            }
        )
    return fields


def _min_samples(min_overlap: float, width: int) -> int:
    """How many of a row's samples must be valid on both sides."""
    if not 0.0 <= min_overlap <= 1.0:
        raise ValueError(f"min_overlap must lie in [0, 1], got {min_overlap}")
    # The tolerance keeps a product such as 0.55 * 100 from being rounded up to 56.
    return max(1, math.ceil(min_overlap * width - 1e-9))
