"""Correlative scan matching by branch and bound (Olson 2009, Hess et al. 2016).

Every pose of a regular grid over (x, y, yaw) has a score, and branch and bound finds the global
maximum without scoring them all. The result equals that of an exhaustive search.

    pyramid = make_likelihood_pyramid(map_points_m, resolution_m=0.05, truncation_m=0.1, levels=6)
    window = SearchWindow(translation_m=2.0, rotation_rad=np.pi)
    match = match_correlative(pyramid, points_m, window)
    match.pose_map_points, match.score, match.covariance
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import ByteArray, FloatArray, IntArray, read_only, wrap_angle
from fusion_core.model.errors import RegistrationFailed
from fusion_core.registration.likelihood_grid import CELL_VALUE_MAX, LikelihoodPyramid

# Truncating a Gaussian at two standard deviations costs an unmatched point 2²/2 nats.
_NATS_PER_POINT = 2.0

# Set by hand: poses less likely than the best by more than a factor of exp(10) are left out of the
# covariance. In units of the score.
_COVARIANCE_SCORE_MARGIN = int(10.0 / _NATS_PER_POINT * CELL_VALUE_MAX)

# Largest number of candidate poses, set by hand: it bounds the list of top blocks.
POSES_MAX = 2_000_000_000


def count_poses(
    translation_m: float, rotation_rad: float, resolution_m: float, step_rad: float
) -> float:
    """Number of poses in a window: whole cells and yaw steps to either side of its centre."""
    cells = 2.0 * np.ceil(translation_m / resolution_m) + 1.0
    return float(cells**2 * (2.0 * np.ceil(rotation_rad / step_rad) + 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchWindow:
    """The poses to search: ``centre`` (x, y, yaw) in metres and radians, and the half widths.

    ``translation_m``: along x and y, to either side. ``rotation_rad``: to either side, at most π.
    """

    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translation_m: float
    rotation_rad: float

    def __post_init__(self) -> None:
        values = np.array([*self.centre, self.translation_m, self.rotation_rad])
        if not np.isfinite(values).all() or self.translation_m < 0.0:
            raise ValueError(f"a window must be finite and not negative, got {self}")
        if not 0.0 <= self.rotation_rad <= np.pi:
            raise ValueError(f"rotation_rad must be between 0 and pi, got {self.rotation_rad}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CorrelativeMatch:
    """The best pose of the search grid.

    ``pose_map_points``: (3,) x, y, yaw that maps the points to the map. ``score``: in [0, 1], 1
    where every point lies at the centre of an occupied cell of the map. ``covariance``: (3, 3) of
    the pose, over all poses of the window by their likelihood (Olson 2009, eq. 6-8) plus the
    rounding to the grid; a corridor or an ambiguous second room makes it large. It is too small
    where the map's points lie farther apart than the truncation: make the map of several sweeps.
    ``step_m``, ``step_rad``: of the grid. ``poses_scored``: scores that were computed.
    """

    pose_map_points: FloatArray
    score: float
    covariance: FloatArray
    step_m: float
    step_rad: float
    poses_scored: int

    def __post_init__(self) -> None:
        read_only(self.pose_map_points)
        read_only(self.covariance)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SearchGrid:
    """The poses of a search: ``cells``, (T, n, 2) row and column of each point for each yaw.

    ``yaw_rad``: (T,). Translations add up to ``offset_max_cells`` to rows and columns, in both
    directions.
    """

    cells: IntArray
    yaw_rad: FloatArray
    offset_max_cells: int
    step_rad: float


def make_search_grid(
    pyramid: LikelihoodPyramid,
    points_m: FloatArray,
    window: SearchWindow,
    step_rad: float | None = None,
) -> SearchGrid:
    """The poses of a search; ``step_rad`` as in ``match_correlative``."""
    if step_rad is None:
        farthest_m = float(np.sqrt((points_m**2).sum(axis=1).max()))
        # Hess et al. 2016, eq. 6-7: the farthest point moves by one cell.
        ratio = pyramid.resolution_m / max(farthest_m, pyramid.resolution_m)
        step_rad = float(np.arccos(1.0 - 0.5 * ratio * ratio))
    turns = int(np.ceil(window.rotation_rad / step_rad - 1e-9))
    step_rad = window.rotation_rad / turns if turns else 0.0
    yaw_rad = window.centre[2] + step_rad * np.arange(-turns, turns + 1, dtype=np.float64)
    offset_max_cells = int(np.ceil(window.translation_m / pyramid.resolution_m - 1e-9))
    if yaw_rad.size * float(2 * offset_max_cells + 1) ** 2 > POSES_MAX:
        raise ValueError(f"{window} has too many poses for cells of {pyramid.resolution_m:g} m")
    cells: IntArray = _rotated_cells(
        points_m,
        yaw_rad,
        window.centre[0] - pyramid.corner_m[0],
        window.centre[1] - pyramid.corner_m[1],
        pyramid.resolution_m,
    )
    return SearchGrid(
        cells=cells, yaw_rad=yaw_rad, offset_max_cells=offset_max_cells, step_rad=step_rad
    )


def match_correlative(
    pyramid: LikelihoodPyramid,
    points_m: FloatArray,
    window: SearchWindow,
    *,
    step_rad: float | None = None,
    score_min: float = 0.0,
) -> CorrelativeMatch:
    """The pose of the highest score in the window, and its covariance.

    ``points_m``: (n, 2), NaN where missing. Translations are whole cells of the pyramid from the
    window's centre. ``step_rad``: between two yaws; by default it moves the farthest point by one
    cell. Raises RegistrationFailed where no point is given, or no pose scores more than
    ``score_min``.
    """
    grid, blocks, best = _search(pyramid, points_m, window, step_rad, score_min)
    turn, row, column, total, visited = best
    count = grid.cells.shape[1]
    covariance = _leaf_covariance(
        pyramid.levels,
        grid.cells,
        grid.offset_max_cells,
        blocks,
        total,
        total - _COVARIANCE_SCORE_MARGIN,
        _NATS_PER_POINT / CELL_VALUE_MAX,
    )
    # From cells and yaw steps to metres and radians, plus the variance of rounding: uniform over a
    # cell in position, over two steps in yaw, since one step moves most points by less than a cell.
    steps = np.array([pyramid.resolution_m, pyramid.resolution_m, grid.step_rad])
    rounding = steps**2 * np.array([1.0 / 12.0, 1.0 / 12.0, 1.0 / 3.0])
    covariance = covariance * np.outer(steps, steps) + np.diag(rounding)
    return CorrelativeMatch(
        pose_map_points=_pose_of_leaf(pyramid, window, grid, turn, row, column),
        score=total / (CELL_VALUE_MAX * count),
        covariance=covariance,
        step_m=pyramid.resolution_m,
        step_rad=grid.step_rad,
        poses_scored=visited,
    )


def find_best_pose(
    pyramid: LikelihoodPyramid,
    points_m: FloatArray,
    window: SearchWindow,
    *,
    step_rad: float | None = None,
) -> FloatArray:
    """(3,) the pose of ``match_correlative`` without its covariance, in about half the time."""
    grid, _, (turn, row, column, _, _) = _search(pyramid, points_m, window, step_rad, 0.0)
    return _pose_of_leaf(pyramid, window, grid, turn, row, column)


def _search(
    pyramid: LikelihoodPyramid,
    points_m: FloatArray,
    window: SearchWindow,
    step_rad: float | None,
    score_min: float,
) -> tuple[SearchGrid, IntArray, tuple[int, int, int, int, int]]:
    """The grid, the top level's blocks that may hold the maximum, and branch and bound's result."""
    points_m = np.asarray(points_m, dtype=np.float64)
    if points_m.ndim != 2 or points_m.shape[1] != 2:
        raise ValueError(f"points_m must be (n, 2), got {points_m.shape}")
    points_m = points_m[np.isfinite(points_m).all(axis=1)]
    if points_m.shape[0] == 0:
        raise RegistrationFailed(
            "no point to match.", advice="Check that the sweep has valid beams."
        )
    grid = make_search_grid(pyramid, points_m, window, step_rad)
    floor = int(score_min * CELL_VALUE_MAX * points_m.shape[0])
    # The covariance counts poses a little worse than the best one, which may lie at the floor.
    blocks: IntArray = _top_blocks(
        pyramid.levels, grid.cells, grid.offset_max_cells, floor - _COVARIANCE_SCORE_MARGIN
    )
    blocks = blocks[np.argsort(-blocks[:, 3], kind="stable")]
    best: tuple[int, int, int, int, int] = _branch_and_bound(
        pyramid.levels, grid.cells, grid.offset_max_cells, blocks, floor
    )
    if best[3] <= floor:
        raise RegistrationFailed(
            f"no pose within {window.translation_m:g} m and {window.rotation_rad:.3g} rad scores "
            f"more than {score_min:g}.",
            advice="Widen the window, or match against a map of the same place.",
        )
    return grid, blocks, best


def _pose_of_leaf(
    pyramid: LikelihoodPyramid,
    window: SearchWindow,
    grid: SearchGrid,
    turn: int,
    row: int,
    column: int,
) -> FloatArray:
    x = window.centre[0] + column * pyramid.resolution_m
    y = window.centre[1] + row * pyramid.resolution_m
    return np.array([x, y, float(wrap_angle(grid.yaw_rad[turn]))])


@compiled(error_model="numpy")
def _rotated_cells(
    points_m: FloatArray, yaw_rad: FloatArray, x_m: float, y_m: float, resolution_m: float
) -> IntArray:
    """(T, n, 2) row and column of each point, rotated by each yaw and translated by (x, y)."""
    cells = np.empty((yaw_rad.size, points_m.shape[0], 2), dtype=np.int64)
    for t in range(yaw_rad.size):
        c, s = np.cos(yaw_rad[t]), np.sin(yaw_rad[t])
        for k in range(points_m.shape[0]):
            px, py = points_m[k, 0], points_m[k, 1]
            cells[t, k, 0] = int(np.floor((s * px + c * py + y_m) / resolution_m))
            cells[t, k, 1] = int(np.floor((c * px - s * py + x_m) / resolution_m))
    return cells


@compiled()
def sum_scores(grid: ByteArray, cells: IntArray, row: int, column: int) -> int:
    """Sum of the grid's values at cells (n, 2), all moved by (row, column); 0 outside."""
    rows, columns = np.uint64(grid.shape[0]), np.uint64(grid.shape[1])
    total = 0
    for k in range(cells.shape[0]):
        # Below zero wraps round to more than any grid has.
        r, c = np.uint64(cells[k, 0] + row), np.uint64(cells[k, 1] + column)
        if r < rows and c < columns:
            total += grid[r, c]
    return total


