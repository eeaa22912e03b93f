"""Loop closure: search along the trajectory, confirmation of what is found, and optimisation.

Hess et al. 2016, section V. A loop near the estimate is accepted as it is. After a long path the
estimate may be off by metres, and in a building with similar corridors a wide search finds a wrong
loop sooner or later: a loop found in a wide window is accepted when local windows before and after
it match at the places that it predicts for them.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.planar_poses import compose_poses, invert_pose, relative_pose
from fusion_core.model.progress import Progress
from fusion_core.slam.graph_distances import GraphDistances
from fusion_core.slam.identifiers import NodeId, SubmapId
from fusion_core.slam.local_trajectory import LocalTrajectory
from fusion_core.slam.loop_search import LoopSearch, LoopSettings, LoopWindow
from fusion_core.slam.pose_graph import (
    Edge,
    GraphSettings,
    optimise,
    residuals,
    without_information,
)
from fusion_core.slam.tracking_losses import TrackingLosses

# The graph is optimised again when it has grown by this fraction and by this number of keyframes,
# so that the work stays linear in its size. Set by hand.
_GROWTH_MIN = 0.3
_KEYFRAMES_MIN = 100
# Relative error tolerance of the optimiser, during the search and at the end. Set by hand.
_TOLERANCE_SEARCH, _TOLERANCE_FINAL = 1e-2, 1e-4
# The search for a confirming match, and how near to the predicted place it must lie; empirical.
_CONFIRMING_WINDOW = LoopWindow(1.5, 0.15)
_CONFIRMS_WITHIN_M = 0.4
# Matches needed to confirm a loop, and across a tracking loss. Empirical.
_CONFIRMING_MIN, _CONFIRMING_MIN_LOSS = 2, 3

OptimisationObserver = Callable[[str, FloatArray, list[Edge]], None]
"""Called with the stage, the (n, 3) poses of the first n nodes, and the loops so far."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopClosureResult:
    """The nodes' poses (K, 3), all edges, and what the search took.

    ``is_connected``: (K,) whether loops, or odometry that they confirm, connect a node with the
    first one.
    """

    poses_map_node: FloatArray
    edges: list[Edge]
    candidates_tried: int
    loops_dropped: int
    optimisation_s: float
    is_connected: BoolArray


def close_loops(
    local: LocalTrajectory,
    steps: list[Edge],
    loop_settings: LoopSettings,
    graph_settings: GraphSettings,
    progress: Progress,
    observer: OptimisationObserver,
) -> LoopClosureResult:
    """Search along the trajectory, optimise as the graph grows, then drop inconsistent loops.

    ``steps``: the K - 1 edges from each keyframe to the next.
    """
    closure = _LoopClosure(local, steps, loop_settings, graph_settings, observer)
    closure.run(progress)
    return LoopClosureResult(
        poses_map_node=closure.poses,
        edges=[*closure.steps, *closure.loops],
        candidates_tried=closure.search.tried,
        loops_dropped=closure.dropped,
        optimisation_s=closure.optimisation_s,
        is_connected=closure.is_connected(),
    )


