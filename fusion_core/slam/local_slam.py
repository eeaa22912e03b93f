"""Local SLAM: each scan is matched with the submap that its predecessors built.

After Hess et al. 2016, "Real-time loop closure in 2D LIDAR SLAM", section IV. Poses are in the
*local* frame, whose error grows slowly with the path; loops are closed in the pose graph. The
steps of ``LocalSlam.add_scan`` are in separate files: ``scan_points``, ``prediction`` (with
``odometry_noise``), ``scan_to_grid``, ``tracking`` (with ``observability``), ``submaps``.
"""

from collections import deque

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.planar_poses import relative_pose
from fusion_core.model.sensors import LaserScan
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.identifiers import NodeId
from fusion_core.slam.local_trajectory import LocalTrajectory, TrackedScan
from fusion_core.slam.observability import is_well_constrained
from fusion_core.slam.odometry_noise import OdometryNoiseModel
from fusion_core.slam.prediction import PosePredictor, Prediction
from fusion_core.slam.scan_points import densified_points, scan_points
from fusion_core.slam.scan_to_grid import (
    POINTS_MIN,
    GridMatch,
    LatticeSearch,
    ProbabilityGrid,
    correlative_match,
    match_scan,
)
from fusion_core.slam.submaps import ActiveSubmaps, SubmapSettings
from fusion_core.slam.tracking import TrackingMonitor, TrackingState

# The prior's weight in the correlative search, per metre and per radian. With less, a scan that
# sees the end of a corridor for the first time is pulled back by a cell. Constant velocity, which
# is no measurement, has a quarter of the weight. Empirical.
_ODOMETRY_WEIGHT, _VELOCITY_WEIGHT = (5.0, 1.0), (1.25, 0.25)
# The search's size as a multiple of the settings': without odometry, and after a mismatch.
_VELOCITY_SEARCH, _RELOCALISATION_SEARCH = 2.0, 4.0
# A match without odometry replaces one with it if its occupancy is higher by the gain (half of it
# where odometry was refuted) and above the second value: among leaves or behind glass every pose
# fits a little. Empirical; tests/benchmarks/bench_faults.py shows the effect.
_OCCUPANCY_GAIN_MIN, _OCCUPANCY_SURE = 0.1, 0.5
# Number of matches whose mean occupancy a scan is compared with; empirical.
_RECENT_MATCHES = 4


class LocalSlamSettings(StageSettings):
    """Matching scans with submaps."""

    keyframe_distance_m: float = setting(
        0.2,
        "Distance at which a new keyframe is taken",
        unit="m",
        ge=1e-6,
        le=5.0,
        formerly="key_step_m",
    )
    keyframe_rotation_rad: float = setting(
        0.0873,
        "Rotation at which a new keyframe is taken",
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
        "Consecutive scans that contradict the map after which a new segment begins",
        unit="scans",
        ge=1,
        le=1000,
        formerly="lost_scans",
    )
    beams_max: int = setting(360, "Beams used of a scan, evenly spread", ge=16, le=10_000)
    speed_max_m_s: float = setting(
        3.0,
        "Highest speed of the robot; faster steps of odometry are errors",
        unit="m/s",
        ge=0.1,
        le=100.0,
    )
    speed_max_rad_s: float = setting(
        3.0, "Highest angular speed of the robot", unit="rad/s", ge=0.1, le=100.0
    )


