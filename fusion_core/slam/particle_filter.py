"""The Rao-Blackwellised particle filter (Grisetti, Stachniss, Burgard 2007, algorithm 1).

    p(x_1:t, m | z_1:t, u_1:t-1) = p(m | x_1:t, z_1:t) p(x_1:t | z_1:t, u_1:t-1)          (eq. 1)

A particle is a trajectory x_1:t with the map m that follows from it. ``ParticleFilter.update`` is
the algorithm; the improved proposal is in particle_proposal.py, the maps that particles share are
in particle_maps.py, their trajectories in trajectory_tree.py.
"""

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from pydantic import model_validator

from fusion_core.model.conventions import FloatArray, IntArray, wrap_angle
from fusion_core.model.planar_poses import compose_poses, transform_planar_points
from fusion_core.model.seeds import SEED_MAX
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.particle_maps import MapWindow, ParticleMaps, add_scan
from fusion_core.slam.particle_proposal import MotionModel, log_likelihoods, propose
from fusion_core.slam.scan_to_grid import LatticeSearch, ProbabilityGrid
from fusion_core.slam.submaps import check_grid_size
from fusion_core.slam.trajectory_tree import TrajectoryTree

# Cells about a scan: bicubic interpolation reads two to either side, and a match moves by a few.
_MARGIN_CELLS = 4
# Where scan matching failed the motion model is wide, and so is the search: 95 % of its poses.
_SEARCH_SIGMAS = 2.0
# In the lattice search, per metre and radian. Little: the motion model decides afterwards.
_PRIOR_WEIGHT = (1.0, 1.0)


class ParticleSettings(StageSettings):
    """The particle filter.

    The motion noise is that of scan-matched odometry. Its translation after a metre is as measured
    in simulated corridors, 0.01 to 0.04 m (tests/slam/test_motion_noise.py): where walls do not
    constrain a pose, the particles spread by it, and what is too much is the result's error. Its
    rotation is several times what was measured: each particle's own match determines it anyway, and
    a scan that was matched wrongly for all particles can still be corrected by each.
    """

    prediction: Literal["scan_matching", "odometry"] = setting(
        "scan_matching",
        "Motion between updates: scan-matched once for all particles, or odometry as it comes",
    )
    particles: int = setting(30, "Number of particles", ge=1, le=1000)
    seed: int = setting(0, "Seed of all that is drawn", ge=0, le=SEED_MAX)
    resolution_m: float = setting(0.05, "Side of a map's cell", unit="m", ge=0.01, le=1.0)
    max_range_m: float = setting(
        30.0, "Points farther away are not used", unit="m", ge=1.0, le=200.0, formerly="reach_m"
    )
    step_m: float = setting(0.3, "Distance between two filter updates", unit="m", ge=1e-6, le=10)
    step_rad: float = setting(
        0.3, "Rotation between two filter updates", unit="rad", ge=1e-6, le=3.1416
    )
    search_m: float = setting(0.15, "Least search about the prediction", unit="m", ge=0.0, le=2.0)
    search_rad: float = setting(
        0.06, "Least search about the prediction", unit="rad", ge=0.0, le=1.6
    )
    sigma_m_per_m: float = setting(
        0.025,
        "Translation noise after a metre, growing with the distance's root",
        unit="m",
        ge=1e-6,
        le=10.0,
        formerly="drift_m",
    )
    sigma_rad_per_m: float = setting(
        0.02,
        "Rotation noise after a metre, growing with the distance's root",
        unit="rad",
        ge=1e-6,
        le=3.0,
        formerly="drift_rad",
    )
    sigma_m_per_rad: float = setting(
        0.01,
        "Translation noise after a radian, growing with the rotation's root",
        unit="m",
        ge=1e-6,
        le=10.0,
        formerly="turn_m",
    )
    sigma_rad_per_rad: float = setting(
        0.01,
        "Rotation noise after a radian, growing with the rotation's root",
        unit="rad",
        ge=1e-6,
        le=3.0,
        formerly="turn_rad",
    )
    unmatched_sigma_m: float = setting(
        0.2,
        "Translation noise added where scan matching failed",
        unit="m",
        ge=0.0,
        le=10.0,
        formerly="lost_m",
    )
    unmatched_sigma_rad: float = setting(
        0.15,
        "Rotation noise added where scan matching failed",
        unit="rad",
        ge=0.0,
        le=3.0,
        formerly="lost_rad",
    )
    likelihood_gain: float = setting(
        0.15,
        "Factor of a scan's log likelihood: errors of scans from one place are correlated",
        ge=1e-6,
        le=1,
        formerly="weight_share",
    )
    resample_fraction: float = setting(
        0.5,
        "Resample when fewer than this fraction of the particles are effective",
        ge=0.0,
        le=1.0,
        formerly="resample_share",
    )
    occupancy_min: float = setting(
        0.3, "Least mean occupancy at a scan's points for a match", ge=0.0, le=1.0
    )

    @model_validator(mode="after")
    def _bounded_cells(self) -> Self:
        check_grid_size(self.max_range_m, self.resolution_m)
        return self


