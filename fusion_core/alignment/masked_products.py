"""The sums over jointly valid samples behind every masked similarity, fused with the scores.

The score of row D at an offset of the curve L needs six sums over the samples that both sides
have: n, ΣD, ΣD², ΣL, ΣL² and ΣDL. With holes as zeros, ΣDL is one matrix product for the whole
field. In the other five at least one factor is a mask, and a mask is a few runs of holes: each sum
is a total less one difference of cumulative sums for each run. Where holes come in runs that costs
a fraction of five further products; with every other sample missing, the worst case, twice as much.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray

PEARSON, COSINE, INVERSE_COSINE, EUCLIDEAN = range(4)

# Squares that sum to less than this fraction of those of the whole row (or curve) are rounding, not
# signal: over 10⁴ samples the cumulative sums are good to about 10⁻¹³ of their total.
_NEGLIGIBLE = 1e-12


class _CentredCurves(NamedTuple):
    """H curves of N samples, each less the mean of its valid samples, holes as 0.

    ``values``: (H, N). ``means``: (H,). ``runs``: (K, 2) first hole and first valid sample after
    it; those of curve v are ``first_run[v]`` up to ``first_run[v + 1]``. ``flat`` and ``zero``:
    (H,) sums of squares, about the mean and about zero, that count as none.
    """

    values: FloatArray
    means: FloatArray
    runs: IntArray
    first_run: IntArray
    flat: FloatArray
    zero: FloatArray


def masked_scores(
    curve: FloatArray, rows: FloatArray, scores: Sequence[int], min_samples: int
) -> tuple[FloatArray, FloatArray]:
    """Score each row at each offset along the curve, over the samples valid on both sides.

    ``curve``: (Ψ,), ``rows``: (H, W) with W <= Ψ, NaN where missing. ``scores``: any of
    ``PEARSON``, ``COSINE``, ``INVERSE_COSINE``, ``EUCLIDEAN``.

    Returns (len(scores), H, Ψ - W + 1) scores and the (H, Ψ - W + 1) fraction of a row's samples
    that are valid on both sides. A score is NaN where there are fewer than ``min_samples`` or
    where either side has no variance (Pearson) or no norm (the others).
    """
    along, across = _centre(curve[np.newaxis]), _centre(rows)
    line = along.values[0]
    cumulative = np.array(
        [_cumulative(np.isfinite(curve)), _cumulative(line), _cumulative(line**2)]
    )
    # windows[w, u] = line[w + u]
    windows = np.ascontiguousarray(sliding_window_view(line, line.size - rows.shape[1] + 1))
    field, overlap = _score_rows(
        along,
        cumulative,
        across,
        across.values @ windows,
        np.array(scores, dtype=np.int64),
        min_samples,
    )
    return field, overlap


def _centre(curves: FloatArray) -> _CentredCurves:
    """Centring keeps a small variance that sits on a large offset."""
    height, width = curves.shape
    values, hole, counts, means, squares = _centre_rows(curves)
    edges = np.flatnonzero(hole[:, 1:] != hole[:, :-1]).reshape(-1, 2)
    return _CentredCurves(
        values=values,
        means=means,
        runs=edges % (width + 1),
        first_run=np.searchsorted(edges[:, 0], np.arange(height + 1) * (width + 1)),
        # The mean is rounded too, so a constant row is constant only relative to its mean.
        flat=_NEGLIGIBLE * (squares + _NEGLIGIBLE * counts * means**2),
        zero=_NEGLIGIBLE * (squares + counts * means**2),
    )


# Sums in any order, so that they are vectorised; not-a-number keeps its meaning.
@compiled(error_model="numpy", fastmath={"reassoc"})
def _centre_rows(
    curves: FloatArray,
) -> tuple[FloatArray, BoolArray, IntArray, FloatArray, FloatArray]:
    """Centred values (0 in holes), holes with one False at either end, counts, means, squares."""
    height, width = curves.shape
    values, hole = np.empty((height, width)), np.zeros((height, width + 2), dtype=np.bool_)
    counts = np.zeros(height, dtype=np.int64)
    means, squares = np.zeros(height), np.zeros(height)
    for v in range(height):
        curve, out = curves[v], values[v]
        total, holes = 0.0, 0
        for w in range(width):
            missing = not np.isfinite(curve[w])
            total += 0.0 if missing else curve[w]
            holes += missing
            hole[v, w + 1] = missing
        counts[v] = width - holes
        mean = total / max(counts[v], 1)
        square = 0.0
        for w in range(width):
            out[w] = curve[w] - mean if np.isfinite(curve[w]) else 0.0
            square += out[w] * out[w]
        means[v], squares[v] = mean, square
    return values, hole, counts, means, squares


def _cumulative(values: FloatArray) -> FloatArray:
    """(N + 1,) sums of the first 0 … N values."""
    return np.concatenate([[0.0], np.cumsum(values, dtype=np.float64)])


@compiled(error_model="numpy")
def _score_rows(
    along: _CentredCurves,
    cumulative: FloatArray,
    across: _CentredCurves,
    products: FloatArray,
    scores: IntArray,
    min_samples: int,
) -> tuple[FloatArray, FloatArray]:
    """The five sums of each row at every offset, and its scores from them.

    ``cumulative``: (3, Ψ + 1) sums of the curve's mask, values and squares. ``products``: (H, U)
    ΣDL. The sums of one row are (U,) each and stay in the processor's cache.
    """
    height, offsets = products.shape
    width = across.values.shape[1]
    windows = cumulative[:, width:] - cumulative[:, :offsets]
    n, sum_l, sum_ll = np.empty(offsets), np.empty(offsets), np.empty(offsets)
    sum_d, sum_dd = np.empty(offsets), np.empty(offsets)
    field = np.empty((len(scores), height, offsets))
    overlap = np.empty((height, offsets))
    for v in range(height):
        holes = across.runs[across.first_run[v] : across.first_run[v + 1]]
        _sum_curve(cumulative, windows, holes, n, sum_l, sum_ll)
        _sum_row(across.values[v], along.runs, sum_d, sum_dd)
        for u in range(offsets):
            overlap[v, u] = n[u] / width
            if n[u] < min_samples:
                n[u] = np.nan  # So is every score that is made from it.
        for k in range(len(scores)):
            sums = n, sum_d, sum_dd, sum_l, sum_ll, products[v]
            if scores[k] == PEARSON:
                _pearson(sums, across.flat[v], along.flat[0], field[k, v])
            else:
                _about_zero(
                    scores[k],
                    sums,
                    (across.means[v], along.means[0]),
                    (across.zero[v], along.zero[0]),
                    field[k, v],
                )
    return field, overlap


@compiled()
def _subtract_run(sums: FloatArray, cumulative: FloatArray, start: int, end: int) -> None:
    """Take from the sum at each offset what lies in a run [start, end) that moves with it."""
    upto_start = cumulative[start : start + sums.size]
    upto_end = cumulative[end : end + sums.size]
    for u in range(sums.size):
        sums[u] -= upto_end[u] - upto_start[u]


@compiled()
def _sum_curve(
    cumulative: FloatArray,
    windows: FloatArray,
    holes: IntArray,
    n: FloatArray,
    sum_l: FloatArray,
    sum_ll: FloatArray,
) -> None:
    """n, ΣL, ΣL² at each offset: those of the whole window less those below the row's holes."""
    n[:], sum_l[:], sum_ll[:] = windows[0], windows[1], windows[2]
    for k in range(len(holes)):
        _subtract_run(n, cumulative[0], holes[k, 0], holes[k, 1])
        _subtract_run(sum_l, cumulative[1], holes[k, 0], holes[k, 1])
        _subtract_run(sum_ll, cumulative[2], holes[k, 0], holes[k, 1])


