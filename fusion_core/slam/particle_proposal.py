"""A particle's improved proposal: a Gaussian about the scan's match with the particle's own map.

Grisetti, Stachniss, Burgard 2007, III-B. The motion model alone is a poor proposal where a laser
is far more exact than odometry. So the map's likelihood is part of it:

    x̂ = argmax p(x | m_{t-1}, z_t, x'_t)         near the predicted pose x'_t
    x_j about x̂                                  where the likelihood is not negligible (eq. 15)
    τ_j = p(z_t | m_{t-1}, x_j) p(x_j | x_{t-1}, u_{t-1})
    η = Σ τ_j,  μ = Σ τ_j x_j / η,  Σ = Σ τ_j (x_j - μ)(x_j - μ)ᵀ / η       (eqs. 16 to 18)

and the particle's weight is multiplied by η (eq. 19), since the proposal is nearly the optimal one.

The likelihood is that of ``scan_to_grid``: log p(z | m, x) = -k/2n Σ (1 - M(x · p_i))², with the
map's smoothed occupancy M. Errors of beams on one wall are correlated, so that n beams count as
fewer independent ones, as given by k. The samples x_j are a lattice along the principal axes of the
likelihood at x̂: the sums are a quadrature of the integrals they stand for, with the volume of a
lattice cell as factor, so that the η of two particles can be compared.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import ByteArray, FloatArray, read_only, wrap_angle
from fusion_core.slam.scan_to_grid import (
    INFORMATION_OF_A_SCAN,
    LatticeSearch,
    ProbabilityGrid,
    correlative_match,
    interpolate,
    match_scan,
)

# The lattice, in standard deviations: its step, and in steps squared its radius, which is 2.8
# deviations. A wider step would miss bumps of the likelihood as small as a cell, which its
# curvature at the peak does not show.
_LATTICE_STEP, _LATTICE_RADIUS_SQUARED = 1.25, 5
# A match farther from the prediction than this multiple of the search has slid along a wall;
# empirical.
_SLIDE_MAX = 2.0


def _lattice() -> FloatArray:
    along = np.arange(-2.0, 3.0)
    points = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    inside: FloatArray = points[(points**2).sum(axis=1) <= _LATTICE_RADIUS_SQUARED]
    return _LATTICE_STEP * inside


_LATTICE: FloatArray = _lattice()


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionModel:
    """p(x | x', u): a Gaussian about the predicted pose, in metres along x and y and radians."""

    sigma_m: float
    sigma_rad: float

    @property
    def sigmas(self) -> FloatArray:
        """(3,)"""
        return np.array([self.sigma_m, self.sigma_m, self.sigma_rad])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposal:
    """Where a particle's next pose is drawn from.

    ``mean``: (3,) μ and ``covariance``: (3, 3) Σ in the grid's frame. ``log_evidence``: log η.
    ``occupancy``: mean of M at the match, in about [0, 1].
    """

    mean: FloatArray
    covariance: FloatArray
    log_evidence: float
    occupancy: float

    def __post_init__(self) -> None:
        read_only(self.mean)
        read_only(self.covariance)


def propose(
    grid: ProbabilityGrid,
    points_m: FloatArray,
    predicted: FloatArray,
    motion: MotionModel,
    *,
    search: LatticeSearch,
    occupancy_min: float,
) -> Proposal | None:
    """The proposal about the best match near ``predicted``, None where no match was found.

    ``points_m``: (n, 2), n >= 1. ``predicted``: (3,) x'_t in the grid's frame. A match with a mean
    occupancy below ``occupancy_min``, or twice as far away as was searched, is none.
    """
    # x̂, by a search on a lattice and Gauss-Newton.
    start = correlative_match(grid, points_m, predicted, search)
    sigma = (motion.sigma_m, motion.sigma_rad)
    match = match_scan(grid, points_m, start, predicted=predicted, prior_sigma=sigma)
    peak = match.pose_grid_scan
    away = np.abs(peak - predicted)
    away[2] = abs(wrap_angle(away[2]))
    searched = np.array([search.translation_m, search.translation_m, search.rotation_rad])
    limit = _SLIDE_MAX * searched + 2.0 * motion.sigmas
    # NaN compares false.
    if not (match.occupancy >= occupancy_min and (away <= limit).all()):
        return None
    # The likelihood's principal axes at x̂.
    c, s = np.cos(peak[2]), np.sin(peak[2])
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    curvature = axes @ match.information @ axes.T + np.diag(motion.sigmas**-2.0)
    root = np.linalg.cholesky(np.linalg.inv(curvature))
    # Eq. 15: the samples x_j = x̂ + steps.
    steps = _LATTICE @ root.T
    poses = peak + steps
    # τ_j, in logarithms.
    log_tau = log_likelihoods(grid, points_m[:: search.point_stride], poses)
    log_tau = log_tau + _log_motion(poses, predicted, motion)
    highest = log_tau.max()
    tau = np.exp(log_tau - highest)
    # Eqs. 16 to 18.
    eta = tau.sum()
    mean_step = tau @ steps / eta
    centred = steps - mean_step
    covariance = (centred * tau[:, np.newaxis]).T @ centred / eta
    mean = peak + mean_step
    mean[2] = wrap_angle(mean[2])
    volume = 3.0 * np.log(_LATTICE_STEP) + np.log(np.diag(root)).sum()
    return Proposal(
        mean=mean,
        covariance=(covariance + covariance.T) / 2.0,
        log_evidence=float(highest + np.log(eta) + volume),
        occupancy=match.occupancy,
    )


def _log_motion(poses: FloatArray, predicted: FloatArray, motion: MotionModel) -> FloatArray:
    """(J,) log p(x_j | x_{t-1}, u_{t-1}) of poses (J, 3)."""
    off = poses - predicted
    off[:, 2] = wrap_angle(off[:, 2])
    sigmas = motion.sigmas
    log_motion: FloatArray = -0.5 * ((off / sigmas) ** 2).sum(axis=1)
    log_motion -= np.log(sigmas).sum() + 1.5 * np.log(2.0 * np.pi)
    return log_motion


def log_likelihoods(grid: ProbabilityGrid, points_m: FloatArray, poses: FloatArray) -> FloatArray:
    """(J,) log p(z | m, x_j) of poses (J, 3), up to a constant. ``points_m``: (n, 2)."""
    values: FloatArray = _log_likelihoods(
        grid.cells, *grid.corner_m, grid.resolution_m, points_m, poses
    )
    return values


@compiled(error_model="numpy")
def _log_likelihoods(
    occupancy: ByteArray,
    left_m: float,
    bottom_m: float,
    resolution_m: float,
    points_m: FloatArray,
    poses: FloatArray,
) -> FloatArray:
    """``log_likelihoods`` with the fields of the grid one by one."""
    count = points_m.shape[0]
    result = np.empty(poses.shape[0])
    at = np.empty(3)
    for j in range(poses.shape[0]):
        c, s = np.cos(poses[j, 2]), np.sin(poses[j, 2])
        total = 0.0
        for i in range(count):
            x = poses[j, 0] + c * points_m[i, 0] - s * points_m[i, 1]
            y = poses[j, 1] + s * points_m[i, 0] + c * points_m[i, 1]
            interpolate(occupancy, (x - left_m) / resolution_m, (y - bottom_m) / resolution_m, at)
            total += (1.0 - at[0]) ** 2
        result[j] = -0.5 * INFORMATION_OF_A_SCAN / count * total
    return result
