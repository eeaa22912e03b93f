"""GMapping: SLAM with a Rao-Blackwellised particle filter (Grisetti, Stachniss, Burgard 2007).

Odometry is first improved by scan matching, once for all particles (local_slam.py), unless the
settings have it taken as it comes (``particle_filter.PUBLISHED``). After each step of ``step_m`` or
``step_rad``, the filter is updated by the scan (particle_filter.py, algorithm 1). Where a loop
closes, the particles whose map is consistent outweigh the others.

    result = particle_filter_slam(scans, odometry.at, ParticleSettings())
    result.poses_map_scan, result.effective, result.trusted
"""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import MappingFailed
from fusion_core.model.planar_poses import PosePrior, compose_poses, relative_pose
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import LaserScan
from fusion_core.model.slam_view import SlamObserver, SlamView, no_observer
from fusion_core.slam.interpolate_poses import interpolate_poses
from fusion_core.slam.local_slam import LocalSlam, LocalSlamSettings
from fusion_core.slam.local_trajectory import TrackedScan
from fusion_core.slam.particle_filter import FilterUpdate, ParticleFilter, ParticleSettings
from fusion_core.slam.particle_proposal import MotionModel
from fusion_core.slam.scan_points import densified_points
from fusion_core.slam.scan_to_grid import POINTS_MIN
from fusion_core.slam.submaps import SubmapSettings

