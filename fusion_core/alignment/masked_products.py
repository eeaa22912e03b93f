"""The sums over jointly valid samples behind every masked similarity, fused with the scores.

The score of row D at an offset of the curve L needs six sums over the samples that both sides
have: n, ΣD, ΣD², ΣL, ΣL² and ΣDL. With holes as zeros, ΣDL is one matrix product for the whole
field, or for long rows at many offsets a correlation by FFT. In the other five at least one factor
is a mask, and a mask is a few runs of holes: each sum is a total less one difference of cumulative
sums for each run. Where holes come in runs that costs a fraction of five further products; with
every other sample missing, the worst case, twice as much. At a few offsets it costs more than five
such narrow products, which are then taken instead.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from fusion_core.alignment.centred_curves import CentredCurves, centre
from fusion_core.alignment.masked_scores import score_row
from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray, IntArray

# One step of an FFT's n log2 n takes as long as so many multiplications of a matrix product:
# measured over 15 sizes of fields, of 40 to 960 samples a row and 41 to 1361 offsets.
_PRODUCTS_PER_FFT_STEP = 6


def scores_along_curve(
    curve: FloatArray, rows: CentredCurves, scores: Sequence[int], min_samples: int
) -> tuple[FloatArray, FloatArray]:
    """Score each row at each offset along the curve, over the samples valid on both sides.

    ``curve``: (Ψ,), NaN where missing. ``rows``: H of W <= Ψ samples. ``scores``: any of the kinds
    of ``masked_scores``.

    Returns (len(scores), H, Ψ - W + 1) scores and the (H, Ψ - W + 1) fraction of a row's samples
    that are valid on both sides. A score is NaN where there are fewer than ``min_samples`` or
    where either side has no variance (Pearson) or no norm (the others).
    """
    along = centre(curve[np.newaxis])
    line = along.values[0]
    cumulative = np.zeros((3, line.size + 1))
    np.cumsum([np.isfinite(curve), line, line**2], axis=1, out=cumulative[:, 1:])
    products = _products_along(line, rows.values)
    kinds = np.array(scores, dtype=np.int64)
    margin = int(np.diff(along.runs).max(initial=0))
    field, overlap = _score_rows(along, cumulative, rows, products, kinds, min_samples, margin)
    return field, overlap


def _products_along(line: FloatArray, rows: FloatArray) -> FloatArray:
    """ΣDL of each row at each offset: (Ψ,) and (H, W), W <= Ψ, give (H, Ψ - W + 1)."""
    length, width = line.size, rows.shape[1]
    offsets = length - width + 1
    # There and back.
    fft_steps = 2 * length * math.log2(length)
    if width * offsets > _PRODUCTS_PER_FFT_STEP * fft_steps:
        return _correlate(line, rows)
    # windows[w, u] = line[w + u]
    windows = np.ascontiguousarray(sliding_window_view(line, offsets))
    products: FloatArray = rows @ windows
    return products


def _correlate(line: FloatArray, rows: FloatArray) -> FloatArray:
    """The same products by FFT."""
    from scipy.fft import irfft, next_fast_len, rfft

    length = next_fast_len(line.size, real=True)
    spectra = np.conj(rfft(rows, length))
    spectra *= rfft(line, length)
    # A row lies on the curve as a whole: none reaches round the end of the transform.
    products: FloatArray = irfft(spectra, length, overwrite_x=True)
    return np.ascontiguousarray(products[:, : line.size - rows.shape[1] + 1])


def scores_of_windows(
    curves: FloatArray, rows: CentredCurves, scores: Sequence[int], min_samples: int
) -> tuple[FloatArray, FloatArray]:
    """The same for a few offsets along K curves, (K, Ψ) with W <= Ψ.

    Returns (len(scores), H, K, Ψ - W + 1) scores and (H, K, Ψ - W + 1) fractions.
    """
    # One mean for all curves is as good as their own.
    along = centre(curves.reshape(1, -1))
    offsets = curves.shape[1] - rows.width + 1

    def windows_of(values: FloatArray) -> FloatArray:
        """(W, K * U)."""
        windows = sliding_window_view(values.reshape(curves.shape), offsets, axis=1)
        return windows.swapaxes(0, 1).reshape(rows.width, -1)

    line, seen = windows_of(along.values), windows_of(np.isfinite(curves).astype(np.float64))
    valid = 1.0 - rows.hole[:, 1:-1]
    n, sum_l, sum_ll = valid @ seen, valid @ line, valid @ line**2
    sum_d, sum_dd, sum_dl = rows.values @ seen, rows.values**2 @ seen, rows.values @ line
    kinds = np.array(scores, dtype=np.int64)
    field, overlap = _score_sums(
        along, rows, (n, sum_d, sum_dd, sum_l, sum_ll, sum_dl), kinds, min_samples
    )
    places = rows.values.shape[0], curves.shape[0], offsets
    return field.reshape(-1, *places), overlap.reshape(places)


@compiled(error_model="numpy")
def _score_sums(
    along: CentredCurves,
    across: CentredCurves,
    sums: tuple[FloatArray, ...],
    scores: IntArray,
    min_samples: int,
) -> tuple[FloatArray, FloatArray]:
    """The scores from sums (H, U) that are known."""
    n, sum_d, sum_dd, sum_l, sum_ll, sum_dl = sums
    height, offsets = n.shape
    overlap = n / across.values.shape[1]
    field = np.empty((len(scores), height, offsets))
    moved = np.empty((3, offsets))
    for v in range(height):
        for u in range(offsets):
            if n[v, u] < min_samples:
                n[v, u] = np.nan
        score_row(
            scores,
            (n[v], sum_d[v], sum_dd[v], sum_l[v], sum_ll[v], sum_dl[v]),
            (across.means[v], across.flat[v], across.zero[v]),
            (along.means[0], along.flat[0], along.zero[0]),
            moved,
            field,
            v,
        )
    return field, overlap


@compiled(error_model="numpy")
def _score_rows(
    along: CentredCurves,
    cumulative: FloatArray,
    across: CentredCurves,
    products: FloatArray,
    scores: IntArray,
    min_samples: int,
    margin: int,
) -> tuple[FloatArray, FloatArray]:
    """The five sums of each row at every offset, and its scores from them.

    ``cumulative``: (3, Ψ + 1) sums of the curve's mask, values and squares. ``products``: (H, U)
    ΣDL. ``margin``: of the curve's widest hole. The sums of one row are (U,) each and stay in the
    processor's cache.
    """
    height, offsets = products.shape
    width = across.values.shape[1]
    windows = cumulative[:, width:] - cumulative[:, :offsets]
    n, sum_l, sum_ll = np.empty(offsets), np.empty(offsets), np.empty(offsets)
    sum_d, sum_dd = np.empty(offsets), np.empty(offsets)
    moved = np.empty((3, offsets))
    field = np.empty((len(scores), height, offsets))
    overlap = np.empty((height, offsets))
    below = np.empty((2, width + 2 * margin + 1))
    for v in range(height):
        holes = across.runs[across.first_run[v] : across.first_run[v + 1]]
        _sum_curve(cumulative, windows, holes, n, sum_l, sum_ll)
        _sum_row(across.values[v], along.runs, margin, below, sum_d, sum_dd)
        for u in range(offsets):
            overlap[v, u] = n[u] / width
            if n[u] < min_samples:
                n[u] = np.nan
        score_row(
            scores,
            (n, sum_d, sum_dd, sum_l, sum_ll, products[v]),
            (across.means[v], across.flat[v], across.zero[v]),
            (along.means[0], along.flat[0], along.zero[0]),
            moved,
            field,
            v,
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
    for u in range(n.size):
        n[u], sum_l[u], sum_ll[u] = windows[0, u], windows[1, u], windows[2, u]
    for k in range(len(holes)):
        _subtract_run(n, cumulative[0], holes[k, 0], holes[k, 1])
        _subtract_run(sum_l, cumulative[1], holes[k, 0], holes[k, 1])
        _subtract_run(sum_ll, cumulative[2], holes[k, 0], holes[k, 1])


@compiled()
def _sum_row(
    row: FloatArray,
    holes: IntArray,
    margin: int,
    below: FloatArray,
    sum_d: FloatArray,
    sum_dd: FloatArray,
) -> None:
    """ΣD, ΣD² at each offset: those of the whole row less those below the curve's holes.

    As the offset rises a hole of the curve moves to the left along the row, so the cumulative
    sums are laid out backwards, in ``below`` (2, W + 2 ``margin`` + 1) to work in: index ``margin +
    W - w`` holds the sum of the first w samples. The margins, as wide as the widest hole, let a run
    reach over either end of the row.
    """
    width, offsets = row.size, sum_d.size
    sums, squares = below[0], below[1]
    sums[margin + width :], squares[margin + width :] = 0.0, 0.0
    total, total_squares = 0.0, 0.0
    for w in range(width):
        total += row[w]
        total_squares += row[w] * row[w]
        sums[margin + width - 1 - w] = total
        squares[margin + width - 1 - w] = total_squares
    sums[:margin], squares[:margin] = total, total_squares
    sum_d[:], sum_dd[:] = total, total_squares
    for k in range(len(holes)):
        start, end = holes[k, 0], holes[k, 1]
        first, last = max(0, start - width + 1), min(offsets, end)
        if first < last:
            at_start, at_end = margin + width + first - start, margin + width + first - end
            _subtract_run(sum_d[first:last], sums, at_start, at_end)
            _subtract_run(sum_dd[first:last], squares, at_start, at_end)