@compiled()
def _top_blocks(levels: ByteArray, cells: IntArray, offset_max: int, floor: int) -> IntArray:
    """(B, 4) turn, row, column, bound of the top level's blocks above ``floor``."""
    top = levels.shape[0] - 1
    size = 1 << top
    along = (2 * offset_max + size) // size
    blocks = np.empty((cells.shape[0] * along * along, 4), dtype=np.int64)
    count = 0
    for t in range(cells.shape[0]):
        for r in range(-offset_max, offset_max + 1, size):
            for c in range(-offset_max, offset_max + 1, size):
                bound = sum_scores(levels[top], cells[t], r, c)
                if bound > floor:
                    blocks[count, 0], blocks[count, 1], blocks[count, 2] = t, r, c
                    blocks[count, 3] = bound
                    count += 1
    return blocks[:count]


@compiled()
def _branch_and_bound(
    levels: ByteArray, cells: IntArray, offset_max: int, blocks: IntArray, floor: int
) -> tuple[int, int, int, int, int]:
    """Turn, row, column and score of the best leaf above ``floor``, and the scores computed.

    Hess et al. 2016, algorithm 3: depth first, the better child first. ``blocks``: those of
    ``_top_blocks``, best first.
    """
    best = (-1, 0, 0, floor)
    top = levels.shape[0] - 1
    along = (2 * offset_max + (1 << top)) >> top
    visited = cells.shape[0] * along * along
    # At most three siblings are on the stack for each level below the top.
    stack = np.empty((3 * top + 4, 4), dtype=np.int64)
    children = np.empty((4, 4), dtype=np.int64)
    for block in range(blocks.shape[0]):
        t, row, column, bound = blocks[block]
        if bound <= best[3]:
            break
        _write_row(stack, 0, (top, row, column, bound))
        depth = 1
        while depth > 0:
            depth -= 1
            level, r, c, above = stack[depth]
            if above <= best[3]:
                continue
            if level == 0:
                best = (t, r, c, above)
                continue
            half = 1 << (level - 1)
            added = 0
            for down in (0, half):
                for across in (0, half):
                    if r + down > offset_max or c + across > offset_max:
                        continue
                    score = sum_scores(levels[level - 1], cells[t], r + down, c + across)
                    visited += 1
                    if score <= best[3]:
                        continue
                    # Insertion in rising order: the last one is taken first.
                    place = added
                    while place > 0 and children[place - 1, 3] > score:
                        _write_row(children, place, children[place - 1])
                        place -= 1
                    _write_row(children, place, (level - 1, r + down, c + across, score))
                    added += 1
            for child in range(added):
                _write_row(stack, depth, children[child])
                depth += 1
    return best[0], best[1], best[2], best[3], visited


