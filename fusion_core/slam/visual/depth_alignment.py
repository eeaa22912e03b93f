"""Two keyframes aligned by their depth images: point to plane, with projective association.

After KinectFusion's tracking (Newcombe et al. 2011, §3.5), between two images and weighted by the
depth's own noise. What comes of it is a relative pose with its information, which adjustments use
beside the features: a thousand corners say little of a wall without texture, and their colour image
may not show exactly what the depth image does.
"""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import FloatArray
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.depth_surface import DepthSurface, find_block
from fusion_core.slam.visual.pose_optimisation import exp_se3, multiply_transforms, orthonormalise

# Iterations, and how many standard deviations a pair may be off: wide for the start's error first.
_ITERATIONS = (6, 6)
_GATES = (10.0, 3.0)
# Surfaces that face away from each other by more are not one.
_NORMAL_COSINE_MIN = 0.8
# A step below a hundredth of a millimetre and of a milliradian changes nothing.
_STEP_MIN = 1e-5


class DepthAlignmentSettings(StageSettings):
    """Settings of dense alignment between keyframes."""

    neighbours_max: int = setting(
        10,
        "Keyframes to which the depth image of a new one is aligned; 0 for none",
        unit="keyframes",
        ge=0,
        le=100,
    )
    overlap_min: float = setting(
        0.25, "Least part of the blocks that must agree with the other image", ge=0.0, le=1.0
    )


def align_depths(
    source: DepthSurface,
    target: DepthSurface,
    T_target_source: FloatArray,
    depth_sigma_per_m2: float,
    overlap_min: float,
) -> tuple[FloatArray, FloatArray] | None:
    """T_target_source, (4, 4), and its information, (6, 6), from a start; None where too little
    of the images agrees.

    Noise of the normals makes the normal equations' matrix H too large: it says something of every
    motion, even of one that the surfaces do not show. Both images' own normals err independently,
    so that products of one with the other do not add their noise (an instrumental variable; Fuller
    1987, §1.4). The gradient at a motion x from the truth is that matrix times x, with an error
    whose covariance is H: the information follows from both.
    """
    points = source.points_m.reshape(-1, 3)
    normals = source.normals.reshape(-1, 3)
    known = np.isfinite(normals[:, 0])
    points, normals = points[known], normals[known]
    # From the start on: images of different places can be slid onto each other in the end.
    count_min = max(overlap_min * len(points), 6.0)
    T, rows, squares = np.array(T_target_source, np.float64), np.empty((0, 6)), 0.0
    own_rows = rows
    for iterations, gate in zip(_ITERATIONS, _GATES, strict=True):
        T, rows, own_rows, squares = _align(
            points,
            normals,
            target.points_m,
            target.normals,
            target.camera,
            T,
            depth_sigma_per_m2,
            gate,
            _NORMAL_COSINE_MIN,
            iterations,
            _STEP_MIN,
            count_min,
        )
        if len(rows) < count_min:
            return None
    H, H_unbiased = _products(rows, rows), _products(rows, own_rows)
    information = H_unbiased @ np.linalg.solve(_damped(H), H_unbiased)
    # Errors above what the noise says make the result as much less certain.
    return T, 0.5 * (information + information.T) / max(1.0, squares / len(rows))


@compiled(nogil=True)
def _align(
    points: FloatArray,
    normals: FloatArray,
    target_points: FloatArray,
    target_normals: FloatArray,
    camera: FloatArray,
    T: FloatArray,
    sigma_per_m2: float,
    gate: float,
    cosine_min: float,
    iterations: int,
    step_min: float,
    count_min: float,
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """T, the (P, 6) derivatives of the P pairs by the target's and by the source's own normals, and
    the sum of the pairs' squared, normalised errors."""
    height, width = target_points.shape[0], target_points.shape[1]
    J, J_own = np.empty((len(points), 6)), np.empty((len(points), 6))
    off = np.empty(len(points))
    variances = np.empty((len(points), 2))
    block = np.empty(len(points), np.int64)
    p, m, g = np.zeros(3), np.zeros(3), np.zeros(6)
    squares, count = 0.0, 0
    for _ in range(iterations):
        squares, count = 0.0, 0
        sharing = np.zeros(height * width)
        for k in range(len(points)):
            row, column = find_block(points[k], T, camera, height, width, p)
            if row < 0:
                continue
            n, q = target_normals[row, column], target_points[row, column]
            if np.isnan(n[0]):
                continue
            distance, cosine = 0.0, 0.0
            for i in range(3):
                distance += n[i] * (p[i] - q[i])
                m[i] = 0.0
                for j in range(3):
                    m[i] += T[i, j] * normals[k, j]
                cosine += n[i] * m[i]
            if cosine < cosine_min:
                continue
            # A depth z errs along its ray by sigma z^2, and the plane's distance by its part of it.
            slope = (n[0] * p[0] + n[1] * p[1] + n[2] * p[2]) / p[2]
            unit = (sigma_per_m2 * slope) ** 2 + 1e-18
            own, shared = unit * points[k, 2] ** 4, unit * q[2] ** 4
            chi2 = distance * distance / (own + shared)
            if chi2 > gate * gate:
                continue
            for i in range(3):
                a, b = (i + 1) % 3, (i + 2) % 3
                J[count, i], J[count, 3 + i] = p[a] * n[b] - p[b] * n[a], n[i]
                J_own[count, i], J_own[count, 3 + i] = p[a] * m[b] - p[b] * m[a], m[i]
            off[count] = distance
            variances[count, 0], variances[count, 1] = own, shared
            block[count] = row * width + column
            sharing[row * width + column] += 1.0
            squares += chi2
            count += 1
        g[:] = 0.0
        for k in range(count):
            # Points in one block share its error: c of them weigh as much as their mean does, whose
            # variance is that of a point over c beside that of the block.
            scale = 1.0 / np.sqrt(variances[k, 0] + sharing[block[k]] * variances[k, 1])
            off[k] *= scale
            for i in range(6):
                J[k, i] *= scale
                J_own[k, i] *= scale
                g[i] += J[k, i] * off[k]
        if count < count_min:
            break
        step = np.linalg.solve(_damped(_products(J[:count], J[:count])), -g)
        T = multiply_transforms(exp_se3(step), T)
        orthonormalise(T)
        if np.abs(step).max() < step_min:
            break
    return T, J[:count], J_own[:count], squares


@compiled(nogil=True)
def _products(first: FloatArray, second: FloatArray) -> FloatArray:
    """(6, 6) sum of the outer products of rows, (P, 6), each product's symmetric part."""
    total = np.zeros((6, 6))
    for k in range(len(first)):
        for i in range(6):
            for j in range(i, 6):
                total[i, j] += 0.5 * (first[k, i] * second[k, j] + second[k, i] * first[k, j])
    for i in range(6):
        for j in range(i):
            total[i, j] = total[j, i]
    return total


@compiled(nogil=True)
def _damped(H: FloatArray) -> FloatArray:
    damped = H.copy()
    for i in range(6):
        damped[i, i] += 1e-6 * H[i, i] + 1e-9
    return damped
