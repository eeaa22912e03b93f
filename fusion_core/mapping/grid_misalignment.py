"""How one occupancy grid lies on another of the same place: shift and turn, with their uncertainty.

Grids of two sensors, drawn from the same poses, lie on each other unless a mount or a clock is
wrong. The occupied cells of the second are matched to those of the first: coarsely by correlation
over a window (Olson 2009), then by point-to-line least squares between cells and local lines
through cells, with Huber's weights.

Cells that are near each other share their errors, so the covariance is not that of independent
cells: those of a tile count as one observation (the sandwich estimator with clusters, Liang & Zeger
1986). To that is added the rounding to cells, which does not average out along a wall that is
parallel to the cells and so counts once for each wall, and the ambiguity of the correlation. A
direction in which the walls do not hold the map (the length of a corridor) is not observable and
its shift is NaN.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from fusion_core.mapping.wall_lines import WallLines, fit_wall_lines, wall_of_each
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only, wrap_angle
from fusion_core.model.errors import RegistrationFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.planar_poses import compose_poses, invert_pose, transform_planar_points
from fusion_core.registration.correlative import (
    CorrelativeMatch,
    SearchWindow,
    count_poses,
    match_correlative,
)
from fusion_core.registration.likelihood_grid import make_likelihood_pyramid
from fusion_core.registration.line_icp import find_unobservable_directions
from fusion_core.settings import StageSettings, setting

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# Set by hand: two walls of half a metre at 5 cm; fewer cells are furniture.
_CELLS_MIN = 20
# Of more occupied cells so many, evenly chosen, are matched: accuracy is limited by the rounding.
_CELLS_MATCHED_MAX = 4000
_TRUNCATION_CELLS, _PYRAMID_LEVELS = 3.0, 5
# Bounds on time and memory, set by hand: 5 degrees to either side at 25 m and cells of 5 cm are 87
# turns, and with 0.5 m 40,000 poses.
_TURNS_MAX, _POSES_MAX = 500, 100_000_000
# A cell and a line farther apart than this are not the same surface; within one cell each counts
# fully (Huber).
_PAIR_CELLS_MAX, _HUBER_CELLS = 3.0, 1.0
_ITERATIONS_MAX, _STEP_MIN_CELLS = 30, 1e-4
# Side of the tiles whose cells count as one observation: about the size of a piece of furniture.
_TILE_M, _TILES_MIN = 1.0, 4
# Both grids round to cells: a uniform distribution over one each.
_ROUNDING_CELLS2 = 2.0 / 12.0
# Fraction (squared cosine) of an unobservable direction above which an axis has no value.
_MIXED_FRACTION = 0.01
# Standard deviations beyond which a misalignment is more than chance.
_SIGNIFICANT_SIGMAS = 3.0


class GridFusionSettings(StageSettings):
    """Fusion of two grids (Fu 2024 §3.2), and their alignment before it.

    By default the misalignment is shown and not applied. The two grids come from one trajectory, so
    a true misalignment is an error of the mount or the clock, which no single shift of the map
    corrects: it turns with the robot. And sensors at different heights see different outlines of
    one thing, which can look like a shift.
    """

    alignment: Literal["off", "apply"] = setting(
        "off", "Show the estimated misalignment only, or move the second grid by it before fusing"
    )
    search_m: float = setting(
        0.5, "Greatest shift that is searched, to either side", unit="m", ge=0.05, le=2.0
    )
    search_deg: float = setting(
        5.0, "Greatest turn that is searched, to either side", unit="deg", ge=0.1, le=20.0
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GridMisalignment:
    """The motion that lays the second grid on the first, about ``centre_m`` in the map frame:
    p_first = R(yaw) (p_second - centre) + centre + shift.

    ``shift``: (3,) x, y in m and yaw in rad; NaN where not observable. ``covariance``: (3, 3) of
    it; NaN in the rows and columns of what is not observable. ``correction``: (3,) as ``shift``,
    with 0 along what is not observable; in a corridor at an angle to the axes neither x nor y is
    observable, and the correction is across it. ``pairs``: cells that lie on a line of the first.
    """

    shift: FloatArray
    covariance: FloatArray
    correction: FloatArray
    centre_m: FloatArray
    pairs: int

    def __post_init__(self) -> None:
        for array in (self.shift, self.covariance, self.correction, self.centre_m):
            read_only(array)

    @property
    def sigma(self) -> FloatArray:
        """(3,) standard deviations; NaN where not observable."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def is_significant(self) -> bool:
        """Whether any observable part is larger than chance would make it."""
        return bool((np.abs(self.shift) > _SIGNIFICANT_SIGMAS * self.sigma).any())

    @property
    def pose_first_second(self) -> FloatArray:
        """(3,) x, y, yaw of the correction in the map frame: p_first = R(yaw) p_second + (x, y)."""
        to_centre = np.array([*self.centre_m, 0.0])
        moved: FloatArray = compose_poses(
            compose_poses(to_centre, self.correction), invert_pose(to_centre)
        )
        return moved


