"""Local SLAM: each scan matched against the submaps that grow, one after the other (Hess 2016, IV).

It knows nothing of places seen before: its error grows slowly with the way, and what it gives is
the *local* frame, exact over short ways. Loops are closed in the pose graph.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, read_only, wrap_angle
from fusion_core.model.sensors import LaserScan
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.planar_poses import compose, relative
from fusion_core.slam.scan_to_grid import GridMatch, best_of_window, match_scan
from fusion_core.slam.submaps import GrowingSubmap, Submap, SubmapSettings

# Every second point is enough to find the cell in which Gauss-Newton starts.
_POINT_STRIDE = 2
_TURN_STEP_RAD = np.radians(1.0)
# The lattice's own caution, for each metre and radian from the prediction. Weaker than this, a
# corridor's far end, which the submap does not know yet, holds every scan back by a cell.
_CAUTION = (5.0, 1.0)
# Constant velocity is a guess and no measurement: so much more doubt, and a wider search.
_GUESS_DOUBT = 4.0
_GUESS_SEARCH = 2.0
# Two neighbours are of one wall unless it would be seen under less than 20 degrees.
_WALL_SLANT = 3.0
_WALL_TURN_RAD = np.radians(2.5)
# Fewer points than this fix no pose.
_POINTS_MIN = 10


class LocalSlamSettings(StageSettings):
    """Scan matching one after the other."""

    key_step_m: float = setting(0.2, "Way between two key scans", unit="m", gt=0.0, le=5.0)
    key_turn_rad: float = setting(
        0.0873, "Turn between two key scans", unit="rad", gt=0.0, le=3.1416
    )
    search_m: float = setting(0.15, "Search about the prediction", unit="m", ge=0.0, le=2.0)
    search_rad: float = setting(0.14, "Search about the prediction", unit="rad", ge=0.0, le=1.6)
    prior_sigma_m: float = setting(
        0.05, "Doubt of odometry between scans", unit="m", gt=0.0, le=10.0
    )
    prior_sigma_rad: float = setting(
        0.1, "Doubt of odometry between scans", unit="rad", gt=0.0, le=10.0
    )
    occupancy_min: float = setting(
        0.35, "A scan whose points lie on less, on average, does not fit", ge=0.0, le=1.0
    )
    beams_max: int = setting(360, "Beams used of a scan, evenly spread", ge=16, le=10_000)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LocalTrajectory:
    """What local SLAM knows of N scans, K of them key scans.

    ``stamps_ns``: (N,) strictly increasing. ``poses_local_scan``: (N, 3). ``occupancy``: (N,) mean
    occupancy of its submap at a scan's points, NaN where nothing was matched. ``key``: (K,)
    indices of the key scans, the first being 0. ``key_points_m``: K arrays (n, 2).
    ``submaps``: in the order of their first key scan.
    """

    stamps_ns: IntArray
    poses_local_scan: FloatArray
    occupancy: FloatArray
    key: IntArray
    key_points_m: Sequence[FloatArray]
    submaps: Sequence[Submap]

    def __post_init__(self) -> None:
        for array in (self.stamps_ns, self.poses_local_scan, self.occupancy, self.key):
            read_only(array)

    @property
    def key_poses(self) -> FloatArray:
        """(K, 3) the key scans' poses in the local frame."""
        return self.poses_local_scan[self.key]


