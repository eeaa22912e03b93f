"""Curves less their means, with their holes as zeros: what many comparisons with them share."""

from typing import NamedTuple

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray

# Squares that sum to less than this fraction of those of the whole row (or curve) are rounding, not
# signal: over 10⁴ samples the cumulative sums are good to about 10⁻¹³ of their total.
_NEGLIGIBLE = 1e-12


class CentredCurves(NamedTuple):
    """H curves of N samples, each less the mean of its valid samples, holes as 0: what many
    comparisons with the same curves share.

    ``values``: (H, N). ``means``: (H,). ``runs``: (K, 2) first hole and first valid sample after
    it; those of curve v are ``first_run[v]`` up to ``first_run[v + 1]``. ``flat`` and ``zero``:
    (H,) sums of squares, about the mean and about zero, that count as none. ``hole``: (H, N + 2),
    with one False at either end.
    """

    values: FloatArray
    means: FloatArray
    runs: IntArray
    first_run: IntArray
    flat: FloatArray
    zero: FloatArray
    hole: BoolArray

    @property
    def width(self) -> int:
        """N."""
        return int(self.values.shape[1])


def centre(curves: FloatArray) -> CentredCurves:
    """(H, N) curves, NaN where missing, ready to be compared.

    Centring keeps a small variance that sits on a large offset."""
    height, width = curves.shape
    values, hole, counts, means, squares = _centre_rows(curves)
    edges = np.flatnonzero(hole[:, 1:] != hole[:, :-1]).reshape(-1, 2)
    return CentredCurves(
        values=values,
        means=means,
        runs=edges % (width + 1),
        first_run=np.searchsorted(edges[:, 0], np.arange(height + 1) * (width + 1)),
        # The mean is rounded too, so a constant row is constant only relative to its mean.
        flat=_NEGLIGIBLE * (squares + _NEGLIGIBLE * counts * means**2),
        zero=_NEGLIGIBLE * (squares + counts * means**2),
        hole=hole,
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
