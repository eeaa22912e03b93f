"""The observations of a bundle adjustment: their errors, and their normal equations.

A small motion acts on T_camera_map from the left. What is called for each observation is given
arrays and the numbers of rows: to make a view of a row, or to take an array out of a tuple, takes
as long as its use.
"""

from typing import NamedTuple

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.slam.visual.observation_noise import CHI2_DEPTH, CHI2_PIXEL


class OrderedObservations(NamedTuple):
    """O observations as compiled functions take them, ordered by landmark: those of landmark l go
    from ``starts[l]`` up to, and without, ``starts[l + 1]``.

    ``starts``: (L + 1,). Of each observation: ``keyframes``: (O,) rows of the poses; ``pixels``:
    (O, 2); ``depths_m``: (O,), NaN where missing; ``pixel_sigmas``: (O,); ``is_inlier``: (O,), the
    one that is written. ``camera``: (4,) fx, fy, cx, cy. ``depth_sigma_per_m2``: see
    ``ObservationNoise``.
    """

    starts: IntArray
    keyframes: IntArray
    pixels: FloatArray
    depths_m: FloatArray
    pixel_sigmas: FloatArray
    is_inlier: BoolArray
    camera: FloatArray
    depth_sigma_per_m2: float


@compiled(nogil=True)
def _chi2_limit(depth_m: float) -> float:
    """Of an inlier's squared, normalised error, with a depth or without (NaN)."""
    return CHI2_PIXEL if np.isnan(depth_m) else CHI2_DEPTH


@compiled(nogil=True)
def _residual(
    poses: FloatArray,
    k: int,
    points: FloatArray,
    landmark: int,
    pixels: FloatArray,
    o: int,
    depth_m: float,
    sigma: float,
    depth_sigma_per_m2: float,
    camera: FloatArray,
    r: FloatArray,
    p: FloatArray,
) -> bool:
    """Normalised errors of observation ``o``, of a ``landmark`` by keyframe ``k``, into ``r`` (3,),
    the point before the camera into ``p`` (3,); whether it lies before it."""
    x, y, z = points[landmark, 0], points[landmark, 1], points[landmark, 2]
    for i in range(3):
        p[i] = poses[k, i, 0] * x + poses[k, i, 1] * y + poses[k, i, 2] * z + poses[k, i, 3]
    if p[2] < 0.01:
        return False
    r[0] = (camera[0] * p[0] / p[2] + camera[2] - pixels[o, 0]) / sigma
    r[1] = (camera[1] * p[1] / p[2] + camera[3] - pixels[o, 1]) / sigma
    r[2] = 0.0 if np.isnan(depth_m) else (1.0 / p[2] - 1.0 / depth_m) / depth_sigma_per_m2
    return True


@compiled(nogil=True)
def robust_cost(poses: FloatArray, points: FloatArray, seen: OrderedObservations) -> float:
    """Half the robust sum of the observations that are no outliers (Huber)."""
    starts, keyframes, pixels, depths_m, sigmas, is_inlier, camera, depth_sigma_per_m2 = seen
    r, p = np.zeros(3), np.zeros(3)
    total = 0.0
    for landmark in range(len(points)):
        for o in range(starts[landmark], starts[landmark + 1]):
            if not is_inlier[o]:
                continue
            limit = _chi2_limit(depths_m[o])
            if not _residual(
                poses, keyframes[o], points, landmark, pixels, o, depths_m[o], sigmas[o],
                depth_sigma_per_m2, camera, r, p,
            ):  # fmt: skip
                # As bad as a gross outlier, so that a step that throws points behind is refused.
                total += 100.0 * limit
                continue
            chi2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
            total += 0.5 * chi2 if chi2 <= limit else np.sqrt(limit * chi2) - 0.5 * limit
    return total


@compiled(nogil=True)
def tell_outliers(poses: FloatArray, points: FloatArray, seen: OrderedObservations) -> None:
    """Write ``is_inlier`` of all observations, former outliers among them."""
    starts, keyframes, pixels, depths_m, sigmas, is_inlier, camera, depth_sigma_per_m2 = seen
    r, p = np.zeros(3), np.zeros(3)
    for landmark in range(len(points)):
        for o in range(starts[landmark], starts[landmark + 1]):
            is_before = _residual(
                poses, keyframes[o], points, landmark, pixels, o, depths_m[o], sigmas[o],
                depth_sigma_per_m2, camera, r, p,
            )  # fmt: skip
            chi2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
            is_inlier[o] = is_before and chi2 <= _chi2_limit(depths_m[o])