@compiled()
def _write_row(rows: IntArray, place: int, values: Sequence[int] | IntArray) -> None:
    """Numba compiles an assignment to a whole row for seconds: the text of its error message."""
    for column in range(len(values)):
        rows[place, column] = values[column]


@compiled(error_model="numpy")
def _leaf_covariance(
    levels: ByteArray,
    cells: IntArray,
    offset_max: int,
    blocks: IntArray,
    total: int,
    least: int,
    nats: float,
) -> FloatArray:
    """(3, 3) covariance of (column, row, turn) over all leaves that score at least ``least``.

    A leaf weighs exp(nats · (score - total)). ``blocks``: as in ``_branch_and_bound``.
    """
    top = levels.shape[0] - 1
    stack = np.empty((3 * top + 4, 3), dtype=np.int64)
    weight_sum, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    leaf = np.empty(3)
    for block in range(blocks.shape[0]):
        t, row, column, bound = blocks[block]
        if bound < least:
            break
        _write_row(stack, 0, (top, row, column))
        depth = 1
        while depth > 0:
            depth -= 1
            level, r, c = stack[depth]
            if r > offset_max or c > offset_max:
                continue
            score = sum_scores(levels[level], cells[t], r, c)
            if score < least:
                continue
            if level == 0:
                weight = np.exp(nats * (score - total))
                leaf[0], leaf[1], leaf[2] = c, r, t
                weight_sum += weight
                for i in range(3):
                    first[i] += weight * leaf[i]
                    for j in range(3):
                        second[i, j] += weight * leaf[i] * leaf[j]
                continue
            half = 1 << (level - 1)
            for down in (0, half):
                for across in (0, half):
                    _write_row(stack, depth, (level - 1, r + down, c + across))
                    depth += 1
    for i in range(3):
        for j in range(3):
            mean = second[i, j] / weight_sum
            second[i, j] = mean - (first[i] / weight_sum) * (first[j] / weight_sum)
    return second
