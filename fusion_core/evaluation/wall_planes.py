"""A plane through the points of a wall, on which boards hang and in which niches are."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.robust import MAD_TO_SIGMA

# Tukey's biweight: 95 % efficient for Gaussian noise.
_TUKEY = 4.685
_SQUARES_MIN = 10
_FULL_SQUARE = 4
# Plaster is no flatter.
_FLATNESS_M = 0.003


@dataclass(frozen=True, slots=True, kw_only=True)
class Wall:
    """A plane across one of the room's axes. ``offset_m``: where it crosses the axis through the
    room's middle. ``slope``: (2,) its change along the other two axes. ``sd_m``: of the offset, by
    the scatter of the squares; ``scatter_m``: robust standard deviation of the points about the
    plane. ``inliers``: points near it. ``coverage``: fraction of its area that has points.
    """

    offset_m: float
    slope: tuple[float, float]
    sd_m: float
    scatter_m: float
    inliers: int
    coverage: float


def fit_wall(
    along_m: FloatArray,
    across_m: FloatArray,
    *,
    square_m: float,
    coverage_square_m: float,
    area_m2: float,
) -> Wall | None:
    """The plane of a wall through (N,) offsets along an axis of the room at (N, 2) places across.

    It goes through the medians of squares of side ``square_m``, so that what was scanned densely
    does not weigh more. ``area_m2``: of the whole wall, of which squares of ``coverage_square_m``
    with points in them cover a part. None where there are too few points.
    """
    if len(along_m) < _SQUARES_MIN:
        return None
    squares = _squares(along_m, across_m, square_m)
    if len(squares.medians_m) < _SQUARES_MIN:
        return None
    plane, sd_m = _fit_plane(squares)
    residual_m = np.abs(along_m - plane[0] - across_m @ plane[1:])
    # Three standard deviations, and no less than a scanner resolves.
    inliers = residual_m < max(3.0 * squares.scatter_m, 0.01)
    if not inliers.any():
        return None
    scatter_m = float(MAD_TO_SIGMA * np.median(residual_m[inliers]))
    return Wall(
        offset_m=float(plane[0]),
        slope=(float(plane[1]), float(plane[2])),
        sd_m=sd_m,
        scatter_m=scatter_m,
        inliers=int(inliers.sum()),
        coverage=_coverage(across_m[inliers], coverage_square_m, area_m2),
    )


def square_numbers(across_m: FloatArray, square_m: float) -> IntArray:
    """(N,) one number for each square of (N, 2)."""
    squares = np.floor(across_m / square_m).astype(np.int64) + (1 << 20)
    return np.asarray((squares[:, 0] << 21) | squares[:, 1], dtype=np.int64)


def _coverage(across_m: FloatArray, square_m: float, area_m2: float) -> float:
    squares = len(np.unique(square_numbers(across_m, square_m)))
    return min(1.0, squares * square_m**2 / max(area_m2, square_m**2))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Squares:
    """Squares of a wall. ``medians_m``: (C,) of the points' offsets in each, with the standard
    deviation ``median_sd_m`` of a usual one. ``centres_m``: (C, 2). ``scatter_m``: robust standard
    deviation of points within a square, which steps between squares do not widen."""

    medians_m: FloatArray
    centres_m: FloatArray
    scatter_m: float
    median_sd_m: float


def _squares(along_m: FloatArray, across_m: FloatArray, cell_m: float) -> _Squares:
    _, cell, counts = np.unique(
        square_numbers(across_m, cell_m), return_inverse=True, return_counts=True
    )
    order = np.lexsort((along_m, cell))
    starts = np.cumsum(counts) - counts
    lower, upper = starts + (counts - 1) // 2, starts + counts // 2
    ordered_m = along_m[order]
    medians_m = 0.5 * (ordered_m[lower] + ordered_m[upper])
    sums = [np.bincount(cell, across_m[:, side]) for side in range(2)]
    # The median of three points or fewer follows them too closely.
    is_full = counts[cell] >= _FULL_SQUARE
    deviation_m = np.abs(along_m - medians_m[cell])
    if is_full.sum() < _SQUARES_MIN:
        deviation_m, is_full = np.abs(along_m - np.median(along_m)), np.ones(len(cell), np.bool_)
    scatter_m = float(MAD_TO_SIGMA * np.median(deviation_m[is_full]))
    return _Squares(
        medians_m=np.asarray(medians_m, dtype=np.float64),
        centres_m=np.stack(sums, axis=1) / counts[:, np.newaxis],
        scatter_m=scatter_m,
        # The median of Gaussian numbers has 1.25 times the deviation of their mean.
        median_sd_m=1.25 * scatter_m / float(np.sqrt(np.median(counts))),
    )


def _fit_plane(squares: _Squares) -> tuple[FloatArray, float]:
    """(3,) offset and slopes, by Tukey's biweight from the most frequent offset on, and the
    offset's standard deviation.

    Boards and niches are as parallel to the wall as it is to itself: most of the squares decide.
    """
    scale_m = max(squares.median_sd_m, _FLATNESS_M)
    ordered_m = np.sort(squares.medians_m)
    within = np.searchsorted(ordered_m, ordered_m + 4.0 * scale_m) - np.arange(len(ordered_m))
    first = int(np.argmax(within))
    mode_m = np.median(ordered_m[first : first + within[first]])
    design = np.column_stack([np.ones(len(ordered_m)), squares.centres_m])
    plane, sd_m = np.array([mode_m, 0.0, 0.0]), np.inf
    for _ in range(20):
        residual_m = squares.medians_m - design @ plane
        weights = np.maximum(0.0, 1.0 - (residual_m / (_TUKEY * scale_m)) ** 2) ** 2
        weighted = design * weights[:, np.newaxis]
        information = weighted.T @ design
        before, target = plane, weighted.T @ squares.medians_m
        plane = np.linalg.lstsq(information, target, rcond=None)[0]
        residual_m = squares.medians_m - design @ plane
        variance_m2 = float(weights @ residual_m**2 / max(weights.sum() - 3.0, 1.0))
        sd_m = float(np.sqrt(variance_m2 * np.linalg.pinv(information)[0, 0]))
        if np.abs(plane - before).max() < 1e-9:
            break
    return np.asarray(plane, dtype=np.float64), sd_m