class LocalSlam:
    """Takes scans in the order of their stamps. Memory follows the key scans."""

    def __init__(self, settings: LocalSlamSettings, submaps: SubmapSettings) -> None:
        self._settings, self._submap_settings = settings, submaps
        self._stamps_ns: list[int] = []
        self._poses: list[FloatArray] = []
        self._occupancy: list[float] = []
        self._key: list[int] = []
        self._key_points_m: list[FloatArray] = []
        self._growing: list[GrowingSubmap] = []
        self._finished: list[Submap] = []
        self._prior_before: FloatArray | None = None

    def add_scan(self, scan: LaserScan, prior: FloatArray | None) -> None:
        """Place a scan. ``prior``: (3,) its pose by odometry, None where that is unknown.

        Raises ValueError for a stamp that is not later than the last one's.
        """
        if self._stamps_ns and scan.stamp_ns <= self._stamps_ns[-1]:
            raise ValueError(
                f"stamps must increase, got {scan.stamp_ns} after {self._stamps_ns[-1]}"
            )
        points_m = self._points(scan)
        pose, occupancy = self._place(scan.stamp_ns, points_m, prior)
        self._prior_before = prior
        self._stamps_ns.append(scan.stamp_ns)
        self._poses.append(pose)
        self._occupancy.append(occupancy)
        if self._is_key(pose):
            self._key.append(len(self._poses) - 1)
            self._key_points_m.append(points_m)
            self._insert(pose, self._wall_points(points_m))

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
            key=np.array(self._key, dtype=np.int64),
            key_points_m=tuple(self._key_points_m),
            submaps=tuple(submaps),
        )

    def _points(self, scan: LaserScan) -> FloatArray:
        """(n, 2) end points within reach, of at most ``beams_max`` beams."""
        stride = -(-scan.ranges_m.size // self._settings.beams_max)
        ranges_m, angles_rad = scan.ranges_m[::stride], scan.angles_rad[::stride]
        # NaN compares false.
        used = (ranges_m > 0.0) & (ranges_m < self._submap_settings.reach_m)
        ranges_m, angles_rad = ranges_m[used], angles_rad[used]
        return np.stack([ranges_m * np.cos(angles_rad), ranges_m * np.sin(angles_rad)], axis=1)

    def _wall_points(self, points_m: FloatArray) -> FloatArray:
        """(n', 2) the points and, a cell apart, the wall between neighbours.

        A wall of dots would hold the next scan's dots, and with them every scan back.
        """
        if points_m.shape[0] < 2:
            return points_m
        step_m = np.diff(points_m, axis=0)
        gap_m = np.hypot(*step_m.T)
        range_m = np.hypot(*points_m.T)
        azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
        turn = np.abs(wrap_angle(np.diff(azimuth)))
        nearest_m = np.minimum(range_m[:-1], range_m[1:])
        is_wall = (gap_m < _WALL_SLANT * nearest_m * turn) & (turn < _WALL_TURN_RAD)
        pieces = np.ceil(gap_m / self._submap_settings.resolution_m).astype(np.int64)
        pieces[~is_wall] = 1
        first = np.repeat(np.arange(pieces.size), pieces)
        part = np.arange(first.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        between = points_m[first] + (part / pieces[first])[:, np.newaxis] * step_m[first]
        return np.concatenate([between, points_m[-1:]])

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
            predicted = compose(self._poses[-1], relative(self._prior_before, prior))
        if not self._growing or points_m.shape[0] < _POINTS_MIN:
            return predicted, np.nan
        match = self._match(points_m, predicted, is_guess=not is_measured)
        if is_measured and match.occupancy < self._settings.occupancy_min:
            # Odometry may be wrong too: a stamp that is late, a wheel that slips.
            other = self._match(points_m, guess, is_guess=True)
            match = max(match, other, key=lambda found: found.occupancy)
        return match.pose_grid_scan, match.occupancy

    def _constant_velocity(self, stamp_ns: int) -> FloatArray:
        last = self._poses[-1]
        if len(self._poses) < 2:
            return last
        share = (stamp_ns - self._stamps_ns[-1]) / (self._stamps_ns[-1] - self._stamps_ns[-2])
        # After a pause nobody knows whether it went on.
        return compose(last, min(share, 1.0) * relative(self._poses[-2], last))

    def _match(self, points_m: FloatArray, predicted: FloatArray, *, is_guess: bool) -> GridMatch:
        settings = self._settings
        doubt, wider = (_GUESS_DOUBT, _GUESS_SEARCH) if is_guess else (1.0, 1.0)
        submap, resolution_m = self._growing[0], self._submap_settings.resolution_m
        start = best_of_window(
            submap.occupancy,
            *submap.corner_m,
            resolution_m,
            points_m[::_POINT_STRIDE],
            predicted,
            (wider * settings.search_m, wider * settings.search_rad),
            _TURN_STEP_RAD,
            (_CAUTION[0] / doubt, _CAUTION[1] / doubt),
        )
        return match_scan(
            submap.occupancy,
            submap.corner_m,
            resolution_m,
            points_m,
            start,
            predicted=predicted,
            prior_sigma=(doubt * settings.prior_sigma_m, doubt * settings.prior_sigma_rad),
        )

    def _is_key(self, pose: FloatArray) -> bool:
        if not self._key:
            return True
        step = relative(self._poses[self._key[-1]], pose)
        return bool(
            np.hypot(step[0], step[1]) > self._settings.key_step_m
            or abs(step[2]) > self._settings.key_turn_rad
        )

    def _insert(self, pose: FloatArray, points_m: FloatArray) -> None:
        """Add a key scan to the growing submaps, finish the older and begin a younger in time."""
        full = self._submap_settings.key_scans
        number = len(self._key) - 1
        if self._growing and self._growing[0].scans >= full:
            self._finished.append(self._growing.pop(0).finish(number))
        if not self._growing or (len(self._growing) == 1 and self._growing[0].scans >= full // 2):
            travel_m = 1.5 * full * self._settings.key_step_m
            self._growing.append(GrowingSubmap(pose[:2], number, travel_m, self._submap_settings))
        for submap in self._growing:
            submap.add_scan(pose, points_m)
