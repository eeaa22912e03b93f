"""Local lines through the occupied cells of a grid, and which of them are one wall."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# A local line is fitted to the cells within a radius in cells, and at most so many. The second is
# for walls that noise has made several cells thick. Variance across a line over that along it.
_LINE_NEIGHBOURHOODS = ((4.0, 24), (8.0, 100))
_LINE_CELLS_MIN, _LINE_FLATNESS_MAX = 5, 0.15
# Lines that agree in direction and in offset within these steps are one wall.
_WALL_STEP_RAD, _WALL_STEP_CELLS = np.pi / 12.0, 4.0
# So many cells at a time: neighbours of all cells of a large map would take several times the map.
_CHUNK = 10_000


class WallLines(NamedTuple):
    """n local lines: ``points_m`` (n, 2) on them, unit ``normals`` (n, 2), and ``normal_variance``
    (n,) of each normal's angle, rad²."""

    points_m: FloatArray
    normals: FloatArray
    normal_variance: FloatArray


def fit_wall_lines(points_m: FloatArray, resolution_m: float) -> WallLines:
    """A line through the neighbourhood of each point, where it has one: the smaller neighbourhood,
    or the larger one where a wall is several cells thick."""
    from scipy.spatial import cKDTree

    fits = [WallLines(np.empty((0, 2)), np.empty((0, 2)), np.empty(0))]
    if len(points_m) >= _LINE_CELLS_MIN:
        tree = cKDTree(points_m)
        open_m = points_m
        for radius_cells, neighbours_max in _LINE_NEIGHBOURHOODS:
            left_m = [np.empty((0, 2))]
            for start in range(0, len(open_m), _CHUNK):
                at_m = open_m[start : start + _CHUNK]
                fit, straight = _fit_lines_within(
                    points_m, tree, at_m, radius_cells * resolution_m, neighbours_max, resolution_m
                )
                fits.append(fit)
                left_m.append(at_m[~straight])
            open_m = np.concatenate(left_m)
    return WallLines(*(np.concatenate(parts) for parts in zip(*fits, strict=True)))


def _fit_lines_within(
    points_m: FloatArray,
    tree: "cKDTree",
    at_m: FloatArray,
    radius_m: float,
    neighbours_max: int,
    resolution_m: float,
) -> tuple[WallLines, BoolArray]:
    """The lines through the points within a radius of each place (n, 2), and which places have
    one."""
    _, neighbours = tree.query(
        at_m, k=min(neighbours_max, len(points_m)), distance_upper_bound=radius_m
    )
    has: BoolArray = np.asarray(neighbours) < len(points_m)
    near_m = points_m[np.where(has, neighbours, 0)]
    count = has.sum(axis=1)
    mean_m = (near_m * has[..., np.newaxis]).sum(axis=1) / count[:, np.newaxis]
    away_m = (near_m - mean_m[:, np.newaxis]) * has[..., np.newaxis]
    spread = np.einsum("nki,nkj->nij", away_m, away_m) / count[:, np.newaxis, np.newaxis]
    variance, axes = np.linalg.eigh(spread)
    straight: BoolArray = (count >= _LINE_CELLS_MIN) & (
        variance[:, 0] <= _LINE_FLATNESS_MAX * variance[:, 1]
    )
    across_m2 = variance[straight, 0] + resolution_m**2 / 12.0
    lines = WallLines(
        points_m=mean_m[straight],
        normals=axes[straight, :, 0],
        normal_variance=across_m2 / (count[straight] * variance[straight, 1]),
    )
    return lines, straight


def wall_of_each(lines: WallLines, resolution_m: float) -> IntArray:
    """(n, 2) the wall of each line: steps of its direction and of its distance from the origin."""
    angle_rad = np.arctan2(lines.normals[:, 1], lines.normals[:, 0])
    turns = np.round(angle_rad / _WALL_STEP_RAD).astype(np.int64)
    # A normal and its opposite are one direction.
    half_turn = round(np.pi / _WALL_STEP_RAD)
    opposite = (turns // half_turn) % 2 == 1
    offset_m = (lines.normals * lines.points_m).sum(axis=1) * np.where(opposite, -1.0, 1.0)
    steps = np.round(offset_m / (_WALL_STEP_CELLS * resolution_m)).astype(np.int64)
    return np.column_stack([turns % half_turn, steps])
