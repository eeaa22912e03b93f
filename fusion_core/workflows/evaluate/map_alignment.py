"""The pose of a map in the world: its occupied cells registered with the outlines, in SE(2).

A map has a frame of its own, which starts wherever the robot did. Every pose is tried first
(correlative search), then the best ones are refined by point-to-line ICP (Censi 2008's metric).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only, wrap_angle
from fusion_core.model.errors import RegistrationFailed
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.model.world_outline import WorldOutline
from fusion_core.registration.correlative import SearchWindow, find_best_pose
from fusion_core.registration.likelihood_grid import make_likelihood_pyramid

# The coarse search: cells of 10 cm with a kernel of three, and as many points as show a room.
_SEARCH_CELL_M = 0.1
_SEARCH_KERNEL_M = 0.3
_SEARCH_LEVELS = 6
_SEARCH_POINTS = 600
_FINE_POINTS = 6000
# How far a guess may be off (20 degrees), as ``align_map`` documents.
_NEAR_M, _NEAR_RAD = 1.0, 0.35
# Inlier limits of the rounds of refinement, coarse to fine; a residual of 3 cm, the noise of a
# LiDAR, weighs half.
_INLIER_LIMITS_M = (0.5, 0.3, 0.15)
_HALF_WEIGHT_M = 0.03
# A bound: each round ends once its step is below 1e-7.
_ITERATIONS = 30
# A few times the three parameters of a pose, so that a fit is not by chance.
_PAIRS_MIN = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MapAlignment:
    """``pose_world_map``: (3,) x, y, yaw that maps the map's frame to the world's.

    ``inlier_fraction``: of the occupied cells, those within 15 cm of an outline after the
    alignment.
    """

    pose_world_map: FloatArray
    inlier_fraction: float

    def __post_init__(self) -> None:
        read_only(self.pose_world_map)

    def to_json(self) -> dict[str, Any]:
        """Translation in metres, rotation in degrees."""
        x, y, yaw = (float(value) for value in self.pose_world_map)
        return {
            "x_m": x,
            "y_m": y,
            "yaw_deg": float(np.degrees(yaw)),
            "cells_near": self.inlier_fraction,
        }


def align_map(
    occupied_m: FloatArray, world: WorldOutline, guess: FloatArray | None
) -> MapAlignment:
    """Align occupied cells (N, 2) with the outlines that a sensor could see (all, where none).

    ``guess``: (x, y, yaw) of the map's frame in the world, good to 1 m and 20°; without it the
    whole world is searched. Raises RegistrationFailed where they do not fit anywhere.
    """
    if len(occupied_m) < _PAIRS_MIN:
        raise RegistrationFailed(
            f"the map has {len(occupied_m)} occupied cells, too few to align it with the world.",
            advice="Use --align none, or map the whole recording.",
        )
    target = _OutlineSamples(world)
    starts = [target.search(occupied_m, np.zeros(3) if guess is None else guess, _NEAR_M)]
    if guess is None:
        starts.append(target.search(occupied_m, None, target.search_radius_m))
    found = [target.refine(occupied_m, start) for start in starts]
    # The first of equals, so that a map in the world's own frame stays where it is.
    best = max(found, key=lambda alignment: alignment.inlier_fraction)
    if best.inlier_fraction * len(occupied_m) < _PAIRS_MIN:
        raise RegistrationFailed(
            "the map fits nowhere on the outlines of the world.",
            advice="Check that both are of one scene, or name where the map starts with --pose.",
        )
    return best


class _OutlineSamples:
    """The samples of the outlines, (M, 2), with the outlines' normals there."""

    def __init__(self, world: WorldOutline) -> None:
        from scipy.spatial import cKDTree

        points, normals = [np.zeros((0, 2))], [np.zeros((0, 2))]
        for visible_alone in (True, False):
            for obstacle in world.obstacles:
                samples_m = obstacle.samples_m()
                if len(samples_m) < 2:
                    continue
                along = np.gradient(samples_m, axis=0)
                along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
                kept = np.ones(len(samples_m), dtype=np.bool_)
                if visible_alone:
                    kept = obstacle.seen_samples("lidar") | obstacle.seen_samples("camera")
                points.append(samples_m[kept])
                normals.append(np.stack([-along[:, 1], along[:, 0]], axis=1)[kept])
            if any(map(len, points)):
                break
        self._points_m = np.concatenate(points)
        self._normals = np.concatenate(normals)
        if len(self._points_m) == 0:
            raise RegistrationFailed("the world has no outline to align a map with.")
        self._tree = cKDTree(self._points_m)
        self._middle_m = 0.5 * (self._points_m.min(axis=0) + self._points_m.max(axis=0))
        # A map of a part of the world may lie anywhere in it.
        self.search_radius_m = 0.5 * float(np.ptp(self._points_m, axis=0).max()) + _NEAR_M

    def search(
        self, occupied_m: FloatArray, about: FloatArray | None, translation_m: float
    ) -> FloatArray:
        """The best of all poses near (x, y, yaw), or anywhere where None."""
        points_m = _subsample(occupied_m, _SEARCH_POINTS)
        # Rotated about their own middle, the points need a smaller translation window.
        middle_m = 0.5 * (points_m.min(axis=0) + points_m.max(axis=0))
        if about is None:
            centre, rotation_rad = np.array([*self._middle_m, 0.0]), np.pi
        else:
            centre, rotation_rad = (
                np.array([*transform_planar_points(about, middle_m), about[2]]),
                _NEAR_RAD,
            )
        window = SearchWindow(
            centre=(float(centre[0]), float(centre[1]), float(centre[2])),
            translation_m=translation_m,
            rotation_rad=rotation_rad,
        )
        pyramid = make_likelihood_pyramid(
            self._points_m,
            resolution_m=_SEARCH_CELL_M,
            truncation_m=_SEARCH_KERNEL_M,
            levels=_SEARCH_LEVELS,
        )
        try:
            pose = find_best_pose(pyramid, points_m - middle_m, window)
        except RegistrationFailed:
            # No point is near any outline: the refinement then finds no inlier.
            pose = centre
        back = transform_planar_points(np.array([0.0, 0.0, pose[2]]), -middle_m[None])[0]
        return np.array([*(pose[:2] + back), pose[2]])

    def refine(self, occupied_m: FloatArray, start: FloatArray) -> MapAlignment:
        """Iterated least squares of the distances between cells and outlines."""
        points_m = _subsample(occupied_m, _FINE_POINTS)
        pose = start.copy()
        for inlier_limit_m in _INLIER_LIMITS_M:
            for _ in range(_ITERATIONS):
                step = self._gauss_newton_step(
                    transform_planar_points(pose, points_m), inlier_limit_m
                )
                c, s = np.cos(step[2]), np.sin(step[2])
                x, y = pose[:2] - self._middle_m
                pose = np.array(
                    [
                        c * x - s * y + self._middle_m[0] + step[0],
                        s * x + c * y + self._middle_m[1] + step[1],
                        float(wrap_angle(pose[2] + step[2])),
                    ]
                )
                if np.abs(step).max() < 1e-7:
                    break
        distance_m, _ = self._tree.query(transform_planar_points(pose, occupied_m))
        return MapAlignment(
            pose_world_map=pose, inlier_fraction=float(np.mean(distance_m < _INLIER_LIMITS_M[-1]))
        )

    def _gauss_newton_step(self, points_m: FloatArray, inlier_limit_m: float) -> FloatArray:
        """(3,) translation and rotation about the middle of the world; zero without inliers."""
        distance_m, index = map(np.asarray, self._tree.query(points_m))
        near = distance_m < inlier_limit_m
        points_m, target_m = points_m[near], self._points_m[index[near]]
        normals = self._normals[index[near]]
        offset = points_m - self._middle_m
        by_rotation = normals[:, 1] * offset[:, 0] - normals[:, 0] * offset[:, 1]
        jacobian = np.column_stack([normals, by_rotation])
        residual = ((points_m - target_m) * normals).sum(axis=1)
        weights = 1.0 / (1.0 + (residual / _HALF_WEIGHT_M) ** 2)
        system = (weights[:, None] * jacobian).T @ jacobian
        # Along unobservable directions, as that of a corridor, the pose stays.
        step: FloatArray = -np.linalg.lstsq(
            system, (weights[:, None] * jacobian).T @ residual, rcond=1e-9
        )[0]
        return step


def _subsample(points_m: FloatArray, count: int) -> FloatArray:
    """At most ``count`` of the points, evenly from all of them."""
    return points_m[:: -(-len(points_m) // count)]