@compiled(nogil=True)
def add_observations(
    poses: FloatArray,
    free: IntArray,
    points: FloatArray,
    seen: OrderedObservations,
    S: FloatArray,
    b: FloatArray,
    cross: FloatArray,
    Hll: FloatArray,
    gradients: FloatArray,
) -> None:
    """Add the observations to the normal equations of the F poses that move, ``S`` (6 F, 6 F) and
    ``b`` (6 F,), and write those of the L landmarks: ``Hll`` (L, 3, 3), the lower half alone, and
    ``gradients`` (L, 3). ``cross`` (O, 6, 3) joins each observation's keyframe and landmark.

    ``free``: (K,) the number of each keyframe among those that move, -1 for a fixed one.
    """
    starts, keyframes, pixels, depths_m, sigmas, is_inlier, camera, depth_sigma_per_m2 = seen
    fx, fy = camera[0], camera[1]
    r, p, g = np.zeros(3), np.zeros(3), np.zeros(3)
    Q, QR, moments = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
    Hll[:], gradients[:], cross[:] = 0.0, 0.0, 0.0
    # The upper half of the blocks on the diagonal of S.
    diagonal = np.zeros((len(b) // 6, 6, 6))
    for landmark in range(len(points)):
        for o in range(starts[landmark], starts[landmark + 1]):
            k = keyframes[o]
            if not is_inlier[o] or not _residual(
                poses, k, points, landmark, pixels, o, depths_m[o], sigmas[o],
                depth_sigma_per_m2, camera, r, p,
            ):  # fmt: skip
                continue
            has_depth = not np.isnan(depths_m[o])
            chi2 = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
            limit = _chi2_limit(depths_m[o])
            weight = 1.0 if chi2 <= limit else np.sqrt(limit / chi2)
            # By a motion of p, the point before the camera, r changes by A, whose other entries are
            # 0. By one of the landmark p moves by R, by one of the camera by [-p x, I]: all blocks
            # are products of these with Q = A' A.
            iz, w = 1.0 / p[2], 1.0 / sigmas[o]
            A00, A02 = fx * iz * w, -fx * p[0] * iz * iz * w
            A11, A12 = fy * iz * w, -fy * p[1] * iz * iz * w
            A22 = -iz * iz / depth_sigma_per_m2 if has_depth else 0.0
            Q[0, 0], Q[1, 1] = weight * A00 * A00, weight * A11 * A11
            Q[2, 2] = weight * (A02 * A02 + A12 * A12 + A22 * A22)
            Q[0, 2] = Q[2, 0] = weight * A00 * A02
            Q[1, 2] = Q[2, 1] = weight * A11 * A12
            g[0], g[1] = weight * A00 * r[0], weight * A11 * r[1]
            g[2] = weight * (A02 * r[0] + A12 * r[1] + A22 * r[2])
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
                b[row + i] += p[n] * g[m] - p[m] * g[n]
                b[row + 3 + i] += g[i]
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
                S[6 * k + i, 6 * k + j] += diagonal[k, lower, upper]


@compiled(nogil=True)
def eliminate_landmarks(
    free: IntArray,
    seen: OrderedObservations,
    cross: FloatArray,
    Hll: FloatArray,
    gradients: FloatArray,
    damping: float,
    S: FloatArray,
    b: FloatArray,
    inverses: FloatArray,
) -> None:
    """The Schur complement: take the landmarks, damped, out of ``S`` and ``b`` as
    ``add_observations`` has made them. ``inverses``, (L, 3, 3), become those of their blocks."""
    starts, keyframes, is_inlier = seen.starts, seen.keyframes, seen.is_inlier
    V, inverse, WH = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((6, 3))
    # What the landmarks take from each pair of keyframes; the upper half alone.
    taken = np.zeros((len(b) // 6, len(b) // 6, 6, 6))
    for landmark in range(len(Hll)):
        first, last = starts[landmark], starts[landmark + 1]
        for i in range(3):
            for j in range(3):
                V[i, j] = Hll[landmark, max(i, j), min(i, j)]
            V[i, i] += damping * V[i, i] + 1e-9
        _invert(V, inverse)
        inverses[landmark] = inverse
        for o in range(first, last):
            place = free[keyframes[o]]
            if place < 0 or not is_inlier[o]:
                continue
            for i in range(6):
                for j in range(3):
                    WH[i, j] = (
                        cross[o, i, 0] * inverse[0, j]
                        + cross[o, i, 1] * inverse[1, j]
                        + cross[o, i, 2] * inverse[2, j]
                    )
                b[6 * place + i] -= (
                    WH[i, 0] * gradients[landmark, 0]
                    + WH[i, 1] * gradients[landmark, 1]
                    + WH[i, 2] * gradients[landmark, 2]
                )
            for q in range(first, last):
                other = free[keyframes[q]]
                if other < place or not is_inlier[q]:
                    continue
                for i in range(6):
                    x, y, z = WH[i, 0], WH[i, 1], WH[i, 2]
                    for j in range(6):
                        taken[place, other, i, j] += (
                            x * cross[q, j, 0] + y * cross[q, j, 1] + z * cross[q, j, 2]
                        )
    for i in range(len(b)):
        for j in range(i, len(b)):
            S[i, j] -= taken[i // 6, j // 6, i % 6, j % 6]
            S[j, i] = S[i, j]


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
