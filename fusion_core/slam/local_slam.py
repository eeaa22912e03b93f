"""Local SLAM: each scan matched against the submaps that grow, one after the other (Hess 2016, IV).

It knows nothing of places seen before: its error grows slowly with the way, and what it gives is
the *local* frame, exact over short ways. Loops are closed in the pose graph.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.planar_poses import compose_poses, relative_pose, transform_planar_points
from fusion_core.model.sensors import LaserScan
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.odometry_noise import OdometryNoiseModel
from fusion_core.slam.scan_points import densified_points, scan_points
from fusion_core.slam.scan_to_grid import POINTS_MIN, GridMatch, correlative_match, match_scan
from fusion_core.slam.submaps import GrowingSubmap, Submap, SubmapSettings
from fusion_core.slam.tracking import Hold

# Every second point is enough to find the cell in which Gauss-Newton starts.
_POINT_STRIDE = 2
_TURN_STEP_RAD = np.radians(1.0)
# The lattice's own caution, for each metre and radian from the prediction. Weaker than this, a
# corridor's far end, which the submap does not know yet, holds every scan back by a cell.
_PRIOR_WEIGHT = (5.0, 1.0)
# Constant velocity is a guess and no measurement: so much less caution, and a wider search.
_GUESS_CAUTION = 0.25
_GUESS_SEARCH = 2.0
# Odometry is given up for a guess that fits by so much better: among leaves or behind glass every
# pose fits a little, and the wrong ones sometimes a little more.
_BETTER = 0.1
_SURE = 0.5
# Lost, it looks this much farther. What fits suddenly no more may have been carried away.
_LOST_SEARCH = 4.0
_OF_LATE = 4
# Where a scan fits nearly as well so far aside, it does not say where it is.
_ASIDE_M, _SIDES, _AS_GOOD = 0.3, 16, 0.9
# How fast a robot without odometry may go.
_PACE_M_S, _PACE_RAD_S = 1.0, 1.0
# Beyond this pace, and a late stamp's share, odometry has jumped.
_FASTEST_M_S, _FASTEST_RAD_S = 3.0, 3.0
_JUMP_M, _JUMP_RAD = 0.1, 0.1


class LocalSlamSettings(StageSettings):
    """Scan matching one after the other."""

    key_distance_m: float = setting(
        0.2, "Distance between two key scans", unit="m", ge=1e-6, le=5.0, formerly="key_step_m"
    )
    key_rotation_rad: float = setting(
        0.0873,
        "Rotation between two key scans",
        unit="rad",
        ge=1e-6,
        le=3.1416,
        formerly="key_turn_rad",
    )
    search_m: float = setting(
        0.15, "Correlative search about the prediction", unit="m", ge=0.0, le=2.0
    )
    search_rad: float = setting(
        0.14, "Correlative search about the prediction", unit="rad", ge=0.0, le=1.6
    )
    odometry_sigma_m_per_m: float = setting(
        0.3,
        "Initial standard deviation of odometry's distance",
        unit="m/m",
        ge=1e-6,
        le=10.0,
        formerly="odometry_m",
    )
    odometry_sigma_rad_per_rad: float = setting(
        0.5,
        "Initial standard deviation of odometry's rotation",
        unit="rad/rad",
        ge=1e-6,
        le=10.0,
        formerly="odometry_rad",
    )
    velocity_sigma_m: float = setting(
        0.2,
        "Standard deviation of the constant-velocity prediction",
        unit="m",
        ge=1e-6,
        le=10.0,
        formerly="guess_sigma_m",
    )
    velocity_sigma_rad: float = setting(
        0.4,
        "Standard deviation of the constant-velocity prediction",
        unit="rad",
        ge=1e-6,
        le=10.0,
        formerly="guess_sigma_rad",
    )
    occupancy_min: float = setting(
        0.35, "Least mean occupancy at a scan's points for a match", ge=0.0, le=1.0
    )
    occupancy_ratio_min: float = setting(
        0.7,
        "A scan contradicts the map below this fraction of the recent scans' occupancy",
        ge=0.0,
        le=1.0,
        formerly="drop",
    )
    uncertainty_max_m: float = setting(
        0.3,
        "Tracking is lost beyond this uncertainty, in metres or radians",
        unit="m",
        ge=1e-6,
        le=10.0,
        formerly="lost_m",
    )
    contradictions_max: int = setting(
        12,
        "So many scans that contradict the map begin a new segment",
        unit="scans",
        ge=1,
        le=1000,
        formerly="lost_scans",
    )
    beams_max: int = setting(360, "Beams used of a scan, evenly spread", ge=16, le=10_000)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalTrajectory:
    """What local SLAM knows of N scans, K of them key scans.

    ``stamps_ns``: (N,) strictly increasing. ``poses_local_scan``: (N, 3). ``occupancy``: (N,) mean
    occupancy of its submap at a scan's points, NaN where nothing was matched. ``key``: (K,) indices
    of the key scans, the first being 0. ``key_points_m``: K arrays (n, 2). ``part``: (K,) 0, 1,
    ...: between two parts no scan tells how the robot went. ``told``: (K,) odometry told the way to
    here from the last scan that was held by the map. ``adrift``: (N,) the scan may fit, but not in
    one place alone, and nothing else tells where it is. ``submaps``: in the order of their first
    key scan; none is of two parts. ``key_poses``: (K, 3) the key scans' poses in the local frame.
    """

    stamps_ns: IntArray
    poses_local_scan: FloatArray
    occupancy: FloatArray
    key_scans: IntArray
    node_points_m: Sequence[FloatArray]
    segment: IntArray
    is_bridged: BoolArray
    adrift: BoolArray
    submaps: Sequence[Submap]
    poses_local_node: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "poses_local_node", self.poses_local_scan[self.key_scans])
        for array in (
            self.stamps_ns,
            self.poses_local_scan,
            self.occupancy,
            self.key_scans,
            self.segment,
            self.is_bridged,
            self.adrift,
            self.poses_local_node,
        ):
            read_only(array)


class LocalSlam:
    """Takes scans in the order of their stamps. Memory follows the key scans."""

    def __init__(self, settings: LocalSlamSettings, submaps: SubmapSettings) -> None:
        self._settings, self._submap_settings = settings, submaps
        self._stamps_ns: list[int] = []
        self._poses: list[FloatArray] = []
        self._occupancy: list[float] = []
        self._key: list[int] = []
        self._key_points_m: list[FloatArray] = []
        self._part: list[int] = []
        self._told: list[bool] = []
        self._adrift: list[bool] = []
        self._growing: list[GrowingSubmap] = []
        self._finished: list[Submap] = []
        self._prior_before: FloatArray | None = None
        self._odometry = OdometryNoiseModel(
            settings.odometry_sigma_m_per_m, settings.odometry_sigma_rad_per_rad
        )
        self._hold = Hold(settings.uncertainty_max_m, settings.contradictions_max)
        self._is_broken = False
        self._has_points = False
        self._fitted: deque[float] = deque(maxlen=_OF_LATE)

    @property
    def trajectory_so_far(self) -> tuple[IntArray, FloatArray]:
        """Stamps (n,) and poses (n, 3) in the local frame of the scans so far."""
        return np.array(self._stamps_ns, dtype=np.int64), np.array(self._poses).reshape(-1, 3)

    def add_scan(self, scan: LaserScan, prior: FloatArray | None) -> None:
        """Place a scan. ``prior``: (3,) its pose by odometry, None where that is unknown.

        Raises ValueError for a stamp that is not later than the last one's.
        """
        if self._stamps_ns and scan.stamp_ns <= self._stamps_ns[-1]:
            raise ValueError(
                f"stamps must increase, got {scan.stamp_ns} after {self._stamps_ns[-1]}"
            )
        points_m = self.points(scan)
        self._has_points = points_m.size > 0
        pose, occupancy = self._place(scan.stamp_ns, points_m, prior)
        self._prior_before = prior
        self._stamps_ns.append(scan.stamp_ns)
        self._poses.append(pose)
        self._occupancy.append(occupancy)
        self._adrift.append(self._hold.is_adrift or self._hold.contradicts)
        if self._hold.breaks:
            self._break()
        is_map = points_m.shape[0] >= POINTS_MIN or not self._is_broken
        if self._is_key(pose) and is_map and not self._hold.contradicts:
            self._is_broken = False
            self._key.append(len(self._poses) - 1)
            self._key_points_m.append(points_m)
            self._part.append(self._hold.part)
            self._told.append(self._hold.is_told)
            self._insert(pose, densified_points(points_m, self._submap_settings.resolution_m))

    @property
    def last_pose(self) -> FloatArray:
        """(3,) of the last scan in the local frame."""
        return self._poses[-1]

    @property
    def fits_last(self) -> bool:
        """Whether the last scan fits those before it, or is the first one and has points."""
        if len(self._poses) == 1:
            return self._has_points
        # NaN compares false.
        return bool(self._occupancy[-1] >= self._settings.occupancy_min)

    def points(self, scan: LaserScan) -> FloatArray:
        """(n, 2) end points within reach, of at most ``beams_max`` beams."""
        return scan_points(scan, self._submap_settings.max_range_m, self._settings.beams_max)

    def drop_finished(self) -> None:
        """Drop what only loops need of the scans so far; the next are placed as if it were kept."""
        self._finished.clear()
        if self._key_points_m:
            self._key_points_m[-1] = np.empty((0, 2))

    def _break(self) -> None:
        """What follows is a map of its own."""
        end = len(self._key)
        self._finished += [submap.finish(end) for submap in self._growing]
        self._growing = []
        self._is_broken = True

    def finish(self) -> LocalTrajectory:
        """All that was found; the last submaps end with the last key scan.

        Raises ValueError where no scan was added.
        """
        if not self._poses:
            raise ValueError("no scan was added")
        end = len(self._key)
        submaps = [*self._finished, *(submap.finish(end) for submap in self._growing)]
        return LocalTrajectory(
            stamps_ns=np.array(self._stamps_ns, dtype=np.int64),
            poses_local_scan=np.array(self._poses),
            occupancy=np.array(self._occupancy),
            key_scans=np.array(self._key, dtype=np.int64),
            node_points_m=tuple(self._key_points_m),
            segment=np.array(self._part, dtype=np.int64),
            is_bridged=np.array(self._told, dtype=np.bool_),
            adrift=np.array(self._adrift, dtype=np.bool_),
            submaps=tuple(submaps),
        )

    def _place(
        self, stamp_ns: int, points_m: FloatArray, prior: FloatArray | None
    ) -> tuple[FloatArray, float]:
        """The scan's pose in the local frame, and how well it fits: NaN where it cannot be told."""
        if not self._poses:
            return np.zeros(3) if prior is None else np.array(prior, dtype=np.float64), np.nan
        guess = self._constant_velocity(stamp_ns)
        is_measured = prior is not None and self._prior_before is not None
        predicted = guess
        if prior is not None and self._prior_before is not None:
            predicted = compose_poses(self._poses[-1], relative_pose(self._prior_before, prior))
        step = relative_pose(self._poses[-1], predicted)
        is_plausible = is_measured and self._is_plausible(stamp_ns, step)
        sigma = self._odometry.sigma(step) if is_measured else None
        doubt = self._doubt_of_guess(stamp_ns) if sigma is None else self._odometry.error(step)
        if not self._growing or points_m.shape[0] < POINTS_MIN:
            self._odometry.discard_window()
            self._hold.carried(doubt, is_lost=bool(self._growing), is_measured=is_plausible)
            return predicted, np.nan
        match = self._match(
            points_m,
            predicted,
            sigma,
            1.0 if is_measured else _GUESS_SEARCH,
        )
        occupancy_min = self._settings.occupancy_min
        if match.occupancy < occupancy_min:
            match = self._recovered(points_m, match, predicted, guess, is_measured=is_measured)
        elif is_measured:
            match = self._unslipped(points_m, match, predicted, step)
        is_sudden = match.occupancy < self._settings.occupancy_ratio_min * self._reference
        if match.occupancy >= occupancy_min and not is_sudden:
            self._fitted.append(match.occupancy)
            is_sure = is_measured and not self._hold.is_doubtful
            is_held = is_sure or self._is_held(points_m, match.pose_grid_scan)
            self._hold.matched(doubt, is_held=is_held, is_measured=is_measured)
            return match.pose_grid_scan, match.occupancy
        self._odometry.discard_window()
        # Where scans have fitted less and less, among leaves, odometry may hold them nevertheless.
        self._hold.missed(doubt, contradicts=is_sudden, is_measured=is_plausible)
        if self._hold.breaks:
            self._fitted.clear()
        is_carried = self._hold.contradicts or self._hold.breaks
        return (predicted if is_carried else match.pose_grid_scan), match.occupancy

    def _recovered(
        self,
        points_m: FloatArray,
        match: GridMatch,
        predicted: FloatArray,
        guess: FloatArray,
        *,
        is_measured: bool,
    ) -> GridMatch:
        """A better match than one that does not fit: a stamp may be late, a wheel may slip."""
        searches = [(guess, _GUESS_SEARCH)] if is_measured else []
        if self._hold.misses > 0:
            searches.append((predicted, _LOST_SEARCH))
        for start, wider in searches:
            other = self._match(points_m, start, None, wider)
            if other.occupancy > max(match.occupancy + _BETTER, _SURE):
                return other
        return match

    def _unslipped(
        self, points_m: FloatArray, match: GridMatch, predicted: FloatArray, step: FloatArray
    ) -> GridMatch:
        """The match, without odometry's part where the scan refutes that; what odometry learns."""
        error = relative_pose(predicted, match.pose_grid_scan)
        if self._odometry.is_refuted(step, error, match.information):
            other = self._match(points_m, predicted, None, _GUESS_SEARCH)
            if other.occupancy > max(match.occupancy + _BETTER / 2.0, _SURE):
                match, error = other, relative_pose(predicted, other.pose_grid_scan)
        self._odometry.update(step, error, match.information)
        return match

    @property
    def _reference(self) -> float:
        """How well the last scans have fitted that did: NaN where that is hardly worth the name."""
        mean = float(np.mean(self._fitted)) if self._fitted else np.nan
        return mean if mean > _SURE else np.nan

    def _doubt_of_guess(self, stamp_ns: int) -> FloatArray:
        """(2,) metres and radians: nobody knows whether it stands or goes."""
        since_s = (stamp_ns - self._stamps_ns[-1]) / 1e9
        return np.array([_PACE_M_S * since_s, _PACE_RAD_S * since_s])

    def _is_plausible(self, stamp_ns: int, step: FloatArray) -> bool:
        """Whether a robot may have gone so far in the time: odometry that was reset jumps."""
        since_s = (stamp_ns - self._stamps_ns[-1]) / 1e9
        return bool(
            np.hypot(step[0], step[1]) < _JUMP_M + _FASTEST_M_S * since_s
            and abs(step[2]) < _JUMP_RAD + _FASTEST_RAD_S * since_s
        )

    def _is_held(self, points_m: FloatArray, pose: FloatArray) -> bool:
        """Whether the scan fits worse a little to any side: along a bare wall it does not.

        The information of a match does not tell: a wall's roughness feigns some along it.
        """
        here = self._sure_of_obstacles(points_m, pose)
        away = np.zeros((_SIDES, 3))
        angle = 2.0 * np.pi / _SIDES * np.arange(_SIDES)
        away[:, 0], away[:, 1] = _ASIDE_M * np.cos(angle), _ASIDE_M * np.sin(angle)
        best = max(self._sure_of_obstacles(points_m, pose + shift) for shift in away)
        return best < _AS_GOOD * here

    def _sure_of_obstacles(self, points_m: FloatArray, pose: FloatArray) -> int:
        """Sum of the older submap's cells at the points that lie on its grid."""
        submap = self._growing[0]
        cells = np.floor(
            (transform_planar_points(pose, points_m) - np.array(submap.corner_m))
            / self._submap_settings.resolution_m
        ).astype(np.int64)
        cells = cells[((cells >= 0) & (cells < submap.occupancy.shape[::-1])).all(axis=1)]
        return int(submap.occupancy[cells[:, 1], cells[:, 0]].astype(np.int64).sum())

    def _constant_velocity(self, stamp_ns: int) -> FloatArray:
        last = self._poses[-1]
        if len(self._poses) < 2:
            return last
        share = (stamp_ns - self._stamps_ns[-1]) / (self._stamps_ns[-1] - self._stamps_ns[-2])
        # After a pause nobody knows whether it went on.
        return compose_poses(last, min(share, 1.0) * relative_pose(self._poses[-2], last))

    def _match(
        self,
        points_m: FloatArray,
        predicted: FloatArray,
        sigma: FloatArray | None,
        wider: float = 1.0,
    ) -> GridMatch:
        """``sigma``: (2,) of the prediction in metres and radians, None where it is a guess."""
        settings = self._settings
        caution = 1.0 if sigma is not None else _GUESS_CAUTION
        if sigma is None:
            sigma = np.array([settings.velocity_sigma_m, settings.velocity_sigma_rad])
        submap, resolution_m = self._growing[0], self._submap_settings.resolution_m
        start = correlative_match(
            submap.occupancy,
            *submap.corner_m,
            resolution_m,
            points_m[::_POINT_STRIDE],
            predicted,
            (wider * settings.search_m, wider * settings.search_rad),
            _TURN_STEP_RAD,
            (_PRIOR_WEIGHT[0] * caution, _PRIOR_WEIGHT[1] * caution),
        )
        return match_scan(
            submap.occupancy,
            submap.corner_m,
            resolution_m,
            points_m,
            start,
            predicted=predicted,
            prior_sigma=(float(sigma[0]), float(sigma[1])),
        )

    def _is_key(self, pose: FloatArray) -> bool:
        if not self._key or self._is_broken:
            return True
        step = relative_pose(self._poses[self._key[-1]], pose)
        return bool(
            np.hypot(step[0], step[1]) > self._settings.key_distance_m
            or abs(step[2]) > self._settings.key_rotation_rad
        )

    def _insert(self, pose: FloatArray, points_m: FloatArray) -> None:
        """Add a key scan to the growing submaps, finish the older and begin a younger in time."""
        full = self._submap_settings.key_scans
        number = len(self._key) - 1
        if self._growing and self._growing[0].scans >= full:
            self._finished.append(self._growing.pop(0).finish(number))
        if not self._growing or (len(self._growing) == 1 and self._growing[0].scans >= full // 2):
            travel_m = 1.5 * full * self._settings.key_distance_m
            self._growing.append(GrowingSubmap(pose[:2], number, travel_m, self._submap_settings))
        for submap in self._growing:
            submap.add_scan(pose, points_m)
