"""Pose graph SLAM: local SLAM, then loops, then the poses that fit all relations best.

After Hess et al. 2016, "Real-time loop closure in 2D LIDAR SLAM", for whole recordings: loops are
searched along the way, with the poses that the loops before have given.

    result = pose_graph_slam(scans, odometry.at, SlamSettings())
    result.poses_map_scan, result.graph, result.trusted
"""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import MappingFailed
from fusion_core.model.geometry import interpolate_planar
from fusion_core.model.pose_graph import PoseGraph
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import LaserScan
from fusion_core.settings import SettingsGroup
from fusion_core.slam.local_slam import LocalSlam, LocalSlamSettings, LocalTrajectory
from fusion_core.slam.loop_search import LoopSearch, LoopSettings
from fusion_core.slam.planar_poses import compose, relative
from fusion_core.slam.pose_graph import Edge, GraphSettings, optimise, residuals
from fusion_core.slam.submaps import SubmapSettings

Prior = Callable[[int], FloatArray | None]
"""Stamp in ns to the (3,) pose of the LiDAR by odometry, None where that is not known."""

# The graph is solved anew when it has grown by a tenth, so that the work stays linear in its size.
_GROWTH = 0.1
_KEY_SCANS_MIN = 100


class SlamSettings(SettingsGroup):
    """Every stage's settings, in the order of the work."""

    submaps: SubmapSettings = SubmapSettings()
    local: LocalSlamSettings = LocalSlamSettings()
    loops: LoopSettings = LoopSettings()
    graph: GraphSettings = GraphSettings()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlamResult:
    """Where each of N scans was.

    ``stamps_ns``: (N,). ``poses_map_scan``: (N, 3) x, y, yaw of the LiDAR. ``trusted``: (N,) False
    where the scan did not fit what was seen before it, or has no points to fit. ``key``: (K,) which
    scans are the nodes of ``graph``. ``residuals``: (M, 3) x, y in metres, yaw in radians of its
    edges. ``loops_tried``, ``loops_dropped``: matches tried, and edges found but left out of the
    graph since the others contradict them. ``seconds``: of each stage, on the wall clock.
    """

    stamps_ns: IntArray
    poses_map_scan: FloatArray
    trusted: BoolArray
    key: IntArray
    graph: PoseGraph
    residuals: FloatArray
    loops_tried: int
    loops_dropped: int
    seconds: Mapping[str, float]

    def __post_init__(self) -> None:
        for array in (self.stamps_ns, self.poses_map_scan, self.trusted, self.key, self.residuals):
            read_only(array)

    @property
    def loops(self) -> int:
        """Loop edges in the graph."""
        return int(self.graph.is_loop.sum())


def pose_graph_slam(
    scans: Iterable[LaserScan],
    prior: Prior | None = None,
    settings: SlamSettings | None = None,
    progress: Progress = silent,
) -> SlamResult:
    """Place every scan.

    ``scans``: stamps strictly increasing; read once, and not kept. ``prior``: odometry; without
    it, and where it knows nothing, velocity is taken to be constant. The first scan lies where the
    prior has it, else at the origin.

    Raises MappingFailed where there is no scan, or none has a point within reach.
    """
    settings = settings or SlamSettings()
    start_s = time.perf_counter()
    slam = LocalSlam(settings.local, settings.submaps)
    count = 0
    for scan in scans:
        slam.add_scan(scan, None if prior is None else prior(scan.stamp_ns))
        count += 1
        progress(count, None, "matching scans")
    if count == 0:
        raise MappingFailed("there is no scan to place.")
    local = slam.finish()
    if all(points_m.size == 0 for points_m in local.key_points_m):
        raise MappingFailed(
            f"none of {count} scans has a point within {settings.submaps.reach_m:g} m.",
            advice="Check the ranges' limits, or set a larger reach_m.",
        )
    local_s = time.perf_counter()
    trusted = _trusted(local, settings.local.occupancy_min)
    closing = _Closing(local, trusted, settings)
    closing.run(progress)
    end_s = time.perf_counter()
    return SlamResult(
        stamps_ns=local.stamps_ns,
        poses_map_scan=_carried(local, closing.poses_map_node),
        trusted=trusted,
        key=local.key,
        graph=_graph(closing.poses_map_node, closing.edges),
        residuals=residuals(closing.poses_map_node, closing.edges),
        loops_tried=closing.tried,
        loops_dropped=closing.dropped,
        seconds={
            "local_slam": local_s - start_s,
            "loop_search": end_s - local_s - closing.optimisation_s,
            "optimisation": closing.optimisation_s,
        },
    )