@compiled()
def _sum_row(row: FloatArray, holes: IntArray, sum_d: FloatArray, sum_dd: FloatArray) -> None:
    """ΣD, ΣD² at each offset: those of the whole row less those below the curve's holes.

    As the offset rises a hole of the curve moves to the left along the row, so the cumulative
    sums are laid out backwards: index ``margin + width - w`` holds the sum of the first w samples.
    The margins let a run reach over either end of the row.
    """
    width, offsets = row.size, sum_d.size
    margin = 0
    for k in range(len(holes)):
        margin = max(margin, holes[k, 1] - holes[k, 0])
    below, below_squares = np.zeros(width + 2 * margin + 1), np.zeros(width + 2 * margin + 1)
    total, total_squares = 0.0, 0.0
    for w in range(width):
        total += row[w]
        total_squares += row[w] * row[w]
        below[margin + width - 1 - w] = total
        below_squares[margin + width - 1 - w] = total_squares
    below[:margin], below_squares[:margin] = total, total_squares
    sum_d[:], sum_dd[:] = total, total_squares
    for k in range(len(holes)):
        start, end = holes[k]
        first, last = max(0, start - width + 1), min(offsets, end)
        if first < last:
            at_start, at_end = margin + width + first - start, margin + width + first - end
            _subtract_run(sum_d[first:last], below, at_start, at_end)
            _subtract_run(sum_dd[first:last], below_squares, at_start, at_end)


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
def _about_zero(
    kind: int,
    sums: tuple[FloatArray, ...],
    means: tuple[float, float],
    zeros: tuple[float, float],
    out: FloatArray,
) -> None:
    """Xu 2024 eqs. (3) and (4), from the sums moved back from the means to zero."""
    n, sum_d, sum_dd, sum_l, sum_ll, sum_dl = sums
    mean_d, mean_l = means
    zero_d, zero_l = zeros
    for u in range(out.size):
        dd = sum_dd[u] + mean_d * (2.0 * sum_d[u] + n[u] * mean_d)
        ll = sum_ll[u] + mean_l * (2.0 * sum_l[u] + n[u] * mean_l)
        dl = sum_dl[u] + mean_d * sum_l[u] + mean_l * (sum_d[u] + n[u] * mean_d)
        if kind == EUCLIDEAN:
            score = 1.0 - np.sqrt(max(0.0, dd - 2.0 * dl + ll) / max(dd, ll))
        else:
            cosine = min(1.0, max(-1.0, dl / np.sqrt(dd * ll)))
            score = cosine if kind == COSINE else 1.0 - cosine
        out[u] = score if (dd > zero_d) & (ll > zero_l) else np.nan
