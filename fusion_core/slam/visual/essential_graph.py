"""The essential graph: what the map's keyframes say of each other, and the poses that suit it best.

As in ORB-SLAM2 its edges are the spanning tree, the loops and pairs that share many landmarks.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.geometry import invert_transform
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.drift import DriftSettings, drift_covariance, small_motion_between
from fusion_core.slam.visual.visual_map import VisualMap

# Fixes the first pose, the map's origin, but for rounding.
_ANCHOR_SIGMA = 1e-6
# Added to an edge's standard deviations: of steps so short that drift is not what limits them.
_SIGMA_MIN_RAD, _SIGMA_MIN_M = 1e-3, 2e-3
# Relative error tolerance and most iterations of the optimiser; set by hand.
_TOLERANCE, _ITERATIONS = 1e-6, 100


class EssentialGraphSettings(StageSettings):
    """Optimisation of the essential graph."""

    shared_min: int = setting(
        100,
        "Landmarks that two keyframes must share to be connected beside the spanning tree",
        unit="landmarks",
        ge=1,
        le=100_000,
    )
    robust_scale: float = setting(
        3.0, "Cauchy kernel's scale for loops, in standard deviations", ge=1e-3, le=1e3
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseEdge:
    """What is known of two keyframes' relation.

    ``T_first_second``: (4, 4). ``covariance``: (6, 6) of a small motion of the second in its own
    frame, rotation first. ``is_loop``: a loop closure, which may be a false match.
    """

    first: int
    second: int
    T_first_second: FloatArray
    covariance: FloatArray
    is_loop: bool

    def __post_init__(self) -> None:
        for array in (self.T_first_second, self.covariance):
            read_only(array)


def essential_edges(
    visual_map: VisualMap,
    strong_pairs: Iterable[tuple[int, int]],
    drift: DriftSettings,
    path_m: float,
) -> list[PoseEdge]:
    """The edges between the kept keyframes, as the map places them now.

    ``strong_pairs``: of keyframes that share many landmarks. ``path_m``: the length of the path
    over which a loop is closed, with which the drift of each step grows. Edges of culled keyframes
    are left out; a loop of a culled keyframe is that of its parent.
    """
    keyframes = visual_map.keyframes
    tree = {
        (keyframe.parent, keyframe.index)
        for keyframe in visual_map.kept_keyframes
        if keyframe.parent is not None
    }
    strong = {
        (min(pair), max(pair))
        for pair in strong_pairs
        if not keyframes[pair[0]].is_culled and not keyframes[pair[1]].is_culled
    }
    edges = []
    pairs = sorted(strong | {(min(pair), max(pair)) for pair in tree})
    # Pairs that see the same landmarks repeat what the tree says: all together they weigh as much
    # as the tree alone, which is as stiff as the declared drift allows.
    repetition = len(pairs) / max(len(tree), 1)
    for first, second in pairs:
        T_map_pair = np.stack([keyframes[first].T_map_camera, keyframes[second].T_map_camera])
        covariance = repetition * drift_covariance(T_map_pair, drift, path_m)
        covariance += np.diag(np.repeat([_SIGMA_MIN_RAD**2, _SIGMA_MIN_M**2], 3))
        edges.append(
            PoseEdge(
                first=first,
                second=second,
                T_first_second=invert_transform(T_map_pair[0]) @ T_map_pair[1],
                covariance=covariance,
                is_loop=False,
            )
        )
    for loop in visual_map.loops:
        first, T_kept_first = _kept_ancestor(visual_map, loop.first)
        second, T_kept_second = _kept_ancestor(visual_map, loop.second)
        if first != second:
            edges.append(
                PoseEdge(
                    first=first,
                    second=second,
                    T_first_second=T_kept_first
                    @ loop.pose.T_first_second
                    @ invert_transform(T_kept_second),
                    covariance=loop.pose.covariance.copy(),
                    is_loop=True,
                )
            )
    return edges


def _kept_ancestor(visual_map: VisualMap, index: int) -> tuple[int, FloatArray]:
    """The nearest ancestor that is not culled, itself perhaps, and (4, 4) T_ancestor_camera."""
    T_ancestor_camera = np.eye(4)
    keyframe = visual_map.keyframes[index]
    while keyframe.T_parent_camera is not None and keyframe.parent is not None:
        T_ancestor_camera = keyframe.T_parent_camera @ T_ancestor_camera
        keyframe = visual_map.keyframes[keyframe.parent]
    return keyframe.index, T_ancestor_camera


def optimise_poses(
    T_map_node: FloatArray, edges: Sequence[PoseEdge], robust_scale: float | None
) -> FloatArray:
    """(K, 4, 4) the poses with the least sum of squared residuals, started at (K, 4, 4) poses.

    The residual is Log(measured⁻¹ · first⁻¹ · second), whitened by the edge's covariance. The
    first pose of each connected part stays. ``robust_scale``: of the Cauchy kernel for loops, in
    standard deviations; None for a squared cost.
    """
    import gtsam

    graph = gtsam.NonlinearFactorGraph()
    values = gtsam.Values()
    anchor = gtsam.noiseModel.Isotropic.Sigma(6, _ANCHOR_SIGMA)
    parts = connected_parts(len(T_map_node), [(edge.first, edge.second) for edge in edges])
    _, firsts = np.unique(parts, return_index=True)
    for node, pose in enumerate(T_map_node):
        values.insert(node, gtsam.Pose3(pose))
    for node in firsts.tolist():
        graph.add(gtsam.PriorFactorPose3(node, gtsam.Pose3(T_map_node[node]), anchor))
    for edge in edges:
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
        if edge.is_loop and robust_scale is not None:
            kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(robust_scale)
            noise = gtsam.noiseModel.Robust.Create(kernel, noise)
        measured = gtsam.Pose3(edge.T_first_second)
        graph.add(gtsam.BetweenFactorPose3(edge.first, edge.second, measured, noise))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(_TOLERANCE)
    parameters.setMaxIterations(_ITERATIONS)
    best = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return np.array([best.atPose3(node).matrix() for node in range(len(T_map_node))])


def connected_parts(count: int, pairs: Sequence[tuple[int, int]]) -> FloatArray:
    """(count,) the number of the part that each node belongs to, connected by pairs."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    ends = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    graph = csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1])


def loop_chi2(T_map_node: FloatArray, edge: PoseEdge) -> float:
    """Squared Mahalanobis distance of an edge at the poses."""
    T_map_second = T_map_node[edge.first] @ edge.T_first_second
    away = small_motion_between(T_map_second, T_map_node[edge.second])
    return float(away @ np.linalg.solve(edge.covariance, away))
