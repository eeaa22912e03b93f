"""The particles: their poses, weights and maps, and how they go on by one scan.

Grisetti, Stachniss, Burgard 2007, algorithm 1.
"""

from typing import Self

import numpy as np
from pydantic import model_validator

from fusion_core.model.conventions import FloatArray, IntArray, wrap_angle
from fusion_core.model.planar_poses import compose_poses, transform_planar_points
from fusion_core.model.seeds import SEED_MAX
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.particle_maps import MapWindow, ParticleMaps, add_scan
from fusion_core.slam.particle_proposal import MotionModel, log_likelihoods, propose
from fusion_core.slam.submaps import check_grid_size
from fusion_core.slam.trajectory_tree import TrajectoryTree

# The interpolation of the map reads two cells either side.
_MARGIN_CELLS = 4
_SEARCH_SIGMAS = 2.0


class ParticleSettings(StageSettings):
    """The particle filter. The noise is that of scan-matched odometry, not of wheels."""

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
        0.05,
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


def effective_number(weights: FloatArray) -> float:
    """N_eff = 1 / Σ w², of weights (P,) whose sum is 1 (eq. 20)."""
    return float(1.0 / (weights @ weights))


def systematic_resample(weights: FloatArray, offset: float) -> IntArray:
    """(P,) the parent of each new particle, in rising order.

    One ``offset`` in [0, 1) for all: a particle has floor(P w) or ceil(P w) children.
    """
    count = weights.size
    marks = np.cumsum(weights)
    # Whatever rounding has made of the sum, the last particle with a weight takes the rest.
    marks[np.flatnonzero(weights)[-1] :] = np.inf
    parents: IntArray = np.searchsorted(marks, (np.arange(count) + offset) / count, side="right")
    return parents


class ParticleSet:
    """P particles, the scans of which come one by one; see ``particle_filter_slam``."""

    def __init__(self, settings: ParticleSettings) -> None:
        self._settings = settings
        self._rng = np.random.default_rng(settings.seed)
        count = settings.particles
        self.poses: FloatArray = np.zeros((count, 3))
        self.weights: FloatArray = np.full(count, 1.0 / count)
        self._log_weights: FloatArray = np.zeros(count)
        self.maps = ParticleMaps(count)
        # x, y, yaw and the occupancy at the points.
        self._paths = TrajectoryTree(count, 4)

    @property
    def best(self) -> int:
        """The particle of the greatest weight, the first of equals."""
        return int(np.argmax(self.weights))

    def best_path(self) -> FloatArray:
        """(K, 4) x, y, yaw of the best particle at each weighed scan, and occupancy there."""
        return self._paths.path(self.best)

    def begin(self, pose: FloatArray, points_m: FloatArray, wall_points_m: FloatArray) -> None:
        """Lay the first scan down; the map is what it saw."""
        self.poses[:] = pose
        for particle in range(len(self.poses)):
            self._insert(particle, points_m, wall_points_m)
        self._paths.add(np.column_stack([self.poses, np.full(len(self.poses), np.nan)]))

    def weigh(
        self,
        step: FloatArray,
        motion: MotionModel,
        points_m: FloatArray,
        wall_points_m: FloatArray,
    ) -> tuple[float, bool, int]:
        """Move by ``step`` (3,), weigh, resample where due: N_eff, whether, and the unmatched."""
        unmatched = 0
        occupancy = np.full(len(self.poses), np.nan)
        predicted = compose_poses(self.poses, step)
        for particle in range(len(self.poses)):
            found, gain = self._draw(particle, predicted[particle], motion, points_m)
            if found is None:
                unmatched += 1
            else:
                occupancy[particle] = found
            self._log_weights[particle] += self._settings.likelihood_gain * gain
            self._insert(particle, points_m, wall_points_m)
        self._log_weights -= self._log_weights.max()
        weights = np.exp(self._log_weights)
        self.weights = weights / weights.sum()
        self._paths.add(np.column_stack([self.poses, occupancy]))
        effective = effective_number(self.weights)
        is_due = effective < self._settings.resample_fraction * len(self.poses)
        if is_due:
            parents = systematic_resample(self.weights, float(self._rng.random()))
            self.poses = self.poses[parents]
            self.maps.resample(parents)
            self._paths.resample(parents)
            self._log_weights[:] = 0.0
            self.weights = np.full(len(self.poses), 1.0 / len(self.poses))
        return effective, is_due, unmatched

    def _draw(
        self, particle: int, predicted: FloatArray, motion: MotionModel, points_m: FloatArray
    ) -> tuple[float | None, float]:
        """Draw the particle's pose: the occupancy of its match, None without, and log weight."""
        settings = self._settings
        noise = self._rng.standard_normal(3)
        resolution_m = settings.resolution_m
        farthest_m = float(np.hypot(points_m[:, 0], points_m[:, 1]).max())
        # Where local matching was lost, the motion model is wide, and so is the search.
        search = (
            max(settings.search_m, _SEARCH_SIGMAS * motion.sigma_m),
            max(settings.search_rad, _SEARCH_SIGMAS * motion.sigma_rad),
        )
        margin_m = 2.0 * (search[0] + search[1] * farthest_m)
        window = self._window(
            particle, transform_planar_points(predicted, points_m), predicted, margin_m
        )
        corner_m = (window.first_column * resolution_m, window.first_row * resolution_m)
        occupancy = window.occupancy
        proposal = propose(
            occupancy,
            corner_m,
            resolution_m,
            points_m,
            predicted,
            motion,
            search=search,
            occupancy_min=settings.occupancy_min,
        )
        if proposal is None:
            # Algorithm 1 of the paper: the motion model proposes, the likelihood weighs.
            pose = predicted + motion.sigmas * noise
            pose[2] = wrap_angle(pose[2])
            self.poses[particle] = pose
            likelihood = log_likelihoods(
                occupancy, *corner_m, resolution_m, points_m, pose[np.newaxis]
            )
            return None, float(likelihood[0])
        pose = proposal.mean + np.linalg.cholesky(proposal.covariance) @ noise
        pose[2] = wrap_angle(pose[2])
        self.poses[particle] = pose
        return proposal.occupancy, proposal.log_evidence

    def _window(
        self, particle: int, ends_m: FloatArray, pose: FloatArray, margin_m: float
    ) -> MapWindow:
        """The particle's map about a scan."""
        resolution_m = self._settings.resolution_m
        low = np.minimum(ends_m.min(axis=0), pose[:2]) - margin_m
        high = np.maximum(ends_m.max(axis=0), pose[:2]) + margin_m
        first = np.floor(low / resolution_m).astype(np.int64) - _MARGIN_CELLS
        last = np.floor(high / resolution_m).astype(np.int64) + _MARGIN_CELLS
        return self.maps.window(
            particle, (int(first[1]), int(first[0])), (int(last[1]), int(last[0]))
        )

    def _insert(self, particle: int, points_m: FloatArray, wall_points_m: FloatArray) -> None:
        pose = self.poses[particle]
        ends_m = transform_planar_points(pose, points_m)
        window = self._window(particle, ends_m, pose, 0.0)
        corner = np.array([window.first_column, window.first_row], dtype=np.float64)
        resolution_m = self._settings.resolution_m
        add_scan(
            window.cells,
            pose[:2] / resolution_m - corner,
            transform_planar_points(pose, wall_points_m) / resolution_m - corner,
            ends_m / resolution_m - corner,
        )
        self.maps.write(particle, window)
