"""The pose graph: constraints between keyframes, and the poses that satisfy them best.

Sparse pose adjustment (Hess et al. 2016, V.A, eq. SPA) with gtsam.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.planar_poses import relative_pose
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.identifiers import NodeId

# Fixes the first pose, the map's origin, but for rounding.
_ANCHOR_SIGMA = 1e-6
# Of an unknown step, in metres and radians: larger than most places, yet the optimum stays unique.
UNKNOWN_STEP_SIGMAS = (100.0, 100.0, 10.0)


class GraphSettings(StageSettings):
    """Optimisation of the pose graph."""

    local_sigma_m: float = setting(
        0.03, "Standard deviation of a step of local SLAM", unit="m", ge=1e-6, le=10.0
    )
    local_sigma_rad: float = setting(
        0.01, "Standard deviation of a step of local SLAM", unit="rad", ge=1e-6, le=3.2
    )
    untrusted_factor: float = setting(
        10.0, "Factor of these deviations where scans do not fit", ge=1.0, le=1e6
    )
    robust_scale: float = setting(
        1.0, "Cauchy kernel's scale for loops, in standard deviations", ge=1e-6, le=100.0
    )
    residual_max_m: float = setting(
        0.5, "Loops with a larger residual at the optimum are dropped", unit="m", ge=1e-6, le=100.0
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edge:
    """A measured relation between two keyframes.

    ``pose_first_second``: (3,). ``information``: (3, 3) of its x, y, yaw in the second's axes.
    ``is_loop``: a loop closure, which may be a false match.
    """

    first: NodeId
    second: NodeId
    pose_first_second: FloatArray
    information: FloatArray
    is_loop: bool


def without_information(edge: Edge) -> Edge:
    """The edge with the information of an unknown step."""
    return replace(edge, information=np.diag(np.array(UNKNOWN_STEP_SIGMAS) ** -2.0))


def optimise(
    poses_map_node: FloatArray,
    edges: Sequence[Edge],
    robust_scale: float | None,
    tolerance: float = 1e-5,
) -> FloatArray:
    """(K, 3) the poses with the least sum of squared residuals, started at (K, 3) poses.

    The residual is Log(measured⁻¹ · first⁻¹ · second), whitened by the edge's information.
    The first node stays. ``robust_scale``: of the Cauchy kernel for loop edges, in whitened
    residuals, so that the others outweigh a wrong loop; None for a squared cost. ``tolerance``: the
    relative decrease of the cost at which the optimisation ends.
    """
    import gtsam

    graph = gtsam.NonlinearFactorGraph()
    values = gtsam.Values()
    for node, pose in enumerate(poses_map_node):
        values.insert(node, gtsam.Pose2(*pose))
    anchor = gtsam.noiseModel.Isotropic.Sigma(3, _ANCHOR_SIGMA)
    graph.add(gtsam.PriorFactorPose2(0, gtsam.Pose2(*poses_map_node[0]), anchor))
    for edge in edges:
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Information(edge.information)
        if edge.is_loop and robust_scale is not None:
            kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(robust_scale)
            noise = gtsam.noiseModel.Robust.Create(kernel, noise)
        measured = gtsam.Pose2(*edge.pose_first_second)
        graph.add(gtsam.BetweenFactorPose2(edge.first, edge.second, measured, noise))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(tolerance)
    best = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return np.array(
        [
            [pose.x(), pose.y(), pose.theta()]
            for pose in (best.atPose2(node) for node in range(len(poses_map_node)))
        ]
    )


def residuals(poses_map_node: FloatArray, edges: Sequence[Edge]) -> FloatArray:
    """(M, 3) residual of each edge at the poses: x, y in metres, yaw in radians."""
    if not edges:
        return np.zeros((0, 3))
    measured = np.array([edge.pose_first_second for edge in edges])
    found = relative_pose(
        poses_map_node[[edge.first for edge in edges]],
        poses_map_node[[edge.second for edge in edges]],
    )
    return relative_pose(measured, found)
