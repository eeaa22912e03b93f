"""Bundle adjustment of keyframes and landmarks, by Levenberg-Marquardt and the Schur complement.

ORB-SLAM2 (Mur-Artal & Tardos 2017), §III-B: a robust sum over the errors of u, v and inverse depth
of all observations. Landmarks are eliminated first: what is left is a dense system of six unknowns
a free keyframe, small enough for a local map. A small motion acts on T_camera_map from the left.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.slam.visual.alignment_factors import add_alignments, alignment_cost
from fusion_core.slam.visual.bundle_equations import (
    OrderedObservations,
    add_observations,
    eliminate_landmarks,
    robust_cost,
    tell_outliers,
)
from fusion_core.slam.visual.keyframes import DepthAlignment
from fusion_core.slam.visual.pose_optimisation import exp_se3, multiply_transforms, orthonormalise

_DAMPING_START = 1e-6
_DAMPING_MAX = 1e6
# Of the cost; below it another iteration changes nothing that is seen.
_COST_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BundleProblem:
    """K keyframes, L landmarks, O observations.

    ``T_camera_map``: (K, 4, 4). ``is_fixed``: (K,), at least one is. ``points_in_map_m``: (L, 3).
    Of each observation: ``keyframes``, ``landmarks``: (O,), rows of the former; ``pixels``: (O, 2);
    ``depths_m``: (O,), NaN where missing; ``pixel_sigmas``: (O,). ``camera``: (4,) fx, fy, cx, cy.
    ``depth_sigma_per_m2``: see ``ObservationNoise``. ``alignments``: between rows of the keyframes.
    """

    T_camera_map: FloatArray
    is_fixed: BoolArray
    points_in_map_m: FloatArray
    keyframes: IntArray
    landmarks: IntArray
    pixels: FloatArray
    depths_m: FloatArray
    pixel_sigmas: FloatArray
    camera: FloatArray
    depth_sigma_per_m2: float
    alignments: tuple[DepthAlignment, ...] = ()

    def __post_init__(self) -> None:
        if not self.is_fixed.any():
            raise ValueError("a bundle adjustment needs a fixed keyframe")
        for array in (
            self.T_camera_map,
            self.is_fixed,
            self.points_in_map_m,
            self.keyframes,
            self.landmarks,
            self.pixels,
            self.depths_m,
            self.pixel_sigmas,
            self.camera,
        ):
            read_only(array)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BundleResult:
    """``T_camera_map``: (K, 4, 4). ``points_in_map_m``: (L, 3). ``is_inlier``: (O,) of the
    observations. ``cost``: half the robust sum of squares, before and after."""

    T_camera_map: FloatArray
    points_in_map_m: FloatArray
    is_inlier: BoolArray
    cost: tuple[float, float]

    def __post_init__(self) -> None:
        for array in (self.T_camera_map, self.points_in_map_m, self.is_inlier):
            read_only(array)


def adjust_bundle(problem: BundleProblem, iterations: int, rounds: int = 2) -> BundleResult:
    """Adjust the free keyframes and all landmarks.

    After each of ``rounds`` outliers are told apart and left out of the next; each takes at most
    ``iterations``.
    """
    order = np.argsort(problem.landmarks, kind="stable")
    counts = np.bincount(problem.landmarks, minlength=len(problem.points_in_map_m))
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    free = np.full(len(problem.is_fixed), -1, np.int64)
    free[~problem.is_fixed] = np.arange(np.count_nonzero(~problem.is_fixed))
    seen = OrderedObservations(
        starts=starts,
        keyframes=problem.keyframes[order],
        pixels=problem.pixels[order].astype(np.float64),
        depths_m=problem.depths_m[order],
        pixel_sigmas=problem.pixel_sigmas[order],
        is_inlier=np.ones(len(order), np.bool_),
        camera=problem.camera,
        depth_sigma_per_m2=problem.depth_sigma_per_m2,
    )
    poses, points, before, after = _adjust(
        np.array(problem.T_camera_map, np.float64),
        free,
        np.array(problem.points_in_map_m, np.float64),
        seen,
        np.array([(a.first, a.second) for a in problem.alignments], np.int64).reshape(-1, 2),
        np.array([a.T_second_first for a in problem.alignments]).reshape(-1, 4, 4),
        np.array([a.information for a in problem.alignments]).reshape(-1, 6, 6),
        iterations,
        rounds,
        _DAMPING_START,
        _DAMPING_MAX,
        _COST_TOLERANCE,
    )
    is_inlier = np.empty(len(order), np.bool_)
    is_inlier[order] = seen.is_inlier
    return BundleResult(
        T_camera_map=poses, points_in_map_m=points, is_inlier=is_inlier, cost=(before, after)
    )


@compiled(nogil=True)
def _adjust(
    poses: FloatArray,
    free: IntArray,
    points: FloatArray,
    seen: OrderedObservations,
    pairs: IntArray,
    T_second_first: FloatArray,
    information: FloatArray,
    iterations: int,
    rounds: int,
    damping_start: float,
    damping_max: float,
    cost_tolerance: float,
) -> tuple[FloatArray, FloatArray, float, float]:
    """The poses, the points, and the cost before and after; ``seen.is_inlier`` is written."""
    starts, keyframes, is_inlier = seen.starts, seen.keyframes, seen.is_inlier
    observations, landmarks = len(keyframes), len(points)
    unknowns = 6 * (free.max() + 1)
    cross = np.zeros((observations, 6, 3))
    Hll, inverses = np.zeros((landmarks, 3, 3)), np.zeros((landmarks, 3, 3))
    gradients = np.zeros((landmarks, 3))
    g = np.zeros(3)
    first_cost = -1.0
    cost = 0.0
    for _ in range(rounds):
        damping = damping_start
        cost = robust_cost(poses, points, seen)
        cost += alignment_cost(poses, pairs, T_second_first, information)
        if first_cost < 0.0:
            first_cost = cost
        for _ in range(iterations):
            # The blocks of the normal equations, undamped; S0 holds those of the poses.
            S0, b0 = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
            add_observations(poses, free, points, seen, S0, b0, cross, Hll, gradients)
            add_alignments(poses, free, pairs, T_second_first, information, S0, b0)
            accepted = False
            gain = 0.0
            while not accepted and damping <= damping_max:
                S, b = S0.copy(), b0.copy()
                for i in range(unknowns):
                    S[i, i] += damping * S0[i, i] + 1e-12
                eliminate_landmarks(free, seen, cross, Hll, gradients, damping, S, b, inverses)
                step = np.linalg.solve(S, -b)
                new_poses, new_points = poses.copy(), points.copy()
                for k in range(len(free)):
                    if free[k] >= 0:
                        new_poses[k] = multiply_transforms(
                            exp_se3(step[6 * free[k] : 6 * free[k] + 6]), poses[k]
                        )
                        orthonormalise(new_poses[k])
                for landmark in range(landmarks):
                    g[:] = gradients[landmark]
                    for o in range(starts[landmark], starts[landmark + 1]):
                        row = 6 * free[keyframes[o]]
                        if row < 0 or not is_inlier[o]:
                            continue
                        for j in range(3):
                            for i in range(6):
                                g[j] += cross[o, i, j] * step[row + i]
                    for i in range(3):
                        for j in range(3):
                            new_points[landmark, i] -= inverses[landmark, i, j] * g[j]
                new_cost = robust_cost(new_poses, new_points, seen)
                new_cost += alignment_cost(new_poses, pairs, T_second_first, information)
                if new_cost <= cost:
                    gain = cost - new_cost
                    poses, points, cost = new_poses, new_points, new_cost
                    damping = max(damping * 0.1, 1e-12)
                    accepted = True
                else:
                    damping *= 10.0
            if not accepted or gain <= cost_tolerance * cost:
                break
        tell_outliers(poses, points, seen)
    return poses, points, first_cost, cost