class _Closing:
    """The graph of a local trajectory while loops are being found."""

    def __init__(self, local: LocalTrajectory, trusted: BoolArray, settings: SlamSettings) -> None:
        self._search = LoopSearch(local, settings.loops)
        self._local, self._settings = local, settings
        self._steps = _steps(local, trusted, settings.graph)
        self._loops: list[Edge] = []
        self.poses_map_node = local.key_poses.copy()
        self.dropped = 0
        self.optimisation_s = 0.0

    @property
    def edges(self) -> list[Edge]:
        return [*self._steps, *self._loops]

    @property
    def tried(self) -> int:
        return self._search.tried

    def run(self, progress: Progress) -> None:
        """Search along the way, then drop what the whole contradicts."""
        count = len(self.poses_map_node)
        solved, loops_solved = 0, 0
        for node in range(0, count, self._settings.loops.every):
            progress(node, count, "closing loops")
            self._loops.extend(self._search.edges_of(node, self.poses_map_node))
            is_due = node - solved >= max(_KEY_SCANS_MIN, _GROWTH * node)
            if is_due and len(self._loops) > loops_solved:
                self._solve(node + 1)
                solved, loops_solved = node, len(self._loops)
        if not self._loops:
            return
        progress(count, count, "optimising")
        self._solve(count)
        away_m = np.hypot(*residuals(self.poses_map_node, self._loops)[:, :2].T)
        is_kept = away_m <= self._settings.graph.residual_max_m
        self.dropped = int(np.count_nonzero(~is_kept))
        if self.dropped:
            self._loops = [edge for edge, kept in zip(self._loops, is_kept, strict=True) if kept]
            self._solve(count)

    def _solve(self, end: int) -> None:
        """Optimise the nodes before ``end`` and carry the others along."""
        start_s = time.perf_counter()
        reached = [edge for edge in self._steps if edge.second < end]
        poses = optimise(
            self.poses_map_node[:end], [*reached, *self._loops], self._settings.graph.robust_scale
        )
        local = self._local.key_poses
        rest = compose(poses[-1], relative(local[end - 1], local[end:]))
        self.poses_map_node = np.concatenate([poses, rest])
        self.optimisation_s += time.perf_counter() - start_s


def _trusted(local: LocalTrajectory, occupancy_min: float) -> BoolArray:
    """(N,) the first scan with points defines the map; each other must fit it."""
    # NaN compares false.
    trusted: BoolArray = local.occupancy >= occupancy_min
    trusted[0] = local.key_points_m[0].size > 0
    return trusted


def _steps(local: LocalTrajectory, trusted: BoolArray, settings: GraphSettings) -> list[Edge]:
    """The way from each key scan to the next, less sure where a scan between them is lost."""
    sigmas = np.array([settings.local_sigma_m, settings.local_sigma_m, settings.local_sigma_rad])
    poses = local.key_poses
    lost_before = np.concatenate([[0], np.cumsum(~trusted)])
    edges = []
    for node in range(len(poses) - 1):
        begin, end = local.key[node] + 1, local.key[node + 1] + 1
        is_lost = lost_before[end] > lost_before[begin]
        factor = settings.untrusted_factor if is_lost else 1.0
        edges.append(
            Edge(
                first=node,
                second=node + 1,
                pose_first_second=relative(poses[node], poses[node + 1]),
                information=np.diag((factor * sigmas) ** -2.0),
                is_loop=False,
            )
        )
    return edges


def _carried(local: LocalTrajectory, poses_map_node: FloatArray) -> FloatArray:
    """(N, 3) every scan by the key scans before and after it, the nearer one counting more."""
    poses_local = local.poses_local_scan
    number = np.arange(len(poses_local))
    before = np.searchsorted(local.key, number, side="right") - 1
    after = np.minimum(before + 1, len(local.key) - 1)
    by_before, by_after = (
        compose(poses_map_node[node], relative(poses_local[local.key[node]], poses_local))
        for node in (before, after)
    )
    span = np.maximum(local.key[after] - local.key[before], 1)
    share = (number - local.key[before]) / span
    return np.array(
        [interpolate_planar(*pair) for pair in zip(by_before, by_after, share, strict=True)]
    )


def _graph(poses_map_node: FloatArray, edges: list[Edge]) -> PoseGraph:
    return PoseGraph(
        poses_map_node=poses_map_node,
        first=np.array([edge.first for edge in edges], dtype=np.int64),
        second=np.array([edge.second for edge in edges], dtype=np.int64),
        pose_first_second=np.array([edge.pose_first_second for edge in edges]).reshape(-1, 3),
        information=np.array([edge.information for edge in edges]).reshape(-1, 3, 3),
        is_loop=np.array([edge.is_loop for edge in edges], dtype=np.bool_),
    )
