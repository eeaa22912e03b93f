"""Loop closing: a key scan and its neighbours in time, laid on submaps of other visits.

A single scan of a corridor fits at many places. The points of a stretch of key scans, joined by
their local poses, are a small map with corners and doors: branch and bound (Hess et al. 2016, V)
finds where it fits a finished submap best, and Gauss-Newton makes that exact.
"""

from collections import OrderedDict

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import RegistrationFailed
from fusion_core.registration.correlative import SearchWindow, correlate
from fusion_core.registration.likelihood_grid import LikelihoodPyramid, likelihood_pyramid
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.local_slam import LocalTrajectory
from fusion_core.slam.planar_poses import compose, move_points, relative
from fusion_core.slam.pose_graph import Edge
from fusion_core.slam.scan_to_grid import match_scan

# Half a cell at five metres: what Gauss-Newton makes good.
_STEP_RAD = 0.01
_LEVELS = 6
_PYRAMIDS_KEPT = 48
# Where the likelihood of an obstacle's cell ends: local poses bend by about that much.
_REACH_M = 0.15
# Without any, an edge along a bare wall would be singular.
_LEAST_INFORMATION = np.diag([1.0, 1.0, 4.0])


class LoopSettings(StageSettings):
    """Search for places seen before."""

    every: int = setting(5, "Key scans between two searches", unit="key scans", ge=1, le=1000)
    stretch: int = setting(
        10, "Neighbours either way laid with one", unit="key scans", ge=0, le=500
    )
    distance_m: float = setting(8.0, "Submaps nearer than this are tried", unit="m", gt=0, le=200)
    submaps: int = setting(4, "Submaps tried at a time", ge=1, le=100)
    window_m: float = setting(4.0, "Search about the estimate", unit="m", gt=0.0, le=50.0)
    window_rad: float = setting(0.35, "Search about the estimate", unit="rad", gt=0.0, le=3.1416)
    score_min: float = setting(0.6, "Least share of points on obstacles", ge=0.1, le=1.0)
    sigma_max_m: float = setting(0.3, "Largest doubt of a match along any way", unit="m", gt=0.0)
    thinning_m: float = setting(0.1, "Points of a stretch are this far apart", unit="m", gt=0.0)


class LoopSearch:
    """Finds edges between key scans and submaps of a local trajectory."""

    def __init__(self, local: LocalTrajectory, settings: LoopSettings) -> None:
        self._local, self._settings = local, settings
        self._centre = np.array([(s.first + s.end - 1) // 2 for s in local.submaps])
        self._obstacles_m = [submap.obstacles_m() for submap in local.submaps]
        self._pyramids: OrderedDict[int, LikelihoodPyramid] = OrderedDict()
        self.tried = 0

    def edges_of(self, node: int, poses_map_node: FloatArray) -> list[Edge]:
        """Loop edges of key scan ``node`` to submaps that ended before its stretch.

        ``poses_map_node``: (>= node + 1, 3) the best poses so far.
        """
        points_m = self._stretch_points(node)
        if points_m.shape[0] == 0:
            return []
        found = []
        for number in self._candidates(node, poses_map_node):
            self.tried += 1
            edge = self._match(node, points_m, number, poses_map_node)
            if edge is not None:
                found.append(edge)
        return found

    def _candidates(self, node: int, poses_map_node: FloatArray) -> list[int]:
        settings = self._settings
        before = [
            number
            for number, submap in enumerate(self._local.submaps)
            if submap.end + 3 * settings.stretch < node and self._obstacles_m[number].size > 0
        ]
        away_m = np.hypot(*(poses_map_node[self._centre[before], :2] - poses_map_node[node, :2]).T)
        order = np.argsort(away_m, kind="stable")[: settings.submaps]
        return [before[i] for i in order if away_m[i] < settings.distance_m]

    def _stretch_points(self, node: int) -> FloatArray:
        """(n, 2) points of the stretch in the node's frame, one in each cell of the thinning."""
        reach = self._settings.stretch
        poses = self._local.key_poses
        nodes = range(max(node - reach, 0), min(node + reach + 1, len(poses)))
        joined = np.concatenate(
            [
                move_points(relative(poses[node], poses[other]), self._local.key_points_m[other])
                for other in nodes
            ]
        )
        cells = np.floor(joined / self._settings.thinning_m).astype(np.int64)
        _, first = np.unique(cells, axis=0, return_index=True)
        return joined[np.sort(first)]

    def _match(
        self,
        node: int,
        points_m: FloatArray,
        number: int,
        poses_map_node: FloatArray,
    ) -> Edge | None:
        settings = self._settings
        submap = self._local.submaps[number]
        anchor = self._local.key_poses[submap.first]
        predicted = compose(anchor, relative(poses_map_node[submap.first], poses_map_node[node]))
        window = SearchWindow(
            centre=(float(predicted[0]), float(predicted[1]), float(predicted[2])),
            translation_m=settings.window_m,
            rotation_rad=settings.window_rad,
        )
        try:
            coarse = correlate(
                self._pyramid(number),
                points_m,
                window,
                step_rad=_STEP_RAD,
                score_min=settings.score_min,
            )
        except RegistrationFailed:
            return None
        if np.sqrt(np.linalg.eigvalsh(coarse.covariance[:2, :2])[-1]) > settings.sigma_max_m:
            return None
        match = match_scan(
            submap.occupancy, submap.corner_m, submap.resolution_m, points_m, coarse.pose_map_points
        )
        return Edge(
            first=submap.first,
            second=node,
            pose_first_second=relative(anchor, match.pose_grid_scan),
            information=match.information + _LEAST_INFORMATION,
            is_loop=True,
        )

    def _pyramid(self, number: int) -> LikelihoodPyramid:
        if number in self._pyramids:
            self._pyramids.move_to_end(number)
        else:
            self._pyramids[number] = likelihood_pyramid(
                self._obstacles_m[number],
                resolution_m=self._local.submaps[number].resolution_m,
                reach_m=_REACH_M,
                levels=_LEVELS,
            )
            if len(self._pyramids) > _PYRAMIDS_KEPT:
                self._pyramids.popitem(last=False)
        return self._pyramids[number]
