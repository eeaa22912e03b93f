"""Pose graph SLAM: local SLAM, then loop closure, then poses and map refined together, and adjusted
with the odometry that shares no measurement with the scans.

After Hess et al. 2016, "Real-time loop closure in 2D LIDAR SLAM", for whole recordings: loops are
searched along the trajectory, with the poses that the loops before have given. ``pose_graph_slam``
runs all steps; each is in a separate file.

    result = pose_graph_slam(scans, odometry.at, SlamSettings())
    result.poses_map_scan, result.graph, result.trusted
"""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from pydantic import model_validator

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import MappingFailed
from fusion_core.model.planar_poses import PosePrior, relative_pose
from fusion_core.model.pose_graph import PoseGraph
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import LaserScan
from fusion_core.model.slam_view import SlamObserver, SlamView, no_observer
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.registration.correlative import POSES_MAX, count_poses
from fusion_core.settings import SettingsGroup
from fusion_core.slam.identifiers import NodeId
from fusion_core.slam.interpolate_poses import interpolate_poses
from fusion_core.slam.joint_refinement import RefinementSettings, refine
from fusion_core.slam.local_slam import LocalSlam, LocalSlamSettings
from fusion_core.slam.local_trajectory import LocalTrajectory
from fusion_core.slam.loop_closing import close_loops
from fusion_core.slam.loop_search import LoopSettings
from fusion_core.slam.pose_graph import UNKNOWN_STEP_SIGMAS, Edge, GraphSettings, residuals
from fusion_core.slam.submaps import SubmapSettings
from fusion_core.slam.surface_adjustment import (
    AdjustedPoses,
    SurfaceAdjustmentSettings,
    adjust_to_surfaces,
)

# Of odometry over a tracking loss: a slip in x, y [m] and yaw [rad]. Empirical.
_BRIDGED_SIGMAS = (0.3, 0.3, 0.1)
# Scans between two calls of an observer, set by hand: a picture every few seconds.
_OBSERVED_EVERY = 20


class SlamSettings(SettingsGroup):
    """Every stage's settings, in the order of the work."""

    submaps: SubmapSettings = SubmapSettings()
    local: LocalSlamSettings = LocalSlamSettings()
    loops: LoopSettings = LoopSettings()
    graph: GraphSettings = GraphSettings()
    refinement: RefinementSettings = RefinementSettings()
    surface_adjustment: SurfaceAdjustmentSettings = SurfaceAdjustmentSettings()

    @model_validator(mode="after")
    def _searchable(self) -> Self:
        window, resolution_m = self.loops.widest_window, self.submaps.resolution_m
        poses = count_poses(
            window.translation_m, window.rotation_rad, resolution_m, window.step_rad
        )
        if poses > POSES_MAX:
            raise ValueError(
                f"loops.window_max_m = {self.loops.window_max_m:g} over submaps.resolution_m = "
                f"{resolution_m:g} makes {poses:.1g} poses to search, more than {POSES_MAX:.0e}"
            )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlamResult:
    """Where each of N scans was.

    ``stamps_ns``: (N,). ``poses_map_scan``: (N, 3) x, y, yaw of the LiDAR. ``trusted``: (N,) False
    where the scan did not fit the map or has no points, where nothing determines its place, and
    after a tracking loss over which no loop connects. ``keyframes``: (K,) numbers of the scans that
    are the nodes of ``graph``. ``residuals``: (M, 3) x, y in metres, yaw in radians of its edges.
    ``loops_tried``, ``loops_dropped``: matches tried, and loops found but left out of the graph as
    inconsistent with the others. ``adjusted``: what the adjustment to surfaces found.
    ``seconds``: of each stage, on the wall clock.
    """

    stamps_ns: IntArray
    poses_map_scan: FloatArray
    trusted: BoolArray
    keyframes: IntArray
    graph: PoseGraph
    residuals: FloatArray
    loops_tried: int
    loops_dropped: int
    adjusted: AdjustedPoses
    seconds: Mapping[str, float]

    def __post_init__(self) -> None:
        for array in (
            self.stamps_ns,
            self.poses_map_scan,
            self.trusted,
            self.keyframes,
            self.residuals,
        ):
            read_only(array)

    @property
    def loops(self) -> int:
        """Loop edges in the graph."""
        return int(self.graph.is_loop.sum())


