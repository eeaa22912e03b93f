"""Loops found along the way, believed when others agree, and the poses that fit them all.

What is found near the estimate is believed as it is. After a long way the estimate may be off by
metres, and in a building of like corridors a wide search finds a wrong one sooner or later: what
it finds counts when stretches before and after fit at the places that it predicts for them.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.planar_poses import compose_poses, invert_pose, relative_pose
from fusion_core.model.progress import Progress
from fusion_core.slam.graph_distances import GraphDistances
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

# The graph is solved anew when it has grown by so much, so that the work stays linear in its size.
_GROWTH = 0.3
_KEY_SCANS_MIN = 100
# Of the last step. A robust sum falls slowly near its end, and along the way that is lost time.
_ROUGHLY, _EXACTLY = 1e-2, 1e-4
# Where another stretch is looked for, once one was found; it must fit so well.
_SECOND_WINDOW = LoopWindow(1.5, 0.15)
_AGREES_M = 0.4
_SECONDS_MIN, _SECONDS_MIN_BREAK = 2, 3

OptimisationObserver = Callable[[str, FloatArray, list[Edge]], None]
"""Called with the stage, the (n, 3) poses of the first n key scans, and the loops so far."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopClosureResult:
    """The outcome: (K, 3) poses, all edges, and what the search cost.

    ``is_joined``: (K,) whether a key scan hangs together with the first one.
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
    """Search along the way, solve as the graph grows, then drop what the whole contradicts.

    ``steps``: the K - 1 edges from each key scan to the next.
    """
    closing = _Closing(local, steps, loop_settings, graph_settings, observer)
    closing.run(progress)
    return LoopClosureResult(
        poses_map_node=closing.poses,
        edges=[*closing.steps, *closing.loops],
        candidates_tried=closing.search.tried,
        loops_dropped=closing.dropped,
        optimisation_s=closing.optimisation_s,
        is_connected=closing.is_joined(),
    )


class _Closing:
    """The graph of a local trajectory while loops are being found."""

    def __init__(
        self,
        local: LocalTrajectory,
        steps: list[Edge],
        loop_settings: LoopSettings,
        graph_settings: GraphSettings,
        solved: OptimisationObserver,
    ) -> None:
        self._local, self.steps = local, list(steps)
        self._loop_settings, self._graph_settings = loop_settings, graph_settings
        self._report = solved
        self.search = LoopSearch(local, loop_settings)
        self.loops: list[Edge] = []
        self.poses = local.poses_local_node.copy()
        # Beyond this node poses are the local ones, moved as the last node before was.
        self._placed = 0
        self.dropped = 0
        self.optimisation_s = 0.0
        self.breaks = TrackingLosses(local)
        self._ways = GraphDistances(local, self.breaks)
        self._first = np.array([submap.first for submap in local.submaps])

    def run(self, progress: Progress) -> None:
        count = len(self.poses)
        solved, loops_solved = 0, 0
        for node in range(0, count, self._loop_settings.every):
            progress(node, count, "closing loops")
            self._place_to(node)
            is_far = self._close(node)
            is_due = node - solved >= max(_KEY_SCANS_MIN, _GROWTH * node)
            if (is_due and len(self.loops) > loops_solved) or is_far:
                self._solve(node + 1, "closing loops", _ROUGHLY)
                solved, loops_solved = node, len(self.loops)
        self._place_to(count - 1)
        if not self.loops:
            return
        progress(count, count, "optimising")
        self._solve(count, "optimising", _EXACTLY)
        away_m = np.hypot(*residuals(self.poses, self.loops)[:, :2].T)
        is_kept = away_m <= self._graph_settings.residual_max_m
        self.dropped += int(np.count_nonzero(~is_kept))
        if not is_kept.all():
            self.loops = [edge for edge, kept in zip(self.loops, is_kept, strict=True) if kept]
            self._solve(count, "optimising", _EXACTLY)

    def _close(self, node: int) -> bool:
        """Search from a node; whether it was found far from where it was thought to be."""
        is_far = False
        candidates = self.search.candidates(
            node,
            self.poses[self.search.centre, :2],
            self.poses[node, :2],
            self._ways.to_submaps(node),
            self.breaks.are_connected(self.search.centre, node),
        )
        for number, window in candidates:
            first = int(self._first[number])
            edge = self.search.match(
                node, number, relative_pose(self.poses[first], self.poses[node]), window
            )
            if edge is None:
                continue
            if not window.is_wide:
                self._take(edge, number)
                continue
            agreeing = self._seconds(edge, self.search.score_min(window))
            is_broken = window.is_across_loss or window.is_across_bridged_loss
            enough = _SECONDS_MIN_BREAK if is_broken else _SECONDS_MIN
            if len(agreeing) < enough:
                self.dropped += 1
                continue
            self._judge(edge, number)
            self._take(edge, number)
            for other, other_number in agreeing:
                # Those of stretches still ahead are found again when they are reached.
                if other.second <= node:
                    self._take(other, other_number)
            is_far = True
            break
        return is_far

    def _judge(self, edge: Edge, number: int) -> None:
        """Whether the loop is where odometry has it, over the breaks between its ends."""
        window = self.search.window(float(self._ways.to_submaps(edge.second)[number]))
        if window.is_across_loss:
            return
        off = residuals(self.poses, [edge])[0]
        is_as_told = np.hypot(off[0], off[1]) <= window.translation_m
        is_as_told &= abs(off[2]) <= window.rotation_rad
        self.breaks.add_loop(edge, agrees_with_odometry=bool(is_as_told))
        for node in self.breaks.node_after[~self.breaks.is_bridged].tolist():
            self.steps[node - 1] = without_information(self.steps[node - 1])
        self._ways.set_losses(self.breaks)

    def _seconds(self, found: Edge, score_min: float) -> list[tuple[Edge, int]]:
        """Edges of stretches before and after that agree with ``found``."""
        local, node = self._local, found.second
        pose = compose_poses(self.poses[found.first], found.pose_first_second)
        agreeing = []
        for away in (2, -2, 4, -4, 6, -6):
            other = node + away * self._loop_settings.window_key_scans
            if not 0 <= other < len(self.poses) or local.segment[other] != local.segment[node]:
                continue
            before = self.search.submaps_before(min(node, other))
            if before == 0:
                continue
            expected = compose_poses(
                pose, relative_pose(local.poses_local_node[node], local.poses_local_node[other])
            )
            centres_m = self.poses[self.search.centre[:before], :2]
            number = int(np.argmin(np.hypot(*(centres_m - expected[:2]).T)))
            first = int(self._first[number])
            edge = self.search.match(
                other, number, relative_pose(self.poses[first], expected), _SECOND_WINDOW, score_min
            )
            if edge is None:
                continue
            off = relative_pose(expected, compose_poses(self.poses[first], edge.pose_first_second))
            if np.hypot(off[0], off[1]) < _AGREES_M:
                agreeing.append((edge, number))
        return agreeing

    def _take(self, edge: Edge, number: int) -> None:
        self.loops.append(edge)
        self.breaks.add_loop(edge, agrees_with_odometry=None)
        self._ways.add_loop(number, edge.second)

    def is_joined(self) -> BoolArray:
        """(K,) by the loops that were kept, and the breaks that they confirm."""
        return self.breaks.connected_by(self.loops)

    def _place_to(self, node: int) -> None:
        """Carry the poses on to a node by the local ones."""
        if node <= self._placed:
            return
        local = self._local.poses_local_node
        begin, end = self._placed, node + 1
        self.poses[begin + 1 : end] = compose_poses(
            self.poses[begin], relative_pose(local[begin], local[begin + 1 : end])
        )
        self._placed = node

    def _solve(self, end: int, stage: str, tolerance: float) -> None:
        """Optimise the nodes before ``end``; those after follow as they are reached."""
        start_s = time.perf_counter()
        reached = [edge for edge in self.loops if edge.second < end]
        self.poses[:end] = optimise(
            self._started(end, reached),
            [*self.steps[: end - 1], *reached],
            self._graph_settings.robust_scale,
            tolerance,
        )
        self._placed = end - 1
        self.optimisation_s += time.perf_counter() - start_s
        self._report(stage, self.poses[:end], reached)

    def _started(self, end: int, reached: list[Edge]) -> FloatArray:
        """(end, 3) poses to start from: where a part hangs on a loop alone, it begins there."""
        poses = self.poses[:end].copy()
        part = self.breaks.unbridged_segments()[:end]
        known = {int(part[0])} | {int(part[edge.second]) for edge in self._solved_loops(reached)}
        for edge in reached:
            here = int(part[edge.second])
            if here in known or int(part[edge.first]) not in known:
                continue
            found = compose_poses(poses[edge.first], edge.pose_first_second)
            moved = compose_poses(found, invert_pose(poses[edge.second]))
            poses[part == here] = compose_poses(moved, poses[part == here])
            known.add(here)
        return poses

    def _solved_loops(self, reached: list[Edge]) -> list[Edge]:
        away_m = np.hypot(*residuals(self.poses, reached)[:, :2].T)
        return [
            edge
            for edge, off_m in zip(reached, away_m.tolist(), strict=True)
            if off_m <= self._graph_settings.residual_max_m
        ]
