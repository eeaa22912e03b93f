"""Scan-to-grid matching: a correlative search on a lattice, then Gauss-Newton.

The grid is a smooth field M(p): the probability of a cell, interpolated by bicubic convolution
(Keys 1981, a = -1/2) between the cells' centres. The best pose minimises (Hess et al. 2016, eq. CS)

    J(pose) = k/n Σ (1 - M(pose · p_i))² + Σ ((pose - predicted) / sigma)²
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import ByteArray, FloatArray, read_only, wrap_angle

# The value of a cell that is certainly occupied: the largest of a byte.
FULL = 255.0

# k of J. Residuals of a well-placed scan have a standard deviation of about a quarter, and beams
# on one wall have correlated errors, so that a scan counts as nine independent points: 9 / 0.25².
INFORMATION_OF_A_SCAN = 144.0

# Fewer points hardly constrain a pose; set by hand.
POINTS_MIN = 10

# Numerics of Gauss-Newton: metres and radians below which a step has converged, and a safeguard.
_STEP_MIN, _ITERATIONS_MAX = 1e-6, 30


@dataclass(frozen=True, slots=True, eq=False)
class ProbabilityGrid:
    """An occupancy grid to match scans with.

    ``cells``: (rows, columns) uint8, ``FULL`` for certainly occupied and 0 for free and unknown
    alike, with row 0 at the smallest y. ``corner_m``: (x, y) of the outer corner of cell (0, 0).
    """

    cells: ByteArray
    corner_m: tuple[float, float]
    resolution_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LatticeSearch:
    """Which poses about the prediction the correlative search tries.

    ``translation_m``, ``rotation_rad``: how far to either side. ``prior_weight``: (w₀ per metre,
    w₁ per radian): a pose d metres and a radians from the prediction has its score multiplied by
    exp(-(w₀ d + w₁ a)²), so that along a corridor, where all poses score alike, the prediction
    decides. ``step_rad``: between two headings; a degree is half a cell at 1.5 m. ``point_stride``:
    every second point is enough to find the cell from which Gauss-Newton starts.
    """

    translation_m: float
    rotation_rad: float
    prior_weight: tuple[float, float]
    step_rad: float = float(np.radians(1.0))
    point_stride: int = 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GridMatch:
    """A scan's pose in a grid's frame.

    ``pose_grid_scan``: (3,) x, y, yaw. ``occupancy``: mean of M at the points, in about [0, 1].
    ``information``: (3, 3) of the pose in the scan's own axes, in 1/m² and 1/rad²; it is small
    along a corridor. The prediction takes no part in it.
    """

    pose_grid_scan: FloatArray
    occupancy: float
    information: FloatArray

    def __post_init__(self) -> None:
        read_only(self.pose_grid_scan)
        read_only(self.information)


def match_scan(
    grid: ProbabilityGrid,
    points_m: FloatArray,
    start: FloatArray,
    *,
    predicted: FloatArray | None = None,
    prior_sigma: tuple[float, float] = (1.0, 1.0),
) -> GridMatch:
    """The optimum of J near ``start``.

    ``points_m``: (n, 2), n >= 1, finite. ``start``, ``predicted``: (3,) in the grid's frame;
    without ``predicted`` the points alone decide. ``prior_sigma``: in metres and radians.
    Raises ValueError for no points.
    """
    if points_m.ndim != 2 or points_m.shape[1] != 2 or points_m.shape[0] == 0:
        raise ValueError(f"points_m must be (n, 2), n >= 1, got {points_m.shape}")
    prior = np.zeros(3)
    if predicted is not None:
        prior[:2] = prior_sigma[0] ** -2.0
        prior[2] = prior_sigma[1] ** -2.0
    pose, occupancy, information = _gauss_newton(
        grid.cells,
        grid.corner_m[0],
        grid.corner_m[1],
        grid.resolution_m,
        points_m,
        np.asarray(start, dtype=np.float64),
        np.asarray(start if predicted is None else predicted, dtype=np.float64),
        prior,
    )
    c, s = np.cos(pose[2]), np.sin(pose[2])
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    information = axes.T @ information @ axes
    pose[2] = wrap_angle(pose[2])
    return GridMatch(
        pose_grid_scan=pose,
        occupancy=float(occupancy),
        information=(information + information.T) / 2.0,
    )


def correlative_match(
    grid: ProbabilityGrid, points_m: FloatArray, predicted: FloatArray, search: LatticeSearch
) -> FloatArray:
    """(3,) the pose about ``predicted`` with the highest score (Olson 2009), to a cell.

    The score is the sum of the cells at the points, times the prior's weight. ``points_m``: (n, 2).
    """
    pose: FloatArray = _best_of_lattice(
        grid.cells,
        grid.corner_m[0],
        grid.corner_m[1],
        grid.resolution_m,
        points_m[:: search.point_stride],
        predicted,
        (search.translation_m, search.rotation_rad),
        search.step_rad,
        search.prior_weight,
    )
    return pose


@compiled(error_model="numpy")
def _best_of_lattice(  # compiled functions take no dataclasses
    grid: ByteArray,
    left_m: float,
    bottom_m: float,
    resolution_m: float,
    points_m: FloatArray,
    predicted: FloatArray,
    half_widths: tuple[float, float],
    step_rad: float,
    prior_weight: tuple[float, float],
) -> FloatArray:
    """``correlative_match`` with the fields of its arguments one by one."""
    rows, columns = grid.shape
    cells = round(half_widths[0] / resolution_m)
    turns = round(half_widths[1] / step_rad)
    side = 2 * cells + 1
    best, best_pose = -1.0, predicted.copy()
    total = np.empty((side, side), dtype=np.int64)
    for turn in range(-turns, turns + 1):
        yaw = predicted[2] + turn * step_rad
        c, s = np.cos(yaw), np.sin(yaw)
        total[:] = 0
        for i in range(points_m.shape[0]):
            px, py = points_m[i, 0], points_m[i, 1]
            x = int(np.floor((predicted[0] + c * px - s * py - left_m) / resolution_m)) - cells
            y = int(np.floor((predicted[1] + s * px + c * py - bottom_m) / resolution_m)) - cells
            for row in range(max(-y, 0), min(side, rows - y)):
                for column in range(max(-x, 0), min(side, columns - x)):
                    # Unsigned: signed indices would be checked for wrap-around in the inner loop.
                    total[row, column] += grid[np.uint64(y + row), np.uint64(x + column)]
        for row in range(side):
            for column in range(side):
                up, across = row - cells, column - cells
                away_m = np.hypot(up, across) * resolution_m
                away = prior_weight[0] * away_m + prior_weight[1] * abs(turn * step_rad)
                score = total[row, column] * np.exp(-away * away)
                if score > best:
                    best = score
                    best_pose[0] = predicted[0] + across * resolution_m
                    best_pose[1] = predicted[1] + up * resolution_m
                    best_pose[2] = yaw
    return best_pose


@compiled(error_model="numpy")
def interpolate(grid: ByteArray, x: float, y: float, out: FloatArray) -> None:
    """Write M and its derivatives in x and y, per cell, to ``out`` (3,); x, y in cells.

    All are zero where one of the sixteen cells about the point is outside of the grid.
    """
    rows, columns = grid.shape
    # The centre of cell (0, 0) lies at (0.5, 0.5).
    u, v = x - 0.5, y - 0.5
    column, row = int(np.floor(u)), int(np.floor(v))
    out[0] = out[1] = out[2] = 0.0
    if column < 1 or row < 1 or column + 2 >= columns or row + 2 >= rows:
        return
    f, g = u - column, v - row
    # Keys 1981, eq. 15: weights of the four neighbours along an axis, and their derivatives.
    x0 = ((-0.5 * f + 1.0) * f - 0.5) * f
    x1 = (1.5 * f - 2.5) * f * f + 1.0
    x2 = ((-1.5 * f + 2.0) * f + 0.5) * f
    x3 = (0.5 * f - 0.5) * f * f
    dx0 = (-1.5 * f + 2.0) * f - 0.5
    dx1 = (4.5 * f - 5.0) * f
    dx2 = (-4.5 * f + 4.0) * f + 0.5
    dx3 = (1.5 * f - 1.0) * f
    along_y = (
        ((-0.5 * g + 1.0) * g - 0.5) * g,
        (1.5 * g - 2.5) * g * g + 1.0,
        ((-1.5 * g + 2.0) * g + 0.5) * g,
        (0.5 * g - 0.5) * g * g,
    )
    slope_y = (
        (-1.5 * g + 2.0) * g - 0.5,
        (4.5 * g - 5.0) * g,
        (-4.5 * g + 4.0) * g + 0.5,
        (1.5 * g - 1.0) * g,
    )
    for k in range(4):
        r = row - 1 + k
        m0, m1 = float(grid[r, column - 1]), float(grid[r, column])
        m2, m3 = float(grid[r, column + 1]), float(grid[r, column + 2])
        value = x0 * m0 + x1 * m1 + x2 * m2 + x3 * m3
        out[0] += along_y[k] * value
        out[1] += along_y[k] * (dx0 * m0 + dx1 * m1 + dx2 * m2 + dx3 * m3)
        out[2] += slope_y[k] * value
    for k in range(3):
        out[k] /= FULL


@compiled(error_model="numpy")
def _gauss_newton(
    grid: ByteArray,
    left_m: float,
    bottom_m: float,
    resolution_m: float,
    points_m: FloatArray,
    start: FloatArray,
    predicted: FloatArray,
    prior: FloatArray,
) -> tuple[FloatArray, float, FloatArray]:
    """Pose, mean of M, and the points' information in the grid's axes, at the minimum of J.

    With Levenberg's damping: a step that increases J is undone and repeated shorter.
    """
    count = points_m.shape[0]
    scale = INFORMATION_OF_A_SCAN / count
    at = np.empty(3)
    row = np.empty(3)
    pose, best = start.copy(), start.copy()
    best_cost, best_occupancy, damping = np.inf, 0.0, 1e-4
    best_normal, best_slope = np.zeros((3, 3)), np.zeros(3)
    for _ in range(_ITERATIONS_MAX):
        c, s = np.cos(pose[2]), np.sin(pose[2])
        normal, slope = np.zeros((3, 3)), np.zeros(3)
        cost, occupancy = 0.0, 0.0
        for i in range(count):
            dx = c * points_m[i, 0] - s * points_m[i, 1]
            dy = s * points_m[i, 0] + c * points_m[i, 1]
            x = (pose[0] + dx - left_m) / resolution_m
            y = (pose[1] + dy - bottom_m) / resolution_m
            interpolate(grid, x, y, at)
            residual = 1.0 - at[0]
            row[0], row[1] = -at[1] / resolution_m, -at[2] / resolution_m
            row[2] = row[1] * dx - row[0] * dy
            occupancy += at[0]
            cost += scale * residual * residual
            for a in range(3):
                slope[a] += scale * row[a] * residual
                for b in range(a + 1):
                    normal[a, b] += scale * row[a] * row[b]
        for a in range(3):
            away = pose[a] - predicted[a]
            cost += prior[a] * away * away
            slope[a] += prior[a] * away
            for b in range(a):
                normal[b, a] = normal[a, b]
        if cost < best_cost:
            gain = best_cost - cost
            best_cost, best_occupancy = cost, occupancy / count
            best, best_normal, best_slope = pose, normal, slope
            damping = max(0.3 * damping, 1e-7)
            if gain < 1e-7 * cost:
                break
        else:
            damping *= 10.0
            if damping > 1e4:
                break
        damped = best_normal.copy()
        for a in range(3):
            damped[a, a] = (damped[a, a] + prior[a]) * (1.0 + damping) + 1e-6
        step = np.linalg.solve(damped, best_slope)
        if max(abs(step[0]), abs(step[1]), abs(step[2])) < _STEP_MIN:
            break
        pose = best - step
    return best, best_occupancy, best_normal
