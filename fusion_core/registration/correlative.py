"""The best pose of a sweep in a map over a whole window, with certainty (Olson 2009, Hess 2016).

No first guess is refined: the score of every pose of a lattice (x, y, yaw) counts, and branch and
bound finds their maximum without visiting them all. It is what brute force finds, in less time.

    pyramid = likelihood_pyramid(map_points_m, resolution_m=0.05, reach_m=0.1, levels=6)
    window = SearchWindow(translation_m=2.0, rotation_rad=np.pi)
    match = correlate(pyramid, points_m, window)
    match.pose_map_points, match.score, match.covariance
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import ByteArray, FloatArray, IntArray, read_only, wrap_angle
from fusion_core.model.errors import RegistrationFailed
from fusion_core.registration.likelihood_grid import FULL, LikelihoodPyramid

# A point without a counterpart costs exp(-2): the truncation lies at two standard deviations.
_NATS_OF_A_POINT = 2.0

# In a score: poses less likely than exp(-10) of the best one do not show in a covariance.
_WITHIN_COVARIANCE = int(10.0 / _NATS_OF_A_POINT * FULL)

# Branch and bound visits few of them, but counts them in whole numbers and lists its blocks.
POSES_MAX = 2_000_000_000


def poses_of(
    translation_m: float, rotation_rad: float, resolution_m: float, step_rad: float
) -> float:
    """How many poses a window has, by the cells and the turns that it reaches to either side."""
    cells = 2.0 * np.ceil(translation_m / resolution_m) + 1.0
    return float(cells**2 * (2.0 * np.ceil(rotation_rad / step_rad) + 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchWindow:
    """The poses to try: ``centre`` (x, y, yaw) in metres and radians, and how far from it.

    ``translation_m``: along x and along y, either way. ``rotation_rad``: either way, at most π.
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
    """The best pose of the window's lattice.

    ``pose_map_points``: (3,) x, y, yaw that maps the points to the map. ``score``: in [0, 1], 1
    where every point lies in the middle of a cell of the map. ``covariance``: (3, 3) of the
    pose, over all poses of the window by their likelihood (Olson 2009, eq. 6-8) and with the
    lattice's own rounding, so that a corridor or a second room alike make it large. A map whose
    points are farther apart than the likelihood reaches feigns certainty: give it several sweeps.
    ``step_m``, ``step_rad``: of the lattice. ``visited``: scores that were computed.
    """

    pose_map_points: FloatArray
    score: float
    covariance: FloatArray
    step_m: float
    step_rad: float
    visited: int

    def __post_init__(self) -> None:
        read_only(self.pose_map_points)
        read_only(self.covariance)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lattice:
    """The poses of a search: ``cells``, (T, n, 2) row and column of each point for each yaw.

    ``yaw_rad``: (T,). Offsets of up to ``reach_cells`` cells either way are added to the cells.
    """

    cells: IntArray
    yaw_rad: FloatArray
    reach_cells: int
    step_rad: float


def lattice_of(
    pyramid: LikelihoodPyramid,
    points_m: FloatArray,
    window: SearchWindow,
    step_rad: float | None = None,
) -> Lattice:
    """The lattice of a search; ``step_rad`` as in ``correlate``."""
    if step_rad is None:
        farthest_m = float(np.sqrt((points_m**2).sum(axis=1).max()))
        # Hess et al. 2016, eq. 6-7: the farthest point moves by one cell.
        ratio = pyramid.resolution_m / max(farthest_m, pyramid.resolution_m)
        step_rad = float(np.arccos(1.0 - 0.5 * ratio * ratio))
    turns = int(np.ceil(window.rotation_rad / step_rad - 1e-9))
    step_rad = window.rotation_rad / turns if turns else 0.0
    yaw_rad = window.centre[2] + step_rad * np.arange(-turns, turns + 1, dtype=np.float64)
    reach_cells = int(np.ceil(window.translation_m / pyramid.resolution_m - 1e-9))
    if yaw_rad.size * float(2 * reach_cells + 1) ** 2 > POSES_MAX:
        raise ValueError(f"{window} has too many poses for cells of {pyramid.resolution_m:g} m")
    cells: IntArray = _cells(
        points_m,
        yaw_rad,
        window.centre[0] - pyramid.corner_m[0],
        window.centre[1] - pyramid.corner_m[1],
        pyramid.resolution_m,
    )
    return Lattice(cells=cells, yaw_rad=yaw_rad, reach_cells=reach_cells, step_rad=step_rad)


