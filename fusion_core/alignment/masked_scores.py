"""Xu 2024 eqs. (2) to (4) from the sums over the samples that a row and a curve both have."""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray, IntArray

PEARSON, COSINE, INVERSE_COSINE, EUCLIDEAN = range(4)


@compiled(error_model="numpy")
def score_row(
    scores: IntArray,
    sums: tuple[FloatArray, ...],
    row: tuple[float, float, float],
    curve: tuple[float, float, float],
    moved: FloatArray,
    field: FloatArray,
    v: int,
) -> None:
    """The scores of row ``v`` at U offsets, into ``field`` (len(scores), H, U).

    ``sums``: n, ΣD, ΣD², ΣL, ΣL² and ΣDL about the means, (U,) each; a score is NaN where n is.
    ``row``, ``curve``: the mean, and the sums of squares, about the mean and about zero, that count
    as none. ``moved``: (3, U) to work in.
    """
    mean_d, flat_d, zero_d = row
    mean_l, flat_l, zero_l = curve
    dd, ll, dl = moved[0], moved[1], moved[2]
    is_moved = False
    for k in range(len(scores)):
        out = field[k, v]
        if scores[k] == PEARSON:
            _pearson(sums, flat_d, flat_l, out)
            continue
        if not is_moved:
            _move_to_zero(sums, (mean_d, mean_l), (zero_d, zero_l), dd, ll, dl)
            is_moved = True
        if scores[k] == EUCLIDEAN:
            _euclidean(dd, ll, dl, out)
        else:
            _cosine(dd, ll, dl, out)
        if scores[k] == INVERSE_COSINE:
            for u in range(out.size):
                out[u] = 1.0 - out[u]


@compiled(error_model="numpy")
def _pearson(sums: tuple[FloatArray, ...], flat_d: float, flat_l: float, out: FloatArray) -> None:
    """Xu 2024 eq. (2)."""
    n, sum_d, sum_dd, sum_l, sum_ll, sum_dl = sums
    for u in range(out.size):
        inverse_n = 1.0 / n[u]
        spread_d = sum_dd[u] - inverse_n * sum_d[u] * sum_d[u]
        spread_l = sum_ll[u] - inverse_n * sum_l[u] * sum_l[u]
        score = (sum_dl[u] - inverse_n * sum_d[u] * sum_l[u]) / np.sqrt(spread_d * spread_l)
        score = min(1.0, max(-1.0, score))
        out[u] = score if (spread_d > flat_d) & (spread_l > flat_l) else np.nan


@compiled(error_model="numpy")
def _move_to_zero(
    sums: tuple[FloatArray, ...],
    means: tuple[float, float],
    zeros: tuple[float, float],
    dd: FloatArray,
    ll: FloatArray,
    dl: FloatArray,
) -> None:
    """ΣD², ΣL² and ΣDL about zero; ΣDL is NaN where one of the others counts as none."""
    n, sum_d, sum_dd, sum_l, sum_ll, sum_dl = sums
    mean_d, mean_l = means
    zero_d, zero_l = zeros
    for u in range(dd.size):
        dd[u] = sum_dd[u] + mean_d * (2.0 * sum_d[u] + n[u] * mean_d)
        ll[u] = sum_ll[u] + mean_l * (2.0 * sum_l[u] + n[u] * mean_l)
        product = sum_dl[u] + mean_d * sum_l[u] + mean_l * (sum_d[u] + n[u] * mean_d)
        dl[u] = product if (dd[u] > zero_d) & (ll[u] > zero_l) else np.nan


@compiled(error_model="numpy")
def _cosine(dd: FloatArray, ll: FloatArray, dl: FloatArray, out: FloatArray) -> None:
    for u in range(out.size):
        cosine = min(1.0, max(-1.0, dl[u] / np.sqrt(dd[u] * ll[u])))
        out[u] = cosine if dl[u] == dl[u] else np.nan


@compiled(error_model="numpy")
def _euclidean(dd: FloatArray, ll: FloatArray, dl: FloatArray, out: FloatArray) -> None:
    for u in range(out.size):
        square = max(0.0, dd[u] - 2.0 * dl[u] + ll[u])
        score = 1.0 - np.sqrt(square / max(dd[u], ll[u]))
        out[u] = score if dl[u] == dl[u] else np.nan