PUBLISHED = ParticleSettings(
    prediction="odometry",
    likelihood_gain=1.0,
    sigma_m_per_m=0.1,
    sigma_rad_per_m=0.2,
    sigma_m_per_rad=0.1,
    sigma_rad_per_rad=0.2,
)
"""Algorithm 1 as printed: u is odometry's, which each particle improves by its own match alone, and
weights are multiplied by the whole of η. The paper has no values of the motion noise: these are the
defaults of GMapping, its implementation, in the units of ours. Particles, steps between updates and
the measurement model are ours in both."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterUpdate:
    """How an update went: N_eff, whether it resampled, and the particles that found no match."""

    effective: float
    is_resampled: bool
    unmatched: int


def effective_number(weights: FloatArray) -> float:
    """N_eff = 1 / Σ w², of weights (P,) whose sum is 1 (eq. 20)."""
    return float(1.0 / (weights @ weights))


def systematic_resample(weights: FloatArray, offset: float) -> IntArray:
    """(P,) the parent of each new particle, in rising order.

    ``offset``: in [0, 1), the one random number. A particle has floor(P w) or ceil(P w) children.
    """
    count = weights.size
    marks = np.cumsum(weights)
    # By rounding, the sum may be below 1: the last particle with a weight takes the rest.
    marks[np.flatnonzero(weights)[-1] :] = np.inf
    parents: IntArray = np.searchsorted(marks, (np.arange(count) + offset) / count, side="right")
    return parents


class ParticleFilter:
    """P particles and their update by one scan after the other.

    ``poses``: (P, 3) x_t. ``weights``: (P,), their sum 1.
    """

    def __init__(self, settings: ParticleSettings) -> None:
        self._settings = settings
        self._rng = np.random.default_rng(settings.seed)
        count = settings.particles
        self.poses: FloatArray = np.zeros((count, 3))
        self.weights: FloatArray = np.full(count, 1.0 / count)
        self._log_weights: FloatArray = np.zeros(count)
        self.maps = ParticleMaps(count)
        # x, y, yaw and the occupancy at the points.
        self._trajectories = TrajectoryTree(count, 4)

    @property
    def best(self) -> int:
        """The particle of the greatest weight, the first of equals."""
        return int(np.argmax(self.weights))

    def best_trajectory(self) -> FloatArray:
        """(K, 4) x, y, yaw of the best particle at each update, and the occupancy at the points."""
        return self._trajectories.path(self.best)

    def initialise(
        self, pose_map_scan: FloatArray, points_m: FloatArray, densified_m: FloatArray
    ) -> FilterUpdate:
        """Begin with the first scan; arguments as in ``update``."""
        self.poses[:] = pose_map_scan
        for particle in range(len(self.poses)):
            self._insert(particle, points_m, densified_m)
        self._trajectories.add(np.column_stack([self.poses, np.full(len(self.poses), np.nan)]))
        effective = effective_number(self.weights)
        return FilterUpdate(effective=effective, is_resampled=False, unmatched=0)

    def update(
        self, step: FloatArray, motion: MotionModel, points_m: FloatArray, densified_m: FloatArray
    ) -> FilterUpdate:
        """Algorithm 1. ``step``: (3,) u_{t-1}, since the last update; ``motion``: its noise.

        ``points_m``: (n, 2) the scan z_t; ``densified_m``: (n', 2) the same with points between
        neighbours on a wall.
        """
        settings = self._settings
        occupancy = np.full(len(self.poses), np.nan)
        search = self._make_search(motion)
        # x'_t = x_{t-1} ⊕ u_{t-1}
        predicted = compose_poses(self.poses, step)
        for particle in range(len(self.poses)):
            noise = self._rng.standard_normal(3)
            grid = self._grid_around(particle, predicted[particle], points_m, search)
            # Scan matching and the Gaussian about the match (eqs. 15 to 18).
            proposal = propose(
                grid,
                points_m,
                predicted[particle],
                motion,
                search=search,
                occupancy_min=settings.occupancy_min,
            )
            if proposal is None:
                # Failure: x_t ~ p(x_t | x_{t-1}, u_{t-1}),  w_t = w_{t-1} p(z_t | m_{t-1}, x_t)
                pose = predicted[particle] + motion.sigmas * noise
                gain = float(log_likelihoods(grid, points_m, _wrapped(pose)[np.newaxis])[0])
            else:
                # x_t ~ N(μ, Σ),  w_t = w_{t-1} η   (eq. 19)
                pose = proposal.mean + np.linalg.cholesky(proposal.covariance) @ noise
                gain = proposal.log_evidence
                occupancy[particle] = proposal.occupancy
            self.poses[particle] = _wrapped(pose)
            self._log_weights[particle] += settings.likelihood_gain * gain
            # m_t = integrateScan(m_{t-1}, x_t, z_t)
            self._insert(particle, points_m, densified_m)
        self._normalise_weights()
        self._trajectories.add(np.column_stack([self.poses, occupancy]))
        # N_eff (eq. 20), and resampling where it is below the threshold.
        effective = effective_number(self.weights)
        is_due = effective < settings.resample_fraction * len(self.poses)
        if is_due:
            self._resample()
        return FilterUpdate(
            effective=effective,
            is_resampled=is_due,
            unmatched=int(np.count_nonzero(np.isnan(occupancy))),
        )

    def _normalise_weights(self) -> None:
        self._log_weights -= self._log_weights.max()
        weights = np.exp(self._log_weights)
        self.weights = weights / weights.sum()

    def _resample(self) -> None:
        parents = systematic_resample(self.weights, float(self._rng.random()))
        self.poses = self.poses[parents]
        self.maps.resample(parents)
        self._trajectories.resample(parents)
        self._log_weights[:] = 0.0
        self.weights = np.full(len(self.poses), 1.0 / len(self.poses))

    def _make_search(self, motion: MotionModel) -> LatticeSearch:
        settings = self._settings
        return LatticeSearch(
            translation_m=max(settings.search_m, _SEARCH_SIGMAS * motion.sigma_m),
            rotation_rad=max(settings.search_rad, _SEARCH_SIGMAS * motion.sigma_rad),
            prior_weight=_PRIOR_WEIGHT,
        )

    def _grid_around(
        self, particle: int, pose: FloatArray, points_m: FloatArray, search: LatticeSearch
    ) -> ProbabilityGrid:
        """The particle's map where a scan near ``pose`` may lie."""
        farthest_m = float(np.hypot(points_m[:, 0], points_m[:, 1]).max())
        margin_m = 2.0 * (search.translation_m + search.rotation_rad * farthest_m)
        points_in_map_m = transform_planar_points(pose, points_m)
        window = self._window(particle, points_in_map_m, pose, margin_m)
        resolution_m = self._settings.resolution_m
        corner_m = (window.first_column * resolution_m, window.first_row * resolution_m)
        return ProbabilityGrid(window.occupancy, corner_m, resolution_m)

    def _window(
        self, particle: int, points_in_map_m: FloatArray, pose: FloatArray, margin_m: float
    ) -> MapWindow:
        """The particle's map about a scan, and a margin about that."""
        resolution_m = self._settings.resolution_m
        low = np.minimum(points_in_map_m.min(axis=0), pose[:2]) - margin_m
        high = np.maximum(points_in_map_m.max(axis=0), pose[:2]) + margin_m
        first = np.floor(low / resolution_m).astype(np.int64) - _MARGIN_CELLS
        last = np.floor(high / resolution_m).astype(np.int64) + _MARGIN_CELLS
        return self.maps.window(
            particle, (int(first[1]), int(first[0])), (int(last[1]), int(last[0]))
        )

    def _insert(self, particle: int, points_m: FloatArray, densified_m: FloatArray) -> None:
        """Add the scan to the particle's map, at the particle's pose."""
        pose = self.poses[particle]
        points_in_map_m = transform_planar_points(pose, points_m)
        window = self._window(particle, points_in_map_m, pose, 0.0)
        corner = np.array([window.first_column, window.first_row], dtype=np.float64)
        resolution_m = self._settings.resolution_m
        add_scan(
            window.cells,
            pose[:2] / resolution_m - corner,
            transform_planar_points(pose, densified_m) / resolution_m - corner,
            points_in_map_m / resolution_m - corner,
        )
        self.maps.write(particle, window)


def _wrapped(pose: FloatArray) -> FloatArray:
    """(3,) with the yaw in [-pi, pi)."""
    return np.array([pose[0], pose[1], wrap_angle(pose[2])])
