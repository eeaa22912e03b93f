"""A particle's next pose: the scan matched with its own map, and a Gaussian about the match.

Grisetti, Stachniss, Burgard 2007, III-B. The motion model alone is a poor proposal where a laser
is far more exact than odometry. So the map's likelihood is part of it:

    x̂ = argmax p(x | m_{t-1}, z_t, x'_t)         near the predicted pose x'_t
    x_j about x̂                                  where the likelihood is not negligible (eq. 15)
    τ_j = p(z_t | m_{t-1}, x_j) p(x_j | x_{t-1}, u_{t-1})
    η = Σ τ_j,  μ = Σ τ_j x_j / η,  Σ = Σ τ_j (x_j - μ)(x_j - μ)ᵀ / η       (eqs. 16 to 18)

and the particle's weight grows by η (eq. 19), since the proposal is nearly the best one.

The likelihood is that of ``scan_to_grid``: log p(z | m, x) = -k/2n Σ (1 - M(x · p_i))², M being
the map's smoothed occupancy. Beams that meet one wall err together, so that n beams count as k
says and not as n independent ones. The samples x_j are a lattice, stretched as the curvature at x̂
is: the sums are then a quadrature of the integral they stand for, with the volume of a lattice
cell as its factor, and two particles' η can be compared.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import ByteArray, FloatArray, read_only, wrap_angle
from fusion_core.slam.scan_to_grid import (
    INFORMATION_OF_A_SCAN,
    correlative_match,
    interpolate,
    match_scan,
)

# In standard deviations, out to 2.8 of them. Wider steps would fall between the cells' bumps of
# the likelihood, which its curvature at the peak does not show.
_LATTICE_STEP = 1.25
_LATTICE_RADIUS_SQUARED = 5
# The search's own caution, for each metre and radian from the prediction; see best_of_window.
_PRIOR_WEIGHT = (1.0, 1.0)
_TURN_STEP_RAD = np.radians(1.0)
_POINT_STRIDE = 2
# A match this many times farther away than was searched has run off along a wall.
_FARTHEST = 2.0


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
    occupancy: ByteArray,
    corner_m: tuple[float, float],
    resolution_m: float,
    points_m: FloatArray,
    predicted: FloatArray,
    motion: MotionModel,
    *,
    search: tuple[float, float],
    occupancy_min: float,
) -> Proposal | None:
    """The proposal about the best match near ``predicted``, None where no match was found.

    ``occupancy``: (rows, columns) as ``scan_to_grid`` takes it. ``points_m``: (n, 2), n >= 1.
    ``predicted``: (3,) in the grid's frame. ``search``: how far about it in metres and radians. A
    match on whose points less than ``occupancy_min`` lies on average, or that is twice as far
    away as was searched, is none.
    """
    start = correlative_match(
        occupancy,
        *corner_m,
        resolution_m,
        points_m[::_POINT_STRIDE],
        predicted,
        search,
        _TURN_STEP_RAD,
        _PRIOR_WEIGHT,
    )
    sigma = (motion.sigma_m, motion.sigma_rad)
    match = match_scan(
        occupancy, corner_m, resolution_m, points_m, start, predicted=predicted, prior_sigma=sigma
    )
    peak = match.pose_grid_scan
    away = np.abs(peak - predicted)
    away[2] = abs(wrap_angle(away[2]))
    limit = _FARTHEST * np.array([search[0], search[0], search[1]]) + 2.0 * motion.sigmas
    # NaN compares false.
    if not (match.occupancy >= occupancy_min and (away <= limit).all()):
        return None
    c, s = np.cos(peak[2]), np.sin(peak[2])
    axes = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    curvature = axes @ match.information @ axes.T + np.diag(motion.sigmas**-2.0)
    return gaussian_about(
        occupancy,
        corner_m,
        resolution_m,
        points_m,
        peak,
        np.linalg.inv(curvature),
        predicted,
        motion,
        match.occupancy,
    )


def gaussian_about(
    occupancy: ByteArray,
    corner_m: tuple[float, float],
    resolution_m: float,
    points_m: FloatArray,
    peak: FloatArray,
    spread: FloatArray,
    predicted: FloatArray,
    motion: MotionModel,
    occupancy_at_peak: float,
) -> Proposal:
    """Eqs. 15 to 18 over the lattice about ``peak``.

    ``spread``: (3, 3) the covariance that the lattice follows. Other arguments as in ``propose``.
    """
    root = np.linalg.cholesky(spread)
    steps = _LATTICE @ root.T
    log_likelihood = log_likelihoods(
        occupancy, *corner_m, resolution_m, points_m[::_POINT_STRIDE], peak + steps
    )
    off = peak + steps - predicted
    off[:, 2] = wrap_angle(off[:, 2])
    sigmas = motion.sigmas
    log_motion = -0.5 * ((off / sigmas) ** 2).sum(axis=1)
    log_motion -= np.log(sigmas).sum() + 1.5 * np.log(2.0 * np.pi)
    log_tau = log_likelihood + log_motion
    highest = log_tau.max()
    tau = np.exp(log_tau - highest)
    total = tau.sum()
    mean_step = tau @ steps / total
    centred = steps - mean_step
    covariance = (centred * tau[:, np.newaxis]).T @ centred / total
    mean = peak + mean_step
    mean[2] = wrap_angle(mean[2])
    volume = 3.0 * np.log(_LATTICE_STEP) + np.log(np.diag(root)).sum()
    return Proposal(
        mean=mean,
        covariance=(covariance + covariance.T) / 2.0,
        log_evidence=float(highest + np.log(total) + volume),
        occupancy=occupancy_at_peak,
    )


@compiled(error_model="numpy")
def log_likelihoods(
    occupancy: ByteArray,
    left_m: float,
    bottom_m: float,
    resolution_m: float,
    points_m: FloatArray,
    poses: FloatArray,
) -> FloatArray:
    """(J,) log p(z | m, x_j) of poses (J, 3), but for what all poses have in common."""
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