class LocalSlam:
    """Places scans in the order of their stamps. Memory follows the keyframes."""

    def __init__(self, settings: LocalSlamSettings, submaps: SubmapSettings) -> None:
        self._settings, self._submap_settings = settings, submaps
        self._odometry_noise = OdometryNoiseModel(
            settings.odometry_sigma_m_per_m, settings.odometry_sigma_rad_per_rad
        )
        self._velocity_sigma = np.array([settings.velocity_sigma_m, settings.velocity_sigma_rad])
        self._predictor = PosePredictor(
            self._odometry_noise,
            self._velocity_sigma,
            np.array([settings.speed_max_m_s, settings.speed_max_rad_s]),
        )
        self._tracking = TrackingMonitor(settings.uncertainty_max_m, settings.contradictions_max)
        self._submaps = ActiveSubmaps(submaps, settings.keyframe_distance_m)
        self._recent_occupancy: deque[float] = deque(maxlen=_RECENT_MATCHES)
        # Of each scan.
        self._stamps_ns: list[int] = []
        self._poses: list[FloatArray] = []
        self._is_trusted: list[bool] = []
        # Of each keyframe.
        self._keyframes: list[int] = []
        self._node_points_m: list[FloatArray] = []
        self._segments: list[int] = []
        self._is_bridged: list[bool] = []

    def add_scan(self, scan: LaserScan, pose_odom_scan: FloatArray | None) -> TrackedScan:
        """Place a scan. ``pose_odom_scan``: (3,) its pose by odometry, None where it is unknown.

        Raises ValueError for a stamp that is not later than the last one's.
        """
        if self._stamps_ns and scan.stamp_ns <= self._stamps_ns[-1]:
            raise ValueError(
                f"stamps must increase, got {scan.stamp_ns} after {self._stamps_ns[-1]}"
            )
        # The scan's points (IV.A).
        points_m = scan_points(scan, self._submap_settings.max_range_m, self._settings.beams_max)

        # Predict: the initial estimate, by odometry or constant velocity (IV.C).
        prediction = self._predictor.predict(scan.stamp_ns, pose_odom_scan)

        # Match with the older growing submap: correlative search, then eq. CS (IV.C).
        match = self._match(points_m, prediction)

        # Decide whether the match or the prediction determines the pose.
        tracked = self._update_tracking(points_m, prediction, match)

        # Insert into both growing submaps, if the scan has moved far enough (IV.B).
        self._insert(tracked)

        self._predictor.update(scan.stamp_ns, tracked.pose_local_scan, pose_odom_scan)
        self._stamps_ns.append(scan.stamp_ns)
        self._poses.append(tracked.pose_local_scan)
        self._is_trusted.append(tracked.is_trusted)
        return tracked

    def _match(self, points_m: FloatArray, prediction: Prediction) -> GridMatch | None:
        """The scan's best match, None without enough points or a submap."""
        grid = self._submaps.matched
        if grid is None or points_m.shape[0] < POINTS_MIN:
            return None
        if not prediction.has_odometry:
            match = self._match_by_velocity(grid, points_m, prediction.pose)
        else:
            match = self._match_near(
                grid,
                points_m,
                prediction.pose,
                prediction.sigma,
                self._make_search(1.0, _ODOMETRY_WEIGHT),
            )
        if match.occupancy < self._settings.occupancy_min:
            return self._relocalise(grid, points_m, prediction, match)
        if prediction.has_odometry:
            return self._check_for_slip(grid, points_m, prediction, match)
        return match

    def _update_tracking(
        self, points_m: FloatArray, prediction: Prediction, match: GridMatch | None
    ) -> TrackedScan:
        """The scan's tracking state, and the pose that follows from it."""
        tracking, settings = self._tracking, self._settings
        segment = tracking.segment
        if match is None:
            self._odometry_noise.discard_window()
            state = tracking.on_no_match(
                prediction.uncertainty,
                has_submap=self._submaps.matched is not None,
                has_odometry=prediction.is_plausible,
            )
            fits, pose = not self._poses and points_m.size > 0, prediction.pose
            return self._tracked(pose, points_m, state, fits=fits)
        # False if the recent occupancy is NaN: those scans hardly fitted themselves.
        is_contradiction = match.occupancy < settings.occupancy_ratio_min * self._occupancy_before()
        fits = match.occupancy >= settings.occupancy_min
        if fits and not is_contradiction:
            self._recent_occupancy.append(match.occupancy)
            is_certain = prediction.has_odometry and not tracking.is_uncertain
            grid = self._submaps.matched
            assert grid is not None
            state = tracking.on_match(
                prediction.uncertainty,
                is_well_constrained=is_certain
                or is_well_constrained(grid, points_m, match.pose_grid_scan),
                has_odometry=prediction.has_odometry,
            )
            return self._tracked(match.pose_grid_scan, points_m, state, fits=True)
        self._odometry_noise.discard_window()
        state = tracking.on_mismatch(
            prediction.uncertainty,
            is_contradiction=is_contradiction,
            has_odometry=prediction.is_plausible,
        )
        begins_segment = tracking.segment != segment
        if begins_segment:
            self._recent_occupancy.clear()
        is_rejected = begins_segment or state is TrackingState.CONTRADICTED
        pose = prediction.pose if is_rejected else match.pose_grid_scan
        return self._tracked(pose, points_m, state, fits=fits)

    def _insert(self, tracked: TrackedScan) -> None:
        """Make the scan a keyframe where it is due; a new segment begins new submaps."""
        node = NodeId(len(self._keyframes))
        begins_segment = bool(self._segments) and tracked.segment != self._segments[-1]
        if begins_segment:
            self._submaps.end_segment(node)
        if not self._is_due(tracked, begins_segment=begins_segment):
            return
        pose, points_m = tracked.pose_local_scan, tracked.points_m
        self._keyframes.append(len(self._poses))
        self._node_points_m.append(points_m)
        self._segments.append(tracked.segment)
        self._is_bridged.append(self._tracking.is_bridged)
        self._submaps.insert(
            node, pose, densified_points(points_m, self._submap_settings.resolution_m)
        )

    def _is_due(self, tracked: TrackedScan, *, begins_segment: bool) -> bool:
        """Whether a scan is a keyframe: the motion filter of IV.B."""
        if tracked.state is TrackingState.CONTRADICTED:
            return False
        if not self._keyframes:
            return True
        if begins_segment:
            return bool(tracked.points_m.shape[0] >= POINTS_MIN)
        step = relative_pose(self._poses[self._keyframes[-1]], tracked.pose_local_scan)
        return bool(
            np.hypot(step[0], step[1]) > self._settings.keyframe_distance_m
            or abs(step[2]) > self._settings.keyframe_rotation_rad
        )

    def _relocalise(
        self, grid: ProbabilityGrid, points_m: FloatArray, prediction: Prediction, match: GridMatch
    ) -> GridMatch:
        """A better match than one that does not fit: a stamp may be late, a wheel may slip."""
        starts = (
            [(prediction.pose_by_velocity, _VELOCITY_SEARCH)] if prediction.has_odometry else []
        )
        if self._tracking.mismatches > 0:
            starts.append((prediction.pose, _RELOCALISATION_SEARCH))
        for start, factor in starts:
            other = self._match_by_velocity(grid, points_m, start, factor)
            if _is_clearly_better(other, match, _OCCUPANCY_GAIN_MIN):
                return other
        return match

    def _check_for_slip(
        self, grid: ProbabilityGrid, points_m: FloatArray, prediction: Prediction, match: GridMatch
    ) -> GridMatch:
        """The match, or one without odometry where that is refuted; odometry's noise is learned."""
        step, error = prediction.step, relative_pose(prediction.pose, match.pose_grid_scan)
        if self._odometry_noise.is_refuted(step, error, match.information):
            other = self._match_by_velocity(grid, points_m, prediction.pose)
            if _is_clearly_better(other, match, _OCCUPANCY_GAIN_MIN / 2.0):
                match, error = other, relative_pose(prediction.pose, other.pose_grid_scan)
        self._odometry_noise.update(step, error, match.information)
        return match

    def _match_by_velocity(
        self,
        grid: ProbabilityGrid,
        points_m: FloatArray,
        start: FloatArray,
        factor: float = _VELOCITY_SEARCH,
    ) -> GridMatch:
        """A match with the constant-velocity prior."""
        search = self._make_search(factor, _VELOCITY_WEIGHT)
        return self._match_near(grid, points_m, start, self._velocity_sigma, search)

    def _match_near(
        self,
        grid: ProbabilityGrid,
        points_m: FloatArray,
        predicted: FloatArray,
        sigma: FloatArray,
        search: LatticeSearch,
    ) -> GridMatch:
        """Correlative search about the prediction, then Gauss-Newton (eq. CS) with it as prior."""
        start = correlative_match(grid, points_m, predicted, search)
        prior_sigma = (float(sigma[0]), float(sigma[1]))
        return match_scan(grid, points_m, start, predicted=predicted, prior_sigma=prior_sigma)

    def _make_search(self, factor: float, prior_weight: tuple[float, float]) -> LatticeSearch:
        return LatticeSearch(
            translation_m=factor * self._settings.search_m,
            rotation_rad=factor * self._settings.search_rad,
            prior_weight=prior_weight,
        )

    def _occupancy_before(self) -> float:
        """Mean occupancy of the last matches, NaN where that is too low to compare with."""
        mean = float(np.mean(self._recent_occupancy)) if self._recent_occupancy else np.nan
        return mean if mean > _OCCUPANCY_SURE else np.nan

    def _tracked(
        self, pose: FloatArray, points_m: FloatArray, state: TrackingState, *, fits: bool
    ) -> TrackedScan:
        return TrackedScan(
            pose_local_scan=pose,
            points_m=points_m,
            state=state,
            segment=self._tracking.segment,
            fits=bool(fits),
        )

    def trajectory_so_far(self) -> tuple[IntArray, FloatArray]:
        """Stamps (n,) and poses (n, 3) in the local frame of the scans so far."""
        return np.array(self._stamps_ns, dtype=np.int64), np.array(self._poses).reshape(-1, 3)

    def drop_map(self) -> None:
        """Delete finished submaps and keyframes' points, which only loop closure needs."""
        self._submaps.finished.clear()
        if self._node_points_m:
            self._node_points_m[-1] = np.empty((0, 2))

    def finish(self) -> LocalTrajectory:
        """The trajectory of all scans; the growing submaps end with the last keyframe.

        Raises ValueError where no scan was added.
        """
        if not self._poses:
            raise ValueError("no scan was added")
        return LocalTrajectory(
            stamps_ns=np.array(self._stamps_ns, dtype=np.int64),
            poses_local_scan=np.array(self._poses),
            is_trusted=np.array(self._is_trusted, dtype=np.bool_),
            keyframes=np.array(self._keyframes, dtype=np.int64),
            node_points_m=tuple(self._node_points_m),
            segment=np.array(self._segments, dtype=np.int64),
            is_bridged=np.array(self._is_bridged, dtype=np.bool_),
            submaps=self._submaps.all_until(NodeId(len(self._keyframes))),
        )


def _is_clearly_better(other: GridMatch, match: GridMatch, gain_min: float) -> bool:
    return other.occupancy > max(match.occupancy + gain_min, _OCCUPANCY_SURE)