def correlate(
    pyramid: LikelihoodPyramid,
    points_m: FloatArray,
    window: SearchWindow,
    *,
    step_rad: float | None = None,
    score_min: float = 0.0,
) -> CorrelativeMatch:
    """The maximum of the score over the window's lattice, and its covariance.

    ``points_m``: (n, 2), NaN where missing. Translations are whole cells of the pyramid from the
    window's centre; ``step_rad`` between two yaws, by default what moves the farthest point by
    one cell. Raises RegistrationFailed where no point is given, or no pose scores more than
    ``score_min``.
    """
    lattice, blocks, best = _search(pyramid, points_m, window, step_rad, score_min)
    turn, row, column, total, visited = best
    count = lattice.cells.shape[1]
    covariance = _spread(
        pyramid.levels,
        lattice.cells,
        lattice.reach_cells,
        blocks,
        total,
        total - _WITHIN_COVARIANCE,
        _NATS_OF_A_POINT / FULL,
    )
    # From cells and turns to metres and radians. The true position lies within half a cell; the
    # yaw within a whole step, since that moves most points by less than a cell.
    steps = np.array([pyramid.resolution_m, pyramid.resolution_m, lattice.step_rad])
    rounding = steps**2 * np.array([1.0 / 12.0, 1.0 / 12.0, 1.0 / 3.0])
    covariance = covariance * np.outer(steps, steps) + np.diag(rounding)
    return CorrelativeMatch(
        pose_map_points=_pose(pyramid, window, lattice, turn, row, column),
        score=total / (FULL * count),
        covariance=covariance,
        step_m=pyramid.resolution_m,
        step_rad=lattice.step_rad,
        visited=visited,
    )


def best_pose(
    pyramid: LikelihoodPyramid,
    points_m: FloatArray,
    window: SearchWindow,
    *,
    step_rad: float | None = None,
) -> FloatArray:
    """(3,) the pose of ``correlate`` without its covariance, in about half of the time."""
    lattice, _, (turn, row, column, _, _) = _search(pyramid, points_m, window, step_rad, 0.0)
    return _pose(pyramid, window, lattice, turn, row, column)


def _search(
    pyramid: LikelihoodPyramid,
    points_m: FloatArray,
    window: SearchWindow,
    step_rad: float | None,
    score_min: float,
) -> tuple[Lattice, IntArray, tuple[int, int, int, int, int]]:
    """The lattice, those blocks of its top level that matter, and what branch and bound finds."""
    points_m = np.asarray(points_m, dtype=np.float64)
    if points_m.ndim != 2 or points_m.shape[1] != 2:
        raise ValueError(f"points_m must be (n, 2), got {points_m.shape}")
    points_m = points_m[np.isfinite(points_m).all(axis=1)]
    if points_m.shape[0] == 0:
        raise RegistrationFailed(
            "no point to match.", advice="Check that the sweep has valid beams."
        )
    lattice = lattice_of(pyramid, points_m, window, step_rad)
    floor = int(score_min * FULL * points_m.shape[0])
    # The covariance counts poses a little worse than the best one, which may lie at the floor.
    blocks: IntArray = _top_blocks(
        pyramid.levels, lattice.cells, lattice.reach_cells, floor - _WITHIN_COVARIANCE
    )
    best: tuple[int, int, int, int, int] = _branch_and_bound(
        pyramid.levels, lattice.cells, lattice.reach_cells, blocks, floor
    )
    if best[3] <= floor:
        raise RegistrationFailed(
            f"no pose within {window.translation_m:g} m and {window.rotation_rad:.3g} rad scores "
            f"more than {score_min:g}.",
            advice="Widen the window, or match against a map of the same place.",
        )
    return lattice, blocks, best


def _pose(
    pyramid: LikelihoodPyramid,
    window: SearchWindow,
    lattice: Lattice,
    turn: int,
    row: int,
    column: int,
) -> FloatArray:
    x = window.centre[0] + column * pyramid.resolution_m
    y = window.centre[1] + row * pyramid.resolution_m
    return np.array([x, y, float(wrap_angle(lattice.yaw_rad[turn]))])