class _Pairs(NamedTuple):
    """(k, 3) derivative of the residual by shift, (k,) residual and weight, (k, 2) the cell, (k,)
    the line, and (k, 3) derivative of the residual by a turn of its normal with its variance (k,).
    """

    rows: FloatArray
    residual_m: FloatArray
    weight: FloatArray
    points_m: FloatArray
    line: IntArray
    normal_rows: FloatArray
    normal_variance: FloatArray


def estimate_misalignment(
    first: OccupancyGrid, second: OccupancyGrid, settings: GridFusionSettings
) -> GridMisalignment:
    """The motion that lays ``second`` on ``first``.

    Raises RegistrationFailed where the grids have too few occupied cells in common.
    """
    from scipy.spatial import cKDTree

    resolution_m = first.resolution_m
    lines = fit_wall_lines(occupied_centres_m(first), resolution_m)
    cells_m = occupied_centres_m(second)
    if len(lines.points_m) < _CELLS_MIN or len(cells_m) < _CELLS_MIN:
        raise _too_few(min(len(lines.points_m), len(cells_m)))
    # What is far from any wall of the first was seen by the second alone.
    distance_m, _ = cKDTree(lines.points_m).query(
        cells_m, distance_upper_bound=settings.search_m + _PAIR_CELLS_MAX * resolution_m
    )
    cells_m = cells_m[np.isfinite(distance_m)]
    if len(cells_m) < _CELLS_MIN:
        raise _too_few(len(cells_m))
    cells_m = cells_m[:: -(-len(cells_m) // _CELLS_MATCHED_MAX)]
    centre_m = cells_m.mean(axis=0)
    about_centre = lines._replace(points_m=lines.points_m - centre_m)
    moving_m = cells_m - centre_m

    match = _search_window(about_centre.points_m, moving_m, resolution_m, settings)
    lever_m = max(float(np.sqrt((moving_m**2).sum(axis=1).mean())), resolution_m)
    shift, pairs = _refine(about_centre, moving_m, match.pose_map_points, lever_m, resolution_m)
    return _with_uncertainty(
        shift, pairs, about_centre, match, centre_m, lever_m, resolution_m, settings
    )


def occupied_centres_m(grid: OccupancyGrid) -> FloatArray:
    """(n, 2) x, y of the centres of the occupied cells in the map frame."""
    rows, columns = np.nonzero(grid.log_odds > 0.0)
    centres: FloatArray = np.array(grid.origin_m) + grid.resolution_m * (
        np.column_stack([columns, rows]) + 0.5
    )
    return centres


def _search_window(
    points_m: FloatArray, moving_m: FloatArray, resolution_m: float, settings: GridFusionSettings
) -> CorrelativeMatch:
    """The best of all whole cells and turns in the window."""
    rotation_rad = float(np.deg2rad(settings.search_deg))
    farthest_m = float(np.hypot(*moving_m.T).max())
    # A turn that moves the farthest cell by one cell; of a very long map no finer than this.
    step_rad = max(resolution_m / max(farthest_m, resolution_m), rotation_rad / _TURNS_MAX)
    poses = count_poses(settings.search_m, rotation_rad, resolution_m, step_rad)
    if poses > _POSES_MAX:
        raise RegistrationFailed(
            f"a window of {settings.search_m:g} m has {poses:.0f} poses of cells of "
            f"{resolution_m:g} m.",
            advice="Set a smaller grid_fusion.search_m or coarser cells.",
        )
    pyramid = make_likelihood_pyramid(
        points_m,
        resolution_m=resolution_m,
        truncation_m=_TRUNCATION_CELLS * resolution_m,
        levels=_PYRAMID_LEVELS,
    )
    window = SearchWindow(translation_m=settings.search_m, rotation_rad=rotation_rad)
    return match_correlative(pyramid, moving_m, window, step_rad=step_rad)


def _too_few(cells: int) -> RegistrationFailed:
    return RegistrationFailed(
        f"only {cells} occupied cells of one grid lie on walls of the other, and {_CELLS_MIN} are "
        "needed.",
        advice="Their alignment is not observable.",
    )


def _refine(
    lines: WallLines, moving_m: FloatArray, start: FloatArray, lever_m: float, resolution_m: float
) -> tuple[FloatArray, _Pairs]:
    """Iterated least squares; what is not observable stays at 0. Returns the shift (3,) and its
    pairs."""
    from scipy.spatial import cKDTree

    tree = cKDTree(lines.points_m)
    shift = start
    scale = np.array([1.0, 1.0, 1.0 / lever_m])
    pairs = _pair(tree, lines, moving_m, shift, resolution_m)
    for _ in range(_ITERATIONS_MAX):
        if pairs.weight.size < _CELLS_MIN:
            raise _too_few(pairs.weight.size)
        directions, strength, observable = _observable_directions(pairs, lever_m)
        gradient = (pairs.rows * scale).T @ (pairs.weight * pairs.residual_m)
        along = directions.T @ gradient
        step = directions @ np.where(observable, -along / np.where(observable, strength, 1.0), 0.0)
        shift = shift + step * scale
        shift[2] = wrap_angle(shift[2])
        pairs = _pair(tree, lines, moving_m, shift, resolution_m)
        if np.abs(step).max() < _STEP_MIN_CELLS * resolution_m:
            break
    return shift, pairs


def _observable_directions(
    pairs: _Pairs, lever_m: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Eigenvectors (3, 3; columns) of the information in (x, y, yaw · lever), its eigenvalues (3,),
    and which are observable."""
    information = (pairs.rows * pairs.weight[:, np.newaxis]).T @ pairs.rows
    noise = pairs.weight * pairs.normal_variance
    spurious = (pairs.normal_rows * noise[:, np.newaxis]).T @ pairs.normal_rows
    strength, directions, is_unobservable = find_unobservable_directions(
        information, spurious, lever_m
    )
    return directions, strength, ~is_unobservable


def _pair(
    tree: "cKDTree",
    lines: WallLines,
    moving_m: FloatArray,
    shift: FloatArray,
    resolution_m: float,
) -> _Pairs:
    """Each cell with the nearest line, where one is near."""
    turned_m = transform_planar_points(np.array([0.0, 0.0, shift[2]]), moving_m)
    points_m = turned_m + shift[:2]
    _, numbers = tree.query(points_m, distance_upper_bound=_PAIR_CELLS_MAX * resolution_m)
    nearest: IntArray = np.asarray(numbers, dtype=np.int64)
    found = nearest < len(lines.points_m)
    turned_m, points_m, nearest = turned_m[found], points_m[found], nearest[found]
    normals = lines.normals[nearest]
    residual_m = (normals * (points_m - lines.points_m[nearest])).sum(axis=1)
    tangents = np.column_stack([-normals[:, 1], normals[:, 0]])
    limit_m = _HUBER_CELLS * resolution_m
    return _Pairs(
        rows=_rows(normals, turned_m),
        residual_m=residual_m,
        weight=limit_m / np.maximum(np.abs(residual_m), limit_m),
        points_m=points_m,
        line=nearest,
        normal_rows=_rows(tangents, turned_m),
        normal_variance=lines.normal_variance[nearest],
    )


def _rows(directions: FloatArray, turned_m: FloatArray) -> FloatArray:
    """(k, 3) derivative of direction · (R(yaw) p + t) by (t_x, t_y, yaw)."""
    lever_m = directions[:, 1] * turned_m[:, 0] - directions[:, 0] * turned_m[:, 1]
    return np.column_stack([directions, lever_m])


def _with_uncertainty(
    shift: FloatArray,
    pairs: _Pairs,
    lines: WallLines,
    match: CorrelativeMatch,
    centre_m: FloatArray,
    lever_m: float,
    resolution_m: float,
    settings: GridFusionSettings,
) -> GridMisalignment:
    scale = np.array([1.0, 1.0, 1.0 / lever_m])
    directions, strength, observable = _observable_directions(pairs, lever_m)
    tiles = np.floor(pairs.points_m / _TILE_M).astype(np.int64)
    tile_rows = _sum_by_group(
        tiles, pairs.rows * scale * (pairs.weight * pairs.residual_m)[:, np.newaxis]
    )
    count = len(tile_rows)
    if count < _TILES_MIN:
        observable = np.zeros(3, dtype=np.bool_)
    wall_rows = _sum_by_group(
        wall_of_each(lines, resolution_m)[pairs.line],
        pairs.rows * scale * pairs.weight[:, np.newaxis],
    )
    noise = tile_rows.T @ tile_rows * count / max(count - 1, 1)
    noise += wall_rows.T @ wall_rows * _ROUNDING_CELLS2 * resolution_m**2
    basis = directions[:, observable]
    inverse = basis @ np.diag(1.0 / strength[observable]) @ basis.T
    # What is left of the correlation's covariance without the rounding to its own steps.
    ambiguity = match.covariance - np.diag(
        [match.step_m**2 / 12.0, match.step_m**2 / 12.0, match.step_rad**2 / 3.0]
    )
    covariance = inverse @ noise @ inverse + ambiguity / np.outer(scale, scale)

    # Nor is a direction observable in which poses of the whole window are as good as the best one.
    limits_m = np.array([settings.search_m] * 2 + [np.deg2rad(settings.search_deg) * lever_m])
    variances = np.einsum("ik,ij,jk->k", directions, covariance, directions)
    observable = observable & (variances < (directions.T**2) @ (limits_m**2 / 3.0))
    along = np.where(observable, directions.T @ (shift / scale), 0.0)
    correction = directions @ along * scale
    # An axis with more than a trifle of an unobservable direction has no value of its own.
    is_lost = (directions[:, ~observable] ** 2).sum(axis=1) > _MIXED_FRACTION
    covariance = covariance * np.outer(scale, scale)
    covariance[is_lost] = np.nan
    covariance[:, is_lost] = np.nan
    return GridMisalignment(
        shift=np.where(is_lost, np.nan, shift),
        covariance=covariance,
        correction=correction,
        centre_m=centre_m,
        pairs=int(pairs.weight.size),
    )


def _sum_by_group(groups: IntArray, rows: FloatArray) -> FloatArray:
    """(G, 3) sums of (k, 3) rows over the groups, each a (k, 2) pair of whole numbers."""
    _, group = np.unique(groups, axis=0, return_inverse=True)
    sums = np.zeros((int(group.max()) + 1, rows.shape[1]))
    np.add.at(sums, group.ravel(), rows)
    return sums
