"""Straight pieces of the surfaces that keyframes have met, each side of its own.

A cell of a grid is as large as the walls' error, and says nothing of where in it a surface lies. A
surface element does: a line through the returns of all keyframes within a small radius, and of each
side from which it was seen the mean of these returns. The two sides of a thin panel are two
surfaces; one line for both would draw the robot towards it from either side.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.robust import NORMAL_MEDIAN_ABS
from fusion_core.settings import StageSettings, setting

# Returns are sorted by range into so many groups of equal size, each with a deviation of its own.
_RANGE_GROUPS = 12
# No 2D LiDAR measures better.
_SIGMA_MIN_M = 0.002
# Elements tried for a return, the nearest first: about a corner several are in reach.
_ELEMENTS_TRIED = 4


class SurfaceElementSettings(StageSettings):
    """Straight pieces of surfaces. Lengths are those of indoor walls and furniture; set by hand."""

    radius_m: float = setting(
        0.15, "Returns nearer than this are one element", unit="m", ge=0.01, le=10.0
    )
    distance_max_m: float = setting(
        0.12, "Returns farther off an element's line are none of its own", unit="m", ge=1e-3, le=10
    )
    returns_min: int = setting(12, "Fewest returns of an element", unit="returns", ge=3, le=10_000)
    flatness_max: float = setting(
        0.15, "Largest variance across an element, relative to that along it", ge=1e-3, le=1.0
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurfaceElements:
    """``centres_m``: (E, 2) in the map. ``normals``: (E, 2) of length 1, with ``normal_variances``:
    (E,) in rad²."""

    centres_m: FloatArray
    normals: FloatArray
    normal_variances: FloatArray

    def __post_init__(self) -> None:
        for array in (self.centres_m, self.normals, self.normal_variances):
            read_only(array)

    def __len__(self) -> int:
        return len(self.centres_m)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AssociatedReturns:
    """N of the returns, each with the side of an element that it met.

    ``returns``: (N,) their numbers. ``sides``: (N,) twice the element's number, and one more where
    it was seen against its normal. ``normals``: (N, 2), with ``normal_variances``: (N,) in rad².
    ``residuals_m``: (N,) how far each lies
    off the mean of its side, along the normal. ``sigmas_m``: (N,) the deviation of a return at its
    range, from these residuals.
    """

    returns: IntArray
    sides: IntArray
    normals: FloatArray
    normal_variances: FloatArray
    residuals_m: FloatArray
    sigmas_m: FloatArray

    def __post_init__(self) -> None:
        for array in (
            self.returns,
            self.sides,
            self.normals,
            self.normal_variances,
            self.residuals_m,
            self.sigmas_m,
        ):
            read_only(array)

    def __len__(self) -> int:
        return len(self.returns)


def find_surface_elements(
    points_in_map_m: FloatArray, settings: SurfaceElementSettings
) -> SurfaceElements:
    """The elements of (P, 2) returns, those with most returns first; none on one another."""
    from scipy.spatial import cKDTree

    side_m = settings.radius_m * 2.0 / 3.0
    cells = np.floor(points_in_map_m / side_m).astype(np.int64)
    _, cell_of, counts = np.unique(
        cells[:, 0] * (1 << 32) + cells[:, 1], return_inverse=True, return_counts=True
    )
    means_m = np.stack(
        [np.bincount(cell_of, column) / counts for column in points_in_map_m.T], axis=1
    ).reshape(-1, 2)
    seeds = np.argsort(-counts, kind="stable")
    seeds = seeds[counts[seeds] >= settings.returns_min]
    is_covered = np.zeros(len(counts), np.bool_)
    points, cells_about = cKDTree(points_in_map_m), cKDTree(means_m)
    centres, normals, normal_variances = [], [], []
    for seed in seeds.tolist():
        if is_covered[seed]:
            continue
        centre_m = means_m[seed]
        # A cell cuts a wall anywhere; the second circle lies on the middle of the wall.
        for _ in range(2):
            near_m = points_in_map_m[points.query_ball_point(centre_m, settings.radius_m)]
            centre_m = near_m.mean(axis=0)
        variances, axes = np.linalg.eigh(np.cov(near_m.T))
        normal, along = axes[:, 0], axes[:, 1]
        about = np.array(cells_about.query_ball_point(centre_m, settings.radius_m), np.int64)
        is_covered[about[np.abs((means_m[about] - centre_m) @ along) <= 0.75 * side_m]] = True
        is_covered[seed] = True
        if variances[0] <= settings.flatness_max * variances[1]:
            centres.append(centre_m)
            normals.append(normal)
            # Of the slope of a line through as many returns.
            normal_variances.append(variances[0] / (variances[1] * len(near_m)))
    return SurfaceElements(
        centres_m=np.array(centres).reshape(-1, 2),
        normals=np.array(normals).reshape(-1, 2),
        normal_variances=np.array(normal_variances),
    )


def associate_returns(
    elements: SurfaceElements,
    points_in_map_m: FloatArray,
    origins_in_map_m: FloatArray,
    settings: SurfaceElementSettings,
) -> AssociatedReturns:
    """The returns that lie on an element. ``points_in_map_m``: (P, 2), ``origins_in_map_m``: (P, 2)
    where the LiDAR stood. At least one element."""
    from scipy.spatial import cKDTree

    tried = min(_ELEMENTS_TRIED, len(elements))
    reach_m = float(np.hypot(settings.radius_m, settings.distance_max_m))
    away_m, found = cKDTree(elements.centres_m).query(
        points_in_map_m, k=[*range(1, tried + 1)], distance_upper_bound=reach_m
    )
    is_near = np.isfinite(away_m)
    found = np.where(is_near, found, 0)
    normals = elements.normals[found]
    offsets_m = points_in_map_m[:, np.newaxis] - elements.centres_m[found]
    across_m = np.einsum("pex,pex->pe", offsets_m, normals)
    along_m = offsets_m[..., 1] * normals[..., 0] - offsets_m[..., 0] * normals[..., 1]
    is_on = is_near & (np.abs(along_m) <= settings.radius_m)
    is_on &= np.abs(across_m) <= settings.distance_max_m
    # Elements overlap: the line that is nearer, and of two alike the one whose middle is.
    cost_m = np.where(is_on, np.abs(across_m) + 0.5 * np.abs(along_m), np.inf)
    chosen = cost_m.argmin(axis=1)
    returns = np.flatnonzero(np.isfinite(cost_m.min(axis=1)))
    chosen = chosen[returns]
    beams_m = points_in_map_m[returns] - origins_in_map_m[returns]
    own = normals[returns, chosen]
    is_against = np.einsum("nx,nx->n", beams_m, own) < 0.0
    sides = 2 * found[returns, chosen].astype(np.int64) + is_against
    residuals_m, sigmas_m = _residuals_by_side(
        across_m[returns, chosen], sides, np.hypot(*beams_m.T)
    )
    return AssociatedReturns(
        returns=returns,
        sides=sides,
        normals=own,
        normal_variances=elements.normal_variances[found[returns, chosen]],
        residuals_m=residuals_m,
        sigmas_m=sigmas_m,
    )


def _residuals_by_side(
    across_m: FloatArray, sides: IntArray, ranges_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N,) the residuals to the weighted mean of each side, and (N,) the deviation at each range.

    A triangulating LiDAR's noise grows tenfold over a room, so that near returns decide. Both are
    found in turn.
    """
    sigmas_m = np.ones(len(across_m))
    residuals_m = across_m
    if not len(across_m):
        return residuals_m, sigmas_m
    groups = np.array_split(np.argsort(ranges_m, kind="stable"), _RANGE_GROUPS)
    groups = [group for group in groups if group.size]
    middles_m = np.array([np.median(ranges_m[group]) for group in groups])
    for _ in range(3):
        weights = sigmas_m**-2.0
        means_m = np.bincount(sides, weights * across_m) / np.maximum(
            np.bincount(sides, weights), np.finfo(np.float64).tiny
        )
        residuals_m = across_m - means_m[sides]
        of_group_m = [np.median(np.abs(residuals_m[group])) / NORMAL_MEDIAN_ABS for group in groups]
        sigmas_m = np.maximum(np.interp(ranges_m, middles_m, of_group_m), _SIGMA_MIN_M)
    return residuals_m, sigmas_m