@compiled(error_model="numpy")
def _cells(
    points_m: FloatArray, yaw_rad: FloatArray, x_m: float, y_m: float, resolution_m: float
) -> IntArray:
    """(T, n, 2) row and column of each point after each turn and the shift (x, y)."""
    cells = np.empty((yaw_rad.size, points_m.shape[0], 2), dtype=np.int64)
    for t in range(yaw_rad.size):
        c, s = np.cos(yaw_rad[t]), np.sin(yaw_rad[t])
        for k in range(points_m.shape[0]):
            px, py = points_m[k, 0], points_m[k, 1]
            cells[t, k, 0] = int(np.floor((s * px + c * py + y_m) / resolution_m))
            cells[t, k, 1] = int(np.floor((c * px - s * py + x_m) / resolution_m))
    return cells


@compiled()
def total_score(grid: ByteArray, cells: IntArray, row: int, column: int) -> int:
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
def _top_blocks(levels: ByteArray, cells: IntArray, reach: int, floor: int) -> IntArray:
    """(B, 4) turn, row, column, bound of the top level's blocks above ``floor``, best first."""
    top = levels.shape[0] - 1
    size = 1 << top
    along = (2 * reach + size) // size
    blocks = np.empty((cells.shape[0] * along * along, 4), dtype=np.int64)
    count = 0
    for t in range(cells.shape[0]):
        for r in range(-reach, reach + 1, size):
            for c in range(-reach, reach + 1, size):
                bound = total_score(levels[top], cells[t], r, c)
                if bound > floor:
                    blocks[count, 0], blocks[count, 1], blocks[count, 2] = t, r, c
                    blocks[count, 3] = bound
                    count += 1
    return blocks[:count][np.argsort(-blocks[:count, 3], kind="mergesort")]


@compiled()
def _branch_and_bound(
    levels: ByteArray, cells: IntArray, reach: int, blocks: IntArray, floor: int
) -> tuple[int, int, int, int, int]:
    """Turn, row, column and score of the best leaf above ``floor``, and the scores computed.

    Hess et al. 2016, algorithm 3: depth first, the better child first.
    """
    best = (-1, 0, 0, floor)
    top = levels.shape[0] - 1
    along = (2 * reach + (1 << top)) >> top
    visited = cells.shape[0] * along * along
    # Three siblings wait on each level below the top.
    stack = np.empty((3 * top + 4, 4), dtype=np.int64)
    children = np.empty((4, 4), dtype=np.int64)
    for block in range(blocks.shape[0]):
        t, row, column, bound = blocks[block]
        if bound <= best[3]:
            break
        stack[0] = (top, row, column, bound)
        waiting = 1
        while waiting > 0:
            waiting -= 1
            level, r, c, above = stack[waiting]
            if above <= best[3]:
                continue
            if level == 0:
                best = (t, r, c, above)
                continue
            half = 1 << (level - 1)
            born = 0
            for down in (0, half):
                for across in (0, half):
                    if r + down > reach or c + across > reach:
                        continue
                    score = total_score(levels[level - 1], cells[t], r + down, c + across)
                    visited += 1
                    if score <= best[3]:
                        continue
                    # Insertion in rising order: the last one is taken first.
                    place = born
                    while place > 0 and children[place - 1, 3] > score:
                        children[place] = children[place - 1]
                        place -= 1
                    children[place] = (level - 1, r + down, c + across, score)
                    born += 1
            stack[waiting : waiting + born] = children[:born]
            waiting += born
    return best[0], best[1], best[2], best[3], visited


@compiled(error_model="numpy")
def _spread(
    levels: ByteArray,
    cells: IntArray,
    reach: int,
    blocks: IntArray,
    total: int,
    least: int,
    nats: float,
) -> FloatArray:
    """(3, 3) covariance of (column, row, turn) over all leaves that score at least ``least``.

    A leaf weighs exp(nats · (score - total)).
    """
    top = levels.shape[0] - 1
    stack = np.empty((3 * top + 4, 3), dtype=np.int64)
    weight_sum, first, second = 0.0, np.zeros(3), np.zeros((3, 3))
    leaf = np.empty(3)
    for block in range(blocks.shape[0]):
        t, row, column, bound = blocks[block]
        if bound < least:
            break
        stack[0] = (top, row, column)
        waiting = 1
        while waiting > 0:
            waiting -= 1
            level, r, c = stack[waiting]
            if r > reach or c > reach:
                continue
            score = total_score(levels[level], cells[t], r, c)
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
                    stack[waiting] = (level - 1, r + down, c + across)
                    waiting += 1
    first /= weight_sum
    return second / weight_sum - np.outer(first, first)