def pose_graph_slam(
    scans: Iterable[LaserScan],
    prior: PosePrior | None = None,
    settings: SlamSettings | None = None,
    progress: Progress = silent,
    observer: SlamObserver = no_observer,
    odometries: Sequence[OdometryTrajectory] = (),
) -> SlamResult:
    """Place every scan.

    ``scans``: stamps strictly increasing; read once, and not kept. ``prior``: odometry; without
    it, and where it has no pose, velocity is taken to be constant. The first scan lies where the
    prior has it, else at the origin. ``observer``: called about every twenty scans, when the graph
    is solved (with the keyframes alone), and at the end. ``odometries``: sources that share no
    measurement with the scans; the adjustment takes their steps by their covariances.

    Raises MappingFailed where there is no scan, or none has a point within range.
    """
    settings = settings or SlamSettings()
    start_s = time.perf_counter()
    slam = LocalSlam(settings.local, settings.submaps)
    count = 0
    for scan in scans:
        # Local SLAM (section IV).
        slam.add_scan(scan, None if prior is None else prior(scan.stamp_ns))
        count += 1
        progress(count, None, "matching scans")
        if count % _OBSERVED_EVERY == 0 and observer is not no_observer:
            observer(_make_view("matching scans", *slam.trajectory_so_far(), []))
    if count == 0:
        raise MappingFailed("there is no scan to place.")
    local = slam.finish()
    if all(points_m.size == 0 for points_m in local.node_points_m):
        raise MappingFailed(
            f"none of {count} scans has a point within {settings.submaps.max_range_m:g} m.",
            advice="Check the ranges' limits, or set a larger max_range_m.",
        )
    local_s = time.perf_counter()

    def show(stage: str, poses_map_node: FloatArray, loops: list[Edge]) -> None:
        if observer is not no_observer:
            stamps_ns = local.stamps_ns[local.keyframes[: len(poses_map_node)]]
            observer(_make_view(stage, stamps_ns, poses_map_node, loops))

    # Global SLAM: constraints (V.A), loops by branch and bound (V.B), eq. SPA (V.A).
    steps = _odometry_edges(local, settings.graph)
    closed = close_loops(
        local,
        steps,
        settings.loops,
        settings.graph,
        progress,
        show,
    )
    closed_s = time.perf_counter()
    # Poses and map together (Wang et al. 2025), then all scans between the keyframes.
    poses_map_node = refine(
        closed.poses_map_node,
        local.node_points_m,
        closed.is_connected,
        settings.submaps,
        settings.refinement,
        progress,
    )
    refined_s = time.perf_counter()
    adjusted = adjust_to_surfaces(
        poses_map_node,
        local.node_points_m,
        local.stamps_ns[local.keyframes],
        closed.is_connected,
        np.array([step.information for step in steps]).reshape(-1, 3, 3),
        settings.surface_adjustment,
        odometries,
        progress,
    )
    poses_map_node = adjusted.poses_map_node
    end_s = time.perf_counter()
    poses_map_scan = interpolate_poses(local.poses_local_scan, local.keyframes, poses_map_node)
    loops = [edge for edge in closed.edges if edge.is_loop]
    if observer is not no_observer:
        observer(_make_view("done", local.stamps_ns, poses_map_scan, loops, poses_map_node))
    return SlamResult(
        stamps_ns=local.stamps_ns,
        poses_map_scan=poses_map_scan,
        trusted=local.is_trusted & _find_connected_scans(local, closed.is_connected),
        keyframes=local.keyframes,
        graph=_make_graph(poses_map_node, closed.edges),
        residuals=residuals(poses_map_node, closed.edges),
        loops_tried=closed.candidates_tried,
        loops_dropped=closed.loops_dropped,
        adjusted=adjusted,
        seconds={
            "local_slam": local_s - start_s,
            "loop_search": closed_s - local_s - closed.optimisation_s,
            "optimisation": closed.optimisation_s,
            "refinement": refined_s - closed_s,
            "adjustment": end_s - refined_s,
        },
    )


def _make_view(
    stage: str,
    stamps_ns: IntArray,
    poses_map_scan: FloatArray,
    loops: list[Edge],
    poses_map_node: FloatArray | None = None,
) -> SlamView:
    nodes = poses_map_scan if poses_map_node is None else poses_map_node
    first, second = ([getattr(edge, end) for edge in loops] for end in ("first", "second"))
    return SlamView(
        stage=stage,
        stamps_ns=stamps_ns.copy(),
        poses_map_scan=poses_map_scan.copy(),
        particles=np.zeros((0, 3)),
        weights=np.zeros(0),
        effective=np.zeros(0),
        loops_m=np.concatenate([nodes[first, :2], nodes[second, :2]], axis=1)
        if loops
        else np.zeros((0, 4)),
    )


def _find_connected_scans(local: LocalTrajectory, is_connected: BoolArray) -> BoolArray:
    """(N,) whether the last keyframe before each scan is connected with the first one."""
    connected: BoolArray = is_connected[local.nodes_before(np.arange(len(local.stamps_ns)))]
    return connected


def _odometry_edges(local: LocalTrajectory, settings: GraphSettings) -> list[Edge]:
    """The edge from each keyframe to the next, weaker where a scan between them is untrusted."""
    sigmas = np.array([settings.local_sigma_m, settings.local_sigma_m, settings.local_sigma_rad])
    poses = local.poses_local_node
    untrusted_before = np.concatenate([[0], np.cumsum(~local.is_trusted)])
    edges = []
    for node in range(len(poses) - 1):
        begin, end = local.keyframes[node] + 1, local.keyframes[node + 1] + 1
        is_untrusted = untrusted_before[end] > untrusted_before[begin]
        sigma = sigmas * (settings.untrusted_factor if is_untrusted else 1.0)
        if local.segment[node + 1] != local.segment[node]:
            sigma = np.array(_BRIDGED_SIGMAS)
            if not local.is_bridged[node + 1]:
                sigma = np.array(UNKNOWN_STEP_SIGMAS)
        edges.append(
            Edge(
                first=NodeId(node),
                second=NodeId(node + 1),
                pose_first_second=relative_pose(poses[node], poses[node + 1]),
                information=np.diag(sigma**-2.0),
                is_loop=False,
            )
        )
    return edges


def _make_graph(poses_map_node: FloatArray, edges: list[Edge]) -> PoseGraph:
    return PoseGraph(
        poses_map_node=poses_map_node,
        first=np.array([edge.first for edge in edges], dtype=np.int64),
        second=np.array([edge.second for edge in edges], dtype=np.int64),
        pose_first_second=np.array([edge.pose_first_second for edge in edges]).reshape(-1, 3),
        information=np.array([edge.information for edge in edges]).reshape(-1, 3, 3),
        is_loop=np.array([edge.is_loop for edge in edges], dtype=np.bool_),
    )
