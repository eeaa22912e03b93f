"""Loop search: a local window of keyframes, matched with submaps of other visits.

A single scan of a corridor fits at many places. The points of a local window of keyframes, joined
by their local poses, are a small map with corners and doors: branch and bound finds where it fits
a finished submap best (Hess et al. 2016, V.B, eq. BBS), and Gauss-Newton refines that. The search
is as wide as the drift over the path between the two along the graph.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.bounded_cache import BoundedCache
from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.errors import RegistrationFailed
from fusion_core.model.planar_poses import compose_poses, relative_pose, transform_planar_points
from fusion_core.registration.correlative import SearchWindow, match_correlative
from fusion_core.registration.likelihood_grid import LikelihoodPyramid, make_likelihood_pyramid
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.graph_distances import LOSS_DISTANCE_M
from fusion_core.slam.identifiers import NodeId, SubmapId
from fusion_core.slam.local_trajectory import LocalTrajectory
from fusion_core.slam.pose_graph import Edge
from fusion_core.slam.scan_to_grid import match_scan

# Between two headings: half a cell at five metres, which Gauss-Newton corrects.
_HEADING_STEP_RAD = 0.01
# Levels of branch and bound, set by hand: blocks of 2⁵ = 32 cells at the top.
_LEVELS = 6
# Memory: a pyramid takes some megabytes. Set by hand.
_PYRAMIDS_MAX = 48
# Truncation distance of the likelihood: the error of local poses within a window. Empirical.
_TRUNCATION_M = 0.15
# Added to an edge's information, which along a bare wall would be singular: 1 m and 0.5 rad. Set by
# hand.
_INFORMATION_MIN = np.diag([1.0, 1.0, 4.0])
# Points of a search: the score's sampling error is then a few hundredths.
_SEARCH_POINTS = 300
# A window beyond this is wide, and what is found in it must be confirmed. A room's size.
WIDE_M = 5.0
# Every n-th wide search ignores odometry over tracking losses: the robot may have been kidnapped.
_KIDNAPPED_EVERY = 8
# Submaps tried in the others, since no loop has narrowed the choice. Empirical.
_TRIES_OVER_LOSS = 3


class LoopSettings(StageSettings):
    """Search for places seen before."""

    every: int = setting(5, "Keyframes between two searches", unit="keyframes", ge=1, le=1000)
    window_keyframes: int = setting(
        10,
        "Keyframes before and after that are matched together, the local window",
        unit="keyframes",
        ge=0,
        le=500,
        formerly="stretch",
    )
    distance_m: float = setting(
        8.0, "Submaps nearer than this are candidates", unit="m", ge=1e-6, le=200
    )
    submaps: int = setting(2, "Nearest submaps tried in a search", ge=1, le=100)
    window_m: float = setting(2.0, "Search about the estimate", unit="m", ge=1e-6, le=50.0)
    window_rad: float = setting(0.35, "Search about the estimate", unit="rad", ge=1e-6, le=3.1416)
    drift_m_per_m: float = setting(
        0.04,
        "Search window's growth with the path length",
        unit="m/m",
        ge=0.0,
        le=10.0,
        formerly="drift",
    )
    drift_rad_per_m: float = setting(
        0.0005,
        "Search window's growth with the path length",
        unit="rad/m",
        ge=0.0,
        le=10.0,
        formerly="drift_rad_m",
    )
    window_max_m: float = setting(40.0, "Widest search", unit="m", ge=1e-6, le=100.0)
    score_min: float = setting(0.6, "Least fraction of points on obstacles", ge=0.1, le=1.0)
    score_min_wide: float = setting(
        0.4, "Least score in a wide window, where other matches must confirm", ge=0.1, le=1.0
    )
    score_min_loss: float = setting(
        0.7,
        "Least score across a tracking loss, where no prior limits the search",
        ge=0.1,
        le=1.0,
        formerly="score_min_break",
    )
    contradiction_max: float = setting(
        0.15,
        "Largest fraction of points in free cells, beyond that in their own submap",
        ge=0.0,
        le=1.0,
    )
    sigma_max_m: float = setting(
        0.3, "Largest standard deviation of a match in any direction", unit="m", ge=1e-6, le=100.0
    )
    subsampling_m: float = setting(
        0.1,
        "Cell size to which a local window's points are subsampled",
        unit="m",
        ge=0.001,
        le=10.0,
        formerly="thinning_m",
    )

    @property
    def widest_window(self) -> "LoopWindow":
        """The largest window of any search."""
        return LoopWindow(self.window_max_m, float(np.pi))


@dataclass(frozen=True, slots=True)
class LoopWindow:
    """How far the estimate of a pose between two places may be off, in metres and radians.

    ``is_across_loss``: over a tracking loss, so that nothing is known of the motion.
    ``is_across_bridged_loss``: over a loss that only odometry bridges.
    """

    translation_m: float
    rotation_rad: float
    is_across_loss: bool = False
    is_across_bridged_loss: bool = False

    @property
    def is_wide(self) -> bool:
        return self.translation_m > WIDE_M

    @property
    def step_rad(self) -> float:
        """Step between two yaws that are tried."""
        return 2.0 * _HEADING_STEP_RAD if self.is_wide else _HEADING_STEP_RAD


class LoopSearch:
    """Finds edges between keyframes and submaps of a local trajectory."""

    def __init__(self, local: LocalTrajectory, settings: LoopSettings) -> None:
        self._local, self._settings = local, settings
        self._end = np.array([submap.end for submap in local.submaps])
        self.centre = np.array([(s.first + s.end - 1) // 2 for s in local.submaps])
        self._pyramids = BoundedCache[SubmapId, LikelihoodPyramid | None](_PYRAMIDS_MAX)
        # Several submaps are tried with one local window.
        self._window_points: tuple[NodeId, FloatArray] | None = None
        # The node from which each submap was last searched near the estimate.
        self._searched_from = np.full(self.centre.size, np.iinfo(np.int64).min)
        self.tried = 0

    def window(self, distance_m: float, *, is_across_bridged_loss: bool = False) -> LoopWindow:
        """The window for a path length, which is infinite where the two are not connected."""
        settings = self._settings
        # Zero times an infinite length would be NaN.
        grown_m = min(distance_m, 1e6)
        return LoopWindow(
            min(settings.window_m + settings.drift_m_per_m * grown_m, settings.window_max_m),
            min(settings.window_rad + settings.drift_rad_per_m * grown_m, float(np.pi)),
            is_across_loss=distance_m >= LOSS_DISTANCE_M,
            is_across_bridged_loss=is_across_bridged_loss,
        )

    def score_min(self, window: LoopWindow) -> float:
        """The least score of a match in a window."""
        settings = self._settings
        if window.is_across_loss:
            return max(settings.score_min, settings.score_min_loss)
        return settings.score_min_wide if window.is_wide else settings.score_min

    def submaps_before(self, node: int) -> int:
        """How many submaps ended before a local window; they end in the order of their numbers."""
        return int(np.searchsorted(self._end, node - 3 * self._settings.window_keyframes))

    def candidates(
        self,
        node: NodeId,
        centres_m: FloatArray,
        place_m: FloatArray,
        distances_m: FloatArray,
        is_connected: BoolArray,
    ) -> list[tuple[SubmapId, LoopWindow]]:
        """Submaps that keyframe ``node`` may overlap, with the window of each, the nearest first.

        ``centres_m``: (S, 2) of the submaps in the map; ``place_m``: (2,) of the node;
        ``distances_m``: (S,) from it to each along the graph; ``is_connected``: (S,) whether loops
        or confirmed odometry connect them. A submap near the estimate is tried with local windows
        that have no keyframe in common, since their matches would not be independent. Wide windows
        are searched every other time, one submap after the other.
        """
        settings = self._settings
        before = self.submaps_before(node)
        away_m = np.hypot(*(centres_m[:before] - place_m).T)
        search_round = node // settings.every
        is_kidnapped = search_round % (2 * _KIDNAPPED_EVERY) == 0
        if is_kidnapped:
            distances_m = np.where(is_connected, distances_m, LOSS_DISTANCE_M)
        window_m = np.minimum(
            settings.window_m + settings.drift_m_per_m * distances_m[:before], settings.window_max_m
        )
        is_wide = window_m > WIDE_M
        near = np.flatnonzero(~is_wide & (away_m < settings.distance_m))
        near = near[np.argsort(away_m[near], kind="stable")[: settings.submaps]]
        chosen = near[self._searched_from[near] < node - 2 * settings.window_keyframes].tolist()
        self._searched_from[chosen] = node
        far = np.flatnonzero(is_wide & (away_m < settings.distance_m + window_m))
        if far.size and search_round % 2 == 0:
            # Two neighbours overlap by half.
            far = far[:: 2 if far.size > 8 else 1]
            count = search_round // (2 * _KIDNAPPED_EVERY) if is_kidnapped else search_round // 2
            tries = 1 if is_kidnapped or is_connected[far].all() else _TRIES_OVER_LOSS
            for number in far[(count * tries + np.arange(tries)) % far.size].tolist():
                if number not in chosen:
                    chosen.append(number)
            nearest = int(far[np.argmin(away_m[far])])
            if nearest not in chosen:
                chosen.append(nearest)
        return [
            (
                SubmapId(number),
                self.window(
                    float(distances_m[number]), is_across_bridged_loss=not is_connected[number]
                ),
            )
            for number in chosen
        ]

    def match(
        self,
        node: NodeId,
        number: SubmapId,
        pose_first_node: FloatArray,
        window: LoopWindow,
        score_min: float | None = None,
    ) -> Edge | None:
        """The edge from submap ``number`` to keyframe ``node``, None where it does not fit well.

        ``pose_first_node``: (3,) the estimate, in the frame of the submap's first keyframe.
        ``score_min``: instead of the window's.
        """
        settings = self._settings
        if score_min is None:
            score_min = self.score_min(window)
        self.tried += 1
        points_m, pyramid = self._local_window_points(node), self._pyramid(number)
        if points_m.shape[0] == 0 or pyramid is None:
            return None
        submap = self._local.submaps[number]
        anchor = self._local.poses_local_node[submap.first]
        predicted = compose_poses(anchor, pose_first_node)
        stride = -(-points_m.shape[0] // _SEARCH_POINTS)
        try:
            coarse = match_correlative(
                pyramid,
                points_m[::stride],
                SearchWindow(
                    centre=(float(predicted[0]), float(predicted[1]), float(predicted[2])),
                    translation_m=window.translation_m,
                    rotation_rad=window.rotation_rad,
                ),
                step_rad=window.step_rad,
                score_min=score_min,
            )
        except RegistrationFailed:
            return None
        if np.sqrt(np.linalg.eigvalsh(coarse.covariance[:2, :2])[-1]) > settings.sigma_max_m:
            return None
        match = match_scan(submap.grid, points_m, coarse.pose_map_points)
        if self._is_contradicted(node, number, match.pose_grid_scan, points_m):
            return None
        return Edge(
            first=submap.first,
            second=node,
            pose_first_second=relative_pose(anchor, match.pose_grid_scan),
            information=match.information + _INFORMATION_MIN,
            is_loop=True,
        )

    def _is_contradicted(
        self, node: NodeId, number: SubmapId, pose: FloatArray, points_m: FloatArray
    ) -> bool:
        """Whether a submap contradicts a local window by much more than its own submap:
        the noise of a coarse sensor contradicts every map.
        """
        beyond = self._contradiction(number, pose, points_m) - self._settings.contradiction_max
        if beyond <= 0.0:
            return False
        own = next(
            SubmapId(other)
            for other, submap in enumerate(self._local.submaps)
            if submap.first <= node < submap.end
        )
        if self._pyramid(own) is None:
            return True
        return beyond > self._contradiction(own, self._local.poses_local_node[node], points_m)

    def _contradiction(self, number: SubmapId, pose: FloatArray, points_m: FloatArray) -> float:
        """Fraction of the points in free cells of the submap without an obstacle near.

        A wall with a small error lies beside the submap's, and is no contradiction.
        """
        submap, pyramid = self._local.submaps[number], self._pyramid(number)
        assert pyramid is not None
        corner = np.array(submap.grid.corner_m)
        cells = np.floor(
            (transform_planar_points(pose, points_m) - corner) / submap.grid.resolution_m
        ).astype(np.int64)
        rows, columns = submap.grid.cells.shape
        inside = (cells >= 0).all(axis=1) & (cells < [columns, rows]).all(axis=1)
        cells = cells[inside]
        # Unknown is 0, and the lowest probability is above that.
        is_known = submap.grid.cells[cells[:, 1], cells[:, 0]] > 0
        cells = cells[is_known] + np.rint(
            (corner - np.array(pyramid.corner_m)) / submap.grid.resolution_m
        ).astype(np.int64)
        rows, columns = pyramid.levels.shape[1:]
        inside = (cells >= 0).all(axis=1) & (cells < [columns, rows]).all(axis=1)
        near = pyramid.levels[0, cells[inside, 1], cells[inside, 0]] > 0
        return float(len(cells) - np.count_nonzero(near)) / len(points_m)

    def _local_window_points(self, node: NodeId) -> FloatArray:
        """(n, 2) points of the local window in the node's frame, subsampled to one in a cell."""
        if self._window_points is None or self._window_points[0] != node:
            half, segment = self._settings.window_keyframes, self._local.segment
            nodes = np.arange(
                max(node - half, 0), min(node + half + 1, len(self._local.poses_local_node))
            )
            nodes = nodes[segment[nodes] == segment[node]]
            joined = np.concatenate(
                [
                    transform_planar_points(pose, self._local.node_points_m[other])
                    for pose, other in zip(
                        relative_pose(
                            self._local.poses_local_node[node], self._local.poses_local_node[nodes]
                        ),
                        nodes.tolist(),
                        strict=True,
                    )
                ]
            )
            cells = np.floor(joined / self._settings.subsampling_m).astype(np.int64)
            _, first = np.unique(cells[:, 0] * (1 << 32) + cells[:, 1], return_index=True)
            self._window_points = node, joined[np.sort(first)]
        return self._window_points[1]

    def _pyramid(self, number: SubmapId) -> LikelihoodPyramid | None:
        return self._pyramids.get_or_compute(number, lambda: self._make_pyramid(number))

    def _make_pyramid(self, number: SubmapId) -> LikelihoodPyramid | None:
        """None for a submap without obstacles."""
        submap = self._local.submaps[number]
        obstacles_m = submap.obstacles_m()
        if not obstacles_m.size:
            return None
        return make_likelihood_pyramid(
            obstacles_m,
            resolution_m=submap.grid.resolution_m,
            truncation_m=_TRUNCATION_M,
            levels=_LEVELS,
        )
