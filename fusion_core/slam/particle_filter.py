"""GMapping: SLAM with a Rao-Blackwellised particle filter (Grisetti, Stachniss, Burgard 2007).

    p(x_1:t, m | z_1:t, u_1:t-1) = p(m | x_1:t, z_1:t) p(x_1:t | z_1:t, u_1:t-1)          (eq. 1)

A particle is a way x_1:t with the map m that follows from it. Odometry is matched scan by scan
first, alike for all (particle_odometry.py); then, a step apart, a scan is weighed: each particle's
pose is drawn from a Gaussian about its match with the particle's own map (particle_proposal.py),
and its weight grows by how well that fits. Where a loop closes, the particles whose map agrees
with itself outweigh the others.

    result = particle_filter_slam(scans, odometry.at, ParticleSettings())
    result.poses_map_scan, result.effective, result.trusted
"""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import MappingFailed
from fusion_core.model.planar_poses import PosePrior, relative_pose
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import LaserScan
from fusion_core.model.slam_view import SlamObserver, SlamView, no_observer
from fusion_core.slam.interpolate_poses import interpolate_poses
from fusion_core.slam.local_slam import LocalSlamSettings
from fusion_core.slam.particle_odometry import LocalPose, ScanMatchedOdometry
from fusion_core.slam.particle_proposal import MotionModel
from fusion_core.slam.particle_set import ParticleSet, ParticleSettings, effective_number
from fusion_core.slam.scan_to_grid import POINTS_MIN
from fusion_core.slam.submaps import SubmapSettings

# Weighed scans between two calls of a watch.
_WATCHED = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParticleResult:
    """Where each of N scans was, by the particle with the greatest weight at the end.

    ``stamps_ns``: (N,). ``poses_map_scan``: (N, 3) x, y, yaw of the LiDAR. ``trusted``: (N,) False
    where the scan did not fit what was seen before it or has no points to fit, where nothing tells
    how far it went, and after a break of the way if the map did not know the place where it went
    on. ``key``: (K,) which scans were weighed. Of each of them: ``effective`` (K,) the effective
    number of particles and ``resampled`` (K,) whether they were drawn anew; ``unmatched`` (K,) how
    many particles found no match and moved by odometry alone. ``particles``: (P, 3) and
    ``weights``: (P,) at the last of them. ``tiles``: the most map tiles that were in use at a time.
    ``seconds``: of each stage, on the wall clock.
    """

    stamps_ns: IntArray
    poses_map_scan: FloatArray
    trusted: BoolArray
    key: IntArray
    effective: FloatArray
    resampled: BoolArray
    unmatched: IntArray
    particles: FloatArray
    weights: FloatArray
    tiles: int
    seconds: Mapping[str, float]

    def __post_init__(self) -> None:
        for array in (
            self.stamps_ns,
            self.poses_map_scan,
            self.trusted,
            self.key,
            self.effective,
            self.resampled,
            self.unmatched,
            self.particles,
            self.weights,
        ):
            read_only(array)


def particle_filter_slam(
    scans: Iterable[LaserScan],
    prior: PosePrior | None = None,
    settings: ParticleSettings | None = None,
    progress: Progress = silent,
    observer: SlamObserver = no_observer,
) -> ParticleResult:
    """Place every scan.

    ``scans``: stamps strictly increasing; read once, and not kept. ``prior``: odometry; without
    it, and where it knows nothing, velocity is taken to be constant. The first scan lies where the
    prior has it, else at the origin.

    Raises MappingFailed where there is no scan, or none has a point within reach.
    """
    run = _Run(settings or ParticleSettings())
    for scan in scans:
        run.add_scan(scan, None if prior is None else prior(scan.stamp_ns))
        progress(len(run.stamps_ns), None, "weighing particles")
        # A view is as long as the way so far: none is made for nobody.
        if run.is_worth_a_look and observer is not no_observer:
            observer(run.view())
    result = run.finish()
    observer(run.view())
    return result