class _LoopClosure:
    """The graph of a local trajectory while loops are searched."""

    def __init__(
        self,
        local: LocalTrajectory,
        steps: list[Edge],
        loop_settings: LoopSettings,
        graph_settings: GraphSettings,
        observer: OptimisationObserver,
    ) -> None:
        self._local, self.steps = local, list(steps)
        self._loop_settings, self._graph_settings = loop_settings, graph_settings
        self._report = observer
        self.search = LoopSearch(local, loop_settings)
        self.loops: list[Edge] = []
        self.poses = local.poses_local_node.copy()
        # Nodes after this one have no pose in the map yet.
        self._last_posed = 0
        self.dropped = 0
        self.optimisation_s = 0.0
        self.losses = TrackingLosses(local)
        self._distances = GraphDistances(local, self.losses)
        self._first = np.array([submap.first for submap in local.submaps])

    def run(self, progress: Progress) -> None:
        count = len(self.poses)
        solved, loops_solved = 0, 0
        for node in map(NodeId, range(0, count, self._loop_settings.every)):
            progress(node, count, "closing loops")
            self._extend_poses(node)
            is_far = self._search_loops(node)
            is_due = node - solved >= max(_KEYFRAMES_MIN, _GROWTH_MIN * node)
            if (is_due and len(self.loops) > loops_solved) or is_far:
                self._optimise(node + 1, "closing loops", _TOLERANCE_SEARCH)
                solved, loops_solved = node, len(self.loops)
        self._extend_poses(count - 1)
        if not self.loops:
            return
        progress(count, count, "optimising")
        self._optimise(count, "optimising", _TOLERANCE_FINAL)
        away_m = np.hypot(*residuals(self.poses, self.loops)[:, :2].T)
        is_kept = away_m <= self._graph_settings.residual_max_m
        self.dropped += int(np.count_nonzero(~is_kept))
        if not is_kept.all():
            self.loops = [edge for edge, kept in zip(self.loops, is_kept, strict=True) if kept]
            self._optimise(count, "optimising", _TOLERANCE_FINAL)

    def _search_loops(self, node: NodeId) -> bool:
        """Search loops to a node; whether one was found in a wide window."""
        is_far = False
        candidates = self.search.candidates(
            node,
            self.poses[self.search.centre, :2],
            self.poses[node, :2],
            self._distances.to_submaps(node),
            self.losses.are_connected(self.search.centre, node),
        )
        for submap, window in candidates:
            first = int(self._first[submap])
            edge = self.search.match(
                node, submap, relative_pose(self.poses[first], self.poses[node]), window
            )
            if edge is None:
                continue
            if not window.is_wide:
                self._add_loop(edge, submap)
                continue
            confirming = self._confirming_matches(edge, self.search.score_min(window))
            is_across_any = window.is_across_loss or window.is_across_bridged_loss
            enough = _CONFIRMING_MIN_LOSS if is_across_any else _CONFIRMING_MIN
            if len(confirming) < enough:
                self.dropped += 1
                continue
            self._compare_with_odometry(edge, submap)
            self._add_loop(edge, submap)
            for other, other_submap in confirming:
                # Loops to later nodes are found again when the search reaches them.
                if other.second <= node:
                    self._add_loop(other, other_submap)
            is_far = True
            break
        return is_far

    def _compare_with_odometry(self, edge: Edge, submap: SubmapId) -> None:
        """Confirm or refute the odometry over the tracking losses between a loop's ends."""
        window = self.search.window(float(self._distances.to_submaps(edge.second)[submap]))
        if window.is_across_loss:
            return
        off = residuals(self.poses, [edge])[0]
        agrees = np.hypot(off[0], off[1]) <= window.translation_m
        agrees &= abs(off[2]) <= window.rotation_rad
        self.losses.add_loop(edge, agrees_with_odometry=bool(agrees))
        for node in self.losses.node_after[~self.losses.is_bridged].tolist():
            self.steps[node - 1] = without_information(self.steps[node - 1])
        self._distances.set_losses(self.losses)

    def _confirming_matches(self, found: Edge, score_min: float) -> list[tuple[Edge, SubmapId]]:
        """Matches of local windows before and after that confirm ``found``."""
        local, node = self._local, found.second
        pose = compose_poses(self.poses[found.first], found.pose_first_second)
        confirming = []
        for away in (2, -2, 4, -4, 6, -6):
            other = NodeId(node + away * self._loop_settings.window_keyframes)
            if not 0 <= other < len(self.poses) or local.segment[other] != local.segment[node]:
                continue
            before = self.search.submaps_before(min(node, other))
            if before == 0:
                continue
            expected = compose_poses(
                pose, relative_pose(local.poses_local_node[node], local.poses_local_node[other])
            )
            centres_m = self.poses[self.search.centre[:before], :2]
            submap = SubmapId(int(np.argmin(np.hypot(*(centres_m - expected[:2]).T))))
            first = int(self._first[submap])
            expected_in_submap = relative_pose(self.poses[first], expected)
            edge = self.search.match(
                other, submap, expected_in_submap, _CONFIRMING_WINDOW, score_min
            )
            if edge is None:
                continue
            off = relative_pose(expected, compose_poses(self.poses[first], edge.pose_first_second))
            if np.hypot(off[0], off[1]) < _CONFIRMS_WITHIN_M:
                confirming.append((edge, submap))
        return confirming

    def _add_loop(self, edge: Edge, submap: SubmapId) -> None:
        self.loops.append(edge)
        self.losses.add_loop(edge, agrees_with_odometry=None)
        self._distances.add_loop(submap, edge.second)

    def is_connected(self) -> BoolArray:
        """(K,) whether the loops that were kept connect a node with the first one."""
        return self.losses.connected_by(self.loops)

    def _extend_poses(self, node: int) -> None:
        """Dead-reckon the nodes up to this one by local SLAM, from the last one with a pose."""
        if node <= self._last_posed:
            return
        local = self._local.poses_local_node
        begin, end = self._last_posed, node + 1
        self.poses[begin + 1 : end] = compose_poses(
            self.poses[begin], relative_pose(local[begin], local[begin + 1 : end])
        )
        self._last_posed = node

    def _optimise(self, end: int, stage: str, tolerance: float) -> None:
        """Eq. SPA over the nodes before ``end``; those after follow as they are reached."""
        start_s = time.perf_counter()
        reached = [edge for edge in self.loops if edge.second < end]
        self.poses[:end] = optimise(
            self._initial_poses(end, reached),
            [*self.steps[: end - 1], *reached],
            self._graph_settings.robust_scale,
            tolerance,
        )
        self._last_posed = end - 1
        self.optimisation_s += time.perf_counter() - start_s
        self._report(stage, self.poses[:end], reached)

    def _initial_poses(self, end: int, reached: list[Edge]) -> FloatArray:
        """(end, 3) initial poses: a segment that only a loop connects is placed by that loop."""
        poses = self.poses[:end].copy()
        segment = self.losses.unbridged_segments()[:end]
        consistent = self._consistent_loops(reached)
        known = {int(segment[0])} | {int(segment[edge.second]) for edge in consistent}
        for edge in reached:
            here = int(segment[edge.second])
            if here in known or int(segment[edge.first]) not in known:
                continue
            found = compose_poses(poses[edge.first], edge.pose_first_second)
            moved = compose_poses(found, invert_pose(poses[edge.second]))
            poses[segment == here] = compose_poses(moved, poses[segment == here])
            known.add(here)
        return poses

    def _consistent_loops(self, reached: list[Edge]) -> list[Edge]:
        away_m = np.hypot(*residuals(self.poses, reached)[:, :2].T)
        return [
            edge
            for edge, off_m in zip(reached, away_m.tolist(), strict=True)
            if off_m <= self._graph_settings.residual_max_m
        ]
