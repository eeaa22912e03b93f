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
from fusion_core.slam.visual.keyframes import DepthAlignment
from fusion_core.slam.visual.observation_noise import CHI2_DEPTH, CHI2_PIXEL
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
    poses, points, inlier, before, after = _adjust(
        np.array(problem.T_camera_map, np.float64),
        free,
        np.array(problem.points_in_map_m, np.float64),
        starts,
        problem.keyframes[order],
        problem.pixels[order].astype(np.float64),
        problem.depths_m[order],
        problem.pixel_sigmas[order],
        problem.camera,
        problem.depth_sigma_per_m2,
        np.array([(a.first, a.second) for a in problem.alignments], np.int64).reshape(-1, 2),
        np.array([a.T_second_first for a in problem.alignments]).reshape(-1, 4, 4),
        np.array([a.information for a in problem.alignments]).reshape(-1, 6, 6),
        iterations,
        rounds,
        CHI2_PIXEL,
        CHI2_DEPTH,
        _DAMPING_START,
        _DAMPING_MAX,
        _COST_TOLERANCE,
    )
    is_inlier = np.empty(len(order), np.bool_)
    is_inlier[order] = inlier
    return BundleResult(
        T_camera_map=poses, points_in_map_m=points, is_inlier=is_inlier, cost=(before, after)
    )


@compiled(nogil=True)
def _residual(
    poses: FloatArray,
    k: int,
    points: FloatArray,
    landmark: int,
    pixels: FloatArray,
    o: int,
    depth: float,
    sigma: float,
    inverse_depth_sigma: float,
    camera: FloatArray,
    r: FloatArray,
    p: FloatArray,
) -> bool:
    """Normalised errors into ``r`` (3,), the point before the camera into ``p`` (3,); whether it
    lies before it. What is of one keyframe, landmark and observation is given by its row: to make
    views of the rows takes as long as the rest."""
    x, y, z = points[landmark, 0], points[landmark, 1], points[landmark, 2]
    for i in range(3):
        p[i] = poses[k, i, 0] * x + poses[k, i, 1] * y + poses[k, i, 2] * z + poses[k, i, 3]
    if p[2] < 0.01:
        return False
    r[0] = (camera[0] * p[0] / p[2] + camera[2] - pixels[o, 0]) / sigma
    r[1] = (camera[1] * p[1] / p[2] + camera[3] - pixels[o, 1]) / sigma
    r[2] = 0.0 if np.isnan(depth) else (1.0 / p[2] - 1.0 / depth) / inverse_depth_sigma
    return True


@compiled(nogil=True)
def _cost(
    poses: FloatArray,
    points: FloatArray,
    starts: IntArray,
    keyframes: IntArray,
    pixels: FloatArray,
    depths: FloatArray,
    sigmas: FloatArray,
    inlier: BoolArray,
    camera: FloatArray,
    inverse_depth_sigma: float,
    chi2_pixel: float,
    chi2_depth: float,
) -> float:
    r, p = np.zeros(3), np.zeros(3)
    total = 0.0
    for landmark in range(len(points)):
        for o in range(starts[landmark], starts[landmark + 1]):
            if not inlier[o]:
                continue
            limit = chi2_pixel if np.isnan(depths[o]) else chi2_depth
            if not _residual(
                poses,
                keyframes[o],
                points,
                landmark,
                pixels,
                o,
                depths[o],
                sigmas[o],
                inverse_depth_sigma,
                camera,
                r,
                p,
            ):
                # As bad as a gross outlier, so that a step that throws points behind is refused.
                total += 100.0 * limit
                continue
            chi2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
            total += 0.5 * chi2 if chi2 <= limit else np.sqrt(limit * chi2) - 0.5 * limit
    return total


