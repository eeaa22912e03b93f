"""Poses and map refined together, the last step after the pose graph.

A pose graph has one constraint for each match, made with a submap of its time. Here the poses and
the map of all keyframes fit each other (Wang et al. 2025, Occupancy-SLAM, arXiv 2502.06292). The
cost is minimised by alternation: the cells are the log odds of all keyframes at their poses, then
each keyframe is matched with the cells, with its pose in the graph as prior.

    poses = refine(poses, key_points_m, is_connected, submaps, RefinementSettings())
"""

from collections.abc import Iterator, Sequence

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.progress import Progress, silent
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.identifiers import NodeId
from fusion_core.slam.scan_points import densified_points
from fusion_core.slam.scan_to_grid import POINTS_MIN, match_scan
from fusion_core.slam.submaps import GrowingSubmap, SubmapSettings

# Side of the squares in which keyframes are refined, so that memory is bounded: 4 million cells.
_SQUARE_M = 100.0


class RefinementSettings(StageSettings):
    """Joint refinement of poses and map."""

    rounds: int = setting(
        1, "Alternations of map and poses; 0 leaves the graph's poses", ge=0, le=50
    )
    prior_sigma_m: float = setting(
        0.02,
        "Standard deviation of the graph's poses as a prior",
        unit="m",
        ge=1e-6,
        le=1.0,
        formerly="sigma_m",
    )
    prior_sigma_rad: float = setting(
        0.01,
        "Standard deviation of the graph's poses as a prior",
        unit="rad",
        ge=1e-6,
        le=1.0,
        formerly="sigma_rad",
    )


def refine(
    poses_map_node: FloatArray,
    keyframe_points_m: Sequence[FloatArray],
    is_connected: BoolArray,
    submaps: SubmapSettings,
    settings: RefinementSettings,
    progress: Progress = silent,
) -> FloatArray:
    """(K, 3) poses that fit the map of all, from the (K, 3) of the graph; the first one stays.

    ``key_points_m``: K arrays (n, 2) in the frame of each. ``is_connected``: (K,) False keeps its
    pose and is no part of the map.
    """
    poses = poses_map_node.copy()
    taken = np.flatnonzero(
        is_connected & np.array([points_m.shape[0] >= POINTS_MIN for points_m in keyframe_points_m])
    )
    total = settings.rounds * taken.size
    done = 0
    for _ in range(settings.rounds):
        # Use the poses of the round before, so that the order of the squares does not matter.
        before = poses.copy()
        for inside, about in _split_into_squares(before[taken, :2], submaps.max_range_m):
            cells = _build_map(before, keyframe_points_m, taken[about], submaps)
            for node in taken[inside].tolist():
                progress(done, total, "refining")
                done += 1
                poses[node] = match_scan(
                    cells.grid,
                    keyframe_points_m[node],
                    before[node],
                    predicted=poses_map_node[node],
                    prior_sigma=(settings.prior_sigma_m, settings.prior_sigma_rad),
                ).pose_grid_scan
    # The first one is the map's origin: rotating all by it would move what is far away.
    poses[0] = poses_map_node[0]
    return poses


def _split_into_squares(
    places_m: FloatArray, max_range_m: float
) -> Iterator[tuple[IntArray, IntArray]]:
    """For each square of the plane that holds places: those inside, and those within range of it.

    ``places_m``: (n, 2). Both as indices, rising.
    """
    if places_m.shape[0] == 0:
        return
    low_m = places_m.min(axis=0)
    squares = np.floor((places_m - low_m) / _SQUARE_M)
    for square in np.unique(squares, axis=0):
        is_inside = (squares == square).all(axis=1)
        offset_m = places_m - (low_m + square * _SQUARE_M)
        is_about = ((offset_m >= -max_range_m) & (offset_m < _SQUARE_M + max_range_m)).all(axis=1)
        # Rounding may put a position slightly outside its own square.
        yield np.flatnonzero(is_inside), np.flatnonzero(is_about | is_inside)


def _build_map(
    poses: FloatArray,
    keyframe_points_m: Sequence[FloatArray],
    nodes: IntArray,
    settings: SubmapSettings,
) -> GrowingSubmap:
    """The cells that keyframes have met, all of them in one grid."""
    middle_m = (poses[nodes, :2].min(axis=0) + poses[nodes, :2].max(axis=0)) / 2.0
    farthest_m = float(np.abs(poses[nodes, :2] - middle_m).max())
    cells = GrowingSubmap(middle_m, NodeId(int(nodes[0])), farthest_m, settings)
    for node in nodes.tolist():
        cells.add_scan(
            poses[node], densified_points(keyframe_points_m[node], settings.resolution_m)
        )
    return cells