# Updates between two calls of an observer, set by hand: a picture every few seconds.
_OBSERVED_EVERY = 20


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParticleResult:
    """Where each of N scans was, by the particle with the greatest weight at the end.

    ``stamps_ns``: (N,). ``poses_map_scan``: (N, 3) x, y, yaw of the LiDAR. ``trusted``: (N,) False
    where the scan did not fit the map or has no points, where nothing determines its place, and
    after a tracking loss if the map did not contain the place where the trajectory continues.
    ``keyframes``: (K,) numbers of the scans that updated the filter. Of each update: ``effective``
    (K,) the effective number of particles, ``resampled`` (K,) whether the particles were resampled,
    ``unmatched`` (K,) how many found no match and moved by odometry alone. ``particles``: (P, 3)
    and ``weights``: (P,) after the last update. ``tiles``: the largest number of map tiles in use.
    ``seconds``: of each stage, on the wall clock.
    """

    stamps_ns: IntArray
    poses_map_scan: FloatArray
    trusted: BoolArray
    keyframes: IntArray
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
            self.keyframes,
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
    it, and where it has no pose, velocity is taken to be constant. The first scan lies where the
    prior has it, else at the origin.

    Raises MappingFailed where there is no scan, or none has a point within range.
    """
    run = _Run(settings or ParticleSettings())
    for scan in scans:
        run.add_scan(scan, None if prior is None else prior(scan.stamp_ns))
        progress(len(run.stamps_ns), None, "weighing particles")
        # A view copies the whole trajectory, so none is made without an observer.
        if run.is_view_due and observer is not no_observer:
            observer(run.view())
    result = run.finish()
    observer(run.view())
    return result


class _Run:
    """A run over a recording: scan-matched odometry, the filter's updates, and poses between."""

    def __init__(self, settings: ParticleSettings) -> None:
        self._settings = settings
        self._local_slam = LocalSlam(
            LocalSlamSettings(),
            SubmapSettings(resolution_m=settings.resolution_m, max_range_m=settings.max_range_m),
        )
        self._filter = ParticleFilter(settings)
        # Of each scan: its stamp, and where the motion u_1:t alone has it.
        self.stamps_ns: list[int] = []
        self._poses_dead_reckoned: list[FloatArray] = []
        # Of the last scan: its pose by local SLAM and by odometry.
        self._pose_local_last: FloatArray | None = None
        self._pose_odom_last: FloatArray | None = None
        # Of each update.
        self._keyframes: list[int] = []
        self._updates: list[FilterUpdate] = []
        # (2,) of the motion since the last update, of place and heading.
        self._variance = np.zeros(2)
        self._tiles = 0
        self._seconds = {"scan_matching": 0.0, "particles": 0.0}
        self.is_view_due = False

    def add_scan(self, scan: LaserScan, pose_odom_scan: FloatArray | None) -> None:
        """Raises ValueError for a stamp that is not later than the last one's."""
        start_s = time.perf_counter()
        tracked = self._local_slam.add_scan(scan, pose_odom_scan)
        self._local_slam.drop_map()
        matched_s = time.perf_counter()
        self._seconds["scan_matching"] += matched_s - start_s
        self._add_motion(tracked, pose_odom_scan)
        self.stamps_ns.append(scan.stamp_ns)
        self.is_view_due = False
        if self._is_due(tracked):
            self._update(tracked)
            self.is_view_due = len(self._keyframes) % _OBSERVED_EVERY == 0
            self._tiles = max(self._tiles, self._filter.maps.tiles)
        self._seconds["particles"] += time.perf_counter() - matched_s

    def _add_motion(self, tracked: TrackedScan, pose_odom_scan: FloatArray | None) -> None:
        """Add a step of the motion and its variance."""
        pose_odom_last, self._pose_odom_last = self._pose_odom_last, pose_odom_scan
        pose_local_last, self._pose_local_last = self._pose_local_last, tracked.pose_local_scan
        if pose_local_last is None:
            self._poses_dead_reckoned.append(tracked.pose_local_scan)
            return
        settings = self._settings
        is_by_odometry = settings.prediction == "odometry"
        if is_by_odometry and pose_odom_last is not None and pose_odom_scan is not None:
            step, is_measured = relative_pose(pose_odom_last, pose_odom_scan), True
        else:
            step, is_measured = (
                relative_pose(pose_local_last, tracked.pose_local_scan),
                tracked.fits,
            )
        self._poses_dead_reckoned.append(
            compose_poses(self._poses_dead_reckoned[-1], step)
            if is_by_odometry
            else tracked.pose_local_scan
        )
        distance_m, rotation_rad = float(np.hypot(step[0], step[1])), abs(float(step[2]))
        self._variance += [
            distance_m * settings.sigma_m_per_m**2 + rotation_rad * settings.sigma_m_per_rad**2,
            distance_m * settings.sigma_rad_per_m**2 + rotation_rad * settings.sigma_rad_per_rad**2,
        ]
        if not is_measured:
            unmatched = np.array([settings.unmatched_sigma_m, settings.unmatched_sigma_rad])
            self._variance += unmatched**2

    def _is_due(self, tracked: TrackedScan) -> bool:
        """Whether the filter is updated; never by a scan without points."""
        if tracked.points_m.shape[0] < (POINTS_MIN if self._keyframes else 1):
            return False
        if not self._keyframes:
            return True
        step = self._step_since_update()
        return bool(
            np.hypot(step[0], step[1]) > self._settings.step_m
            or abs(step[2]) > self._settings.step_rad
        )

    def _step_since_update(self) -> FloatArray:
        return relative_pose(
            self._poses_dead_reckoned[self._keyframes[-1]], self._poses_dead_reckoned[-1]
        )

    def _update(self, tracked: TrackedScan) -> None:
        densified_m = densified_points(tracked.points_m, self._settings.resolution_m)
        if not self._keyframes:
            update = self._filter.initialise(tracked.pose_local_scan, tracked.points_m, densified_m)
        else:
            motion = MotionModel(
                sigma_m=float(np.sqrt(self._variance[0])),
                sigma_rad=float(np.sqrt(self._variance[1])),
            )
            step = self._step_since_update()
            update = self._filter.update(step, motion, tracked.points_m, densified_m)
        self._variance[:] = 0.0
        self._keyframes.append(len(self.stamps_ns) - 1)
        self._updates.append(update)

    def finish(self) -> ParticleResult:
        """Raises MappingFailed where there was no scan, or none with a point within range."""
        count = len(self.stamps_ns)
        if count == 0:
            raise MappingFailed("there is no scan to place.")
        if not self._keyframes:
            raise MappingFailed(
                f"none of {count} scans has a point within {self._settings.max_range_m:g} m.",
                advice="Check the ranges' limits, or set a larger max_range_m.",
            )
        best = self._filter.best_trajectory()
        keyframes = np.array(self._keyframes, dtype=np.int64)
        return ParticleResult(
            stamps_ns=np.array(self.stamps_ns, dtype=np.int64),
            poses_map_scan=interpolate_poses(
                np.array(self._poses_dead_reckoned), keyframes, best[:, :3]
            ),
            trusted=self._trusted(keyframes, best[:, 3]),
            keyframes=keyframes,
            effective=np.array([update.effective for update in self._updates]),
            resampled=np.array([update.is_resampled for update in self._updates], dtype=np.bool_),
            unmatched=np.array([update.unmatched for update in self._updates], dtype=np.int64),
            particles=self._filter.poses.copy(),
            weights=self._filter.weights.copy(),
            tiles=self._tiles,
            seconds=dict(self._seconds),
        )

    def _trusted(self, keyframes: IntArray, occupancy: FloatArray) -> BoolArray:
        """(N,) by local SLAM, and where the filter was updated (K,) by the particle's map, too.

        After a tracking loss, the map must contain the place where the next segment begins: else
        nothing determines how the robot got there, however well the next scans fit each other.
        """
        local = self._local_slam.finish()
        # NaN compares false.
        matches = occupancy >= self._settings.occupancy_min
        matches[0] = True
        trusted = local.is_trusted.copy()
        trusted[keyframes] &= matches
        segment = local.segment[np.maximum(local.nodes_before(np.arange(trusted.size)), 0)]
        for lost in np.unique(segment[segment > 0]):
            updates = np.flatnonzero(segment[keyframes] == lost)
            if updates.size == 0 or not matches[updates[0]]:
                trusted &= segment != lost
        return trusted

    def view(self) -> SlamView:
        """The estimate so far."""
        keyframes = np.array(self._keyframes, dtype=np.int64)
        effective = np.full(len(self.stamps_ns), np.nan)
        effective[keyframes] = [update.effective for update in self._updates]
        return SlamView(
            stage="weighing particles",
            stamps_ns=np.array(self.stamps_ns, dtype=np.int64),
            poses_map_scan=interpolate_poses(
                np.array(self._poses_dead_reckoned),
                keyframes,
                self._filter.best_trajectory()[:, :3],
            ),
            particles=self._filter.poses.copy(),
            weights=self._filter.weights.copy(),
            effective=effective,
            loops_m=np.empty((0, 4)),
        )