@compiled(nogil=True)
def _adjust(
    poses: FloatArray,
    free: IntArray,
    points: FloatArray,
    starts: IntArray,
    keyframes: IntArray,
    pixels: FloatArray,
    depths: FloatArray,
    sigmas: FloatArray,
    camera: FloatArray,
    inverse_depth_sigma: float,
    pairs: IntArray,
    T_second_first: FloatArray,
    information: FloatArray,
    iterations: int,
    rounds: int,
    chi2_pixel: float,
    chi2_depth: float,
    damping_start: float,
    damping_max: float,
    cost_tolerance: float,
) -> tuple[FloatArray, FloatArray, BoolArray, float, float]:
    fx, fy = camera[0], camera[1]
    observations, landmarks = len(keyframes), len(points)
    inlier = np.ones(observations, np.bool_)
    unknowns = 6 * (free.max() + 1)
    cross = np.zeros((observations, 6, 3))
    Hll, inverses = np.zeros((landmarks, 3, 3)), np.zeros((landmarks, 3, 3))
    gradients = np.zeros((landmarks, 3))
    r, p, g = np.zeros(3), np.zeros(3), np.zeros(3)
    Q, QR, moments = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    V, inverse, WH = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((6, 3))
    first_cost = -1.0
    cost = 0.0
    for _ in range(rounds):
        damping = damping_start
        cost = _cost(
            poses, points, starts, keyframes, pixels, depths, sigmas, inlier, camera,
            inverse_depth_sigma, chi2_pixel, chi2_depth,
        )  # fmt: skip
        cost += alignment_cost(poses, pairs, T_second_first, information)
        if first_cost < 0.0:
            first_cost = cost
        for _ in range(iterations):
            # The blocks of the normal equations, undamped; S0 holds those of the poses.
            S0 = np.zeros((unknowns, unknowns))
            b0 = np.zeros(unknowns)
            diagonal = np.zeros((unknowns // 6, 6, 6))
            for landmark in range(landmarks):
                for i in range(3):
                    gradients[landmark, i] = 0.0
                    for j in range(3):
                        Hll[landmark, i, j] = 0.0
                for o in range(starts[landmark], starts[landmark + 1]):
                    k = keyframes[o]
                    if not inlier[o] or not _residual(
                        poses, k, points, landmark, pixels, o, depths[o], sigmas[o],
                        inverse_depth_sigma, camera, r, p,
                    ):  # fmt: skip
                        for i in range(6):
                            for j in range(3):
                                cross[o, i, j] = 0.0
                        continue
                    has_depth = not np.isnan(depths[o])
                    chi2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
                    limit = chi2_depth if has_depth else chi2_pixel
                    weight = 1.0 if chi2 <= limit else np.sqrt(limit / chi2)
                    # By a motion of p, the point before the camera, r changes by
                    # A = [a, 0, b; 0, c, d; 0, 0, e]. By one of the landmark p moves by R, by one
                    # of the camera by [-p x, I]: all blocks are products of these with Q = A' A.
                    iz, w = 1.0 / p[2], 1.0 / sigmas[o]
                    a, b = fx * iz * w, -fx * p[0] * iz * iz * w
                    c, d = fy * iz * w, -fy * p[1] * iz * iz * w
                    e = -iz * iz / inverse_depth_sigma if has_depth else 0.0
                    Q[0, 0], Q[1, 1] = weight * a * a, weight * c * c
                    Q[2, 2] = weight * (b * b + d * d + e * e)
                    Q[0, 2] = Q[2, 0] = weight * a * b
                    Q[1, 2] = Q[2, 1] = weight * c * d
                    g[0], g[1] = weight * a * r[0], weight * c * r[1]
                    g[2] = weight * (b * r[0] + d * r[1] + e * r[2])
                    for i in range(3):
                        x, y, z = poses[k, 0, i], poses[k, 1, i], poses[k, 2, i]
                        QR[0, i] = Q[0, 0] * x + Q[0, 2] * z
                        QR[1, i] = Q[1, 1] * y + Q[1, 2] * z
                        QR[2, i] = Q[2, 0] * x + Q[2, 1] * y + Q[2, 2] * z
                        gradients[landmark, i] += x * g[0] + y * g[1] + z * g[2]
                        # The lower half alone, as the columns of QR come one by one.
                        for j in range(i + 1):
                            Hll[landmark, i, j] += x * QR[0, j] + y * QR[1, j] + z * QR[2, j]
                    if free[k] < 0:
                        continue
                    f, row = free[k], 6 * free[k]
                    for i in range(3):
                        n, m = (i + 1) % 3, (i + 2) % 3
                        b0[row + i] += p[n] * g[m] - p[m] * g[n]
                        b0[row + 3 + i] += g[i]
                        for j in range(3):
                            cross[o, i, j] = p[n] * QR[m, j] - p[m] * QR[n, j]
                            cross[o, 3 + i, j] = QR[i, j]
                            moments[i, j] = p[n] * Q[m, j] - p[m] * Q[n, j]
                    for i in range(3):
                        n, m = (i + 1) % 3, (i + 2) % 3
                        for j in range(3):
                            diagonal[f, j, i] += p[n] * moments[j, m] - p[m] * moments[j, n]
                            diagonal[f, i, 3 + j] += moments[i, j]
                            diagonal[f, 3 + i, 3 + j] += Q[i, j]
            for k in range(len(diagonal)):
                for i in range(6):
                    for j in range(6):
                        lower, upper = min(i, j), max(i, j)
                        S0[6 * k + i, 6 * k + j] = diagonal[k, lower, upper]
            add_alignments(poses, free, pairs, T_second_first, information, S0, b0)
            accepted = False
            gain = 0.0
            while not accepted and damping <= damping_max:
                S, b_reduced = S0.copy(), b0.copy()
                for i in range(unknowns):
                    S[i, i] += damping * S0[i, i] + 1e-12
                # What the landmarks take from each pair of keyframes; the upper half alone.
                taken = np.zeros((unknowns // 6, unknowns // 6, 6, 6))
                for landmark in range(landmarks):
                    first, last = starts[landmark], starts[landmark + 1]
                    for i in range(3):
                        for j in range(3):
                            V[i, j] = Hll[landmark, max(i, j), min(i, j)]
                        V[i, i] += damping * V[i, i] + 1e-9
                    _invert(V, inverse)
                    inverses[landmark] = inverse
                    for o in range(first, last):
                        place = free[keyframes[o]]
                        if place < 0 or not inlier[o]:
                            continue
                        for i in range(6):
                            for j in range(3):
                                WH[i, j] = (
                                    cross[o, i, 0] * inverse[0, j]
                                    + cross[o, i, 1] * inverse[1, j]
                                    + cross[o, i, 2] * inverse[2, j]
                                )
                            b_reduced[6 * place + i] -= (
                                WH[i, 0] * gradients[landmark, 0]
                                + WH[i, 1] * gradients[landmark, 1]
                                + WH[i, 2] * gradients[landmark, 2]
                            )
                        for q in range(first, last):
                            other = free[keyframes[q]]
                            if other < place or not inlier[q]:
                                continue
                            for i in range(6):
                                x, y, z = WH[i, 0], WH[i, 1], WH[i, 2]
                                for j in range(6):
                                    taken[place, other, i, j] += (
                                        x * cross[q, j, 0] + y * cross[q, j, 1] + z * cross[q, j, 2]
                                    )
                for i in range(unknowns):
                    for j in range(i, unknowns):
                        S[i, j] -= taken[i // 6, j // 6, i % 6, j % 6]
                        S[j, i] = S[i, j]
                step = np.linalg.solve(S, -b_reduced)
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
                        if row < 0 or not inlier[o]:
                            continue
                        for j in range(3):
                            for i in range(6):
                                g[j] += cross[o, i, j] * step[row + i]
                    for i in range(3):
                        for j in range(3):
                            new_points[landmark, i] -= inverses[landmark, i, j] * g[j]
                new_cost = _cost(
                    new_poses, new_points, starts, keyframes, pixels, depths, sigmas, inlier,
                    camera, inverse_depth_sigma, chi2_pixel, chi2_depth,
                )  # fmt: skip
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
        for landmark in range(landmarks):
            for o in range(starts[landmark], starts[landmark + 1]):
                limit = chi2_pixel if np.isnan(depths[o]) else chi2_depth
                inlier[o] = (
                    _residual(
                        poses, keyframes[o], points, landmark, pixels, o, depths[o], sigmas[o],
                        inverse_depth_sigma, camera, r, p,
                    )
                    and r[0] * r[0] + r[1] * r[1] + r[2] * r[2] <= limit
                )  # fmt: skip
    return poses, points, inlier, first_cost, cost


@compiled(nogil=True)
def _invert(V: FloatArray, inverse: FloatArray) -> None:
    """Write the ``inverse`` of a symmetric positive definite matrix, (3, 3), by cofactors."""
    inverse[0, 0] = V[1, 1] * V[2, 2] - V[1, 2] * V[2, 1]
    inverse[0, 1] = V[0, 2] * V[2, 1] - V[0, 1] * V[2, 2]
    inverse[0, 2] = V[0, 1] * V[1, 2] - V[0, 2] * V[1, 1]
    inverse[1, 0] = inverse[0, 1]
    inverse[1, 1] = V[0, 0] * V[2, 2] - V[0, 2] * V[2, 0]
    inverse[1, 2] = V[0, 2] * V[1, 0] - V[0, 0] * V[1, 2]
    inverse[2, 0] = inverse[0, 2]
    inverse[2, 1] = inverse[1, 2]
    inverse[2, 2] = V[0, 0] * V[1, 1] - V[0, 1] * V[1, 0]
    determinant = V[0, 0] * inverse[0, 0] + V[0, 1] * inverse[1, 0] + V[0, 2] * inverse[2, 0]
    for i in range(3):
        for j in range(3):
            inverse[i, j] /= determinant