class _Run:
    """A whole run: odometry, which scans are weighed, and the ways between them."""

    def __init__(self, settings: ParticleSettings) -> None:
        self._settings = settings
        self._odometry = ScanMatchedOdometry(
            LocalSlamSettings(),
            SubmapSettings(resolution_m=settings.resolution_m, max_range_m=settings.max_range_m),
        )
        self._particles = ParticleSet(settings)
        self.stamps_ns: list[int] = []
        self._local_poses: list[FloatArray] = []
        self._is_sure: list[bool] = []
        self._key: list[int] = []
        self._effective: list[float] = []
        self._resampled: list[bool] = []
        self._unmatched: list[int] = []
        self._variance = np.zeros(2)
        self._tiles = 0
        self._seconds = {"scan_matching": 0.0, "particles": 0.0}
        self.is_worth_a_look = False

    def add_scan(self, scan: LaserScan, prior: FloatArray | None) -> None:
        """Raises ValueError for a stamp that is not later than the last one's."""
        start_s = time.perf_counter()
        placed = self._odometry.place(scan, prior)
        matched_s = time.perf_counter()
        self._seconds["scan_matching"] += matched_s - start_s
        if self._local_poses:
            self._variance += self._noise(
                relative_pose(self._local_poses[-1], placed.pose_local_scan)
            )
            if not placed.is_sure:
                lost = np.array(
                    [self._settings.unmatched_sigma_m, self._settings.unmatched_sigma_rad]
                )
                self._variance += lost**2
        self.stamps_ns.append(scan.stamp_ns)
        self._local_poses.append(placed.pose_local_scan)
        self._is_sure.append(placed.is_sure)
        self.is_worth_a_look = False
        if self._is_due(placed):
            self._weigh(placed)
            self.is_worth_a_look = len(self._key) % _WATCHED == 0
            self._tiles = max(self._tiles, self._particles.maps.tiles)
        self._seconds["particles"] += time.perf_counter() - matched_s

    def _noise(self, step: FloatArray) -> FloatArray:
        """(2,) variances of place and heading that a step of local SLAM adds."""
        settings = self._settings
        way_m, turn = float(np.hypot(step[0], step[1])), abs(float(step[2]))
        return np.array(
            [
                way_m * settings.sigma_m_per_m**2 + turn * settings.sigma_m_per_rad**2,
                way_m * settings.sigma_rad_per_m**2 + turn * settings.sigma_rad_per_rad**2,
            ]
        )

    def _is_due(self, placed: LocalPose) -> bool:
        # A blind scan is no evidence: the next one that sees is weighed.
        if placed.points_m.shape[0] < (POINTS_MIN if self._key else 1):
            return False
        if not self._key:
            return True
        step = relative_pose(self._local_poses[self._key[-1]], placed.pose_local_scan)
        return bool(
            np.hypot(step[0], step[1]) > self._settings.step_m
            or abs(step[2]) > self._settings.step_rad
        )

    def _weigh(self, placed: LocalPose) -> None:
        if not self._key:
            self._particles.begin(placed.pose_local_scan, placed.points_m, placed.wall_points_m)
            found = (effective_number(self._particles.weights), False, 0)
        else:
            found = self._particles.weigh(
                relative_pose(self._local_poses[self._key[-1]], placed.pose_local_scan),
                MotionModel(
                    sigma_m=float(np.sqrt(self._variance[0])),
                    sigma_rad=float(np.sqrt(self._variance[1])),
                ),
                placed.points_m,
                placed.wall_points_m,
            )
        self._variance[:] = 0.0
        self._key.append(len(self.stamps_ns) - 1)
        effective, is_resampled, unmatched = found
        self._effective.append(effective)
        self._resampled.append(is_resampled)
        self._unmatched.append(unmatched)

    def finish(self) -> ParticleResult:
        """Raises MappingFailed where there was no scan, or none with a point within reach."""
        count = len(self.stamps_ns)
        if count == 0:
            raise MappingFailed("there is no scan to place.")
        if not self._key:
            raise MappingFailed(
                f"none of {count} scans has a point within {self._settings.max_range_m:g} m.",
                advice="Check the ranges' limits, or set a larger max_range_m.",
            )
        way = self._particles.best_path()
        key = np.array(self._key, dtype=np.int64)
        return ParticleResult(
            stamps_ns=np.array(self.stamps_ns, dtype=np.int64),
            poses_map_scan=interpolate_poses(np.array(self._local_poses), key, way[:, :3]),
            trusted=self._trusted(key, way[:, 3]),
            key=key,
            effective=np.array(self._effective),
            resampled=np.array(self._resampled, dtype=np.bool_),
            unmatched=np.array(self._unmatched, dtype=np.int64),
            particles=self._particles.poses.copy(),
            weights=self._particles.weights.copy(),
            tiles=self._tiles,
            seconds=dict(self._seconds),
        )

    def _trusted(self, key: IntArray, occupancy: FloatArray) -> BoolArray:
        """(N,) by local SLAM, and where weighed (K,) by the particle's own map, too.

        Where local SLAM lost its way, the map must know the place to which it came: else nothing
        tells how the robot got there, however well the scans after that fit each other.
        """
        local = self._odometry.finish()
        # NaN compares false.
        matches = occupancy >= self._settings.occupancy_min
        matches[0] = True
        trusted = np.array(self._is_sure) & ~local.adrift
        trusted[key] &= matches
        number = np.arange(trusted.size)
        part = local.segment[
            np.maximum(np.searchsorted(local.key_scans, number, side="right") - 1, 0)
        ]
        for of in np.unique(part[part > 0]):
            weighed = np.flatnonzero(part[key] == of)
            if weighed.size == 0 or not matches[weighed[0]]:
                trusted &= part != of
        return trusted

    def view(self) -> SlamView:
        """What is believed now."""
        key = np.array(self._key, dtype=np.int64)
        effective = np.full(len(self.stamps_ns), np.nan)
        effective[key] = self._effective
        return SlamView(
            stage="weighing particles",
            stamps_ns=np.array(self.stamps_ns, dtype=np.int64),
            poses_map_scan=interpolate_poses(
                np.array(self._local_poses), key, self._particles.best_path()[:, :3]
            ),
            particles=self._particles.poses.copy(),
            weights=self._particles.weights.copy(),
            effective=effective,
            loops_m=np.empty((0, 4)),
        )
