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

# How many standard deviations a pair may be off: wide for the start's error first. Each gate's
# iterations, at most, end with a step below so many of the pose's own standard deviations. What the
# first leaves is the second's to correct, and so it takes every fourth block alone.
_GATES = (10.0, 3.0)
_STEPS_MIN = (1.0, 0.1)
_STRIDES = (4, 1)
_ITERATIONS = 6
# Surfaces that face away from each other by more are not one.
_NORMAL_COSINE_MIN = 0.8


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
    points, normals = source.points_m.reshape(-1, 3), source.normals.reshape(-1, 3)
    known = np.count_nonzero(np.isfinite(normals[:, 0]))
    T = np.array(T_target_source, np.float64)
    H, H_unbiased, squares, count = np.empty((6, 6)), np.empty((6, 6)), 0.0, 0
    for gate, step_min, stride in zip(_GATES, _STEPS_MIN, _STRIDES, strict=True):
        # From the start on: images of different places can be slid onto each other in the end.
        count_min = max(overlap_min * known / stride, 6.0)
        T, H, H_unbiased, squares, count = _align(
            points[::stride],
            normals[::stride],
            target.points_m,
            target.normals,
            target.camera,
            T,
            depth_sigma_per_m2,
            gate,
            _NORMAL_COSINE_MIN,
            _ITERATIONS,
            step_min,
            count_min,
        )
        if count < count_min:
            return None
    information = H_unbiased @ np.linalg.solve(_damped(H), H_unbiased)
    # Errors above what the noise says make the result as much less certain.
    return T, 0.5 * (information + information.T) / max(1.0, squares / count)


# By numpy's rules no division is checked for a zero, which costs a sixth of the time.
@compiled(nogil=True, error_model="numpy")
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
) -> tuple[FloatArray, FloatArray, FloatArray, float, int]:
    """T, and of its P pairs: the normal equations' matrix, (6, 6), by the target's normals alone
    and by theirs with the source's own, the sum of their squared, normalised errors, and P."""
    height, width = target_points.shape[0], target_points.shape[1]
    # The target's points and normals: q and n of its block b.
    q, n = target_points.reshape(-1, 3), target_normals.reshape(-1, 3)
    size = len(points)
    # Of each pair: the source's block and the target's, the distance, and its variance by either.
    source, block = np.empty(size, np.int64), np.empty(size, np.int64)
    off, own, shared = np.empty(size), np.empty(size), np.empty(size)
    p, m, g, J, J_own = np.zeros(3), np.zeros((1, 3)), np.zeros(6), np.zeros(6), np.zeros(6)
    H, H_unbiased = np.zeros((6, 6)), np.zeros((6, 6))
    squares, count = 0.0, 0
    for iteration in range(iterations):
        squares, count = 0.0, 0
        sharing = np.zeros(height * width)
        for k in range(size):
            if np.isnan(normals[k, 0]):
                continue
            row, column = find_block(points, k, T, camera, height, width, p)
            b = row * width + column
            if row < 0 or np.isnan(n[b, 0]):
                continue
            distance, slope, cosine = 0.0, 0.0, 0.0
            for i in range(3):
                distance += n[b, i] * (p[i] - q[b, i])
                slope += n[b, i] * p[i]
                for j in range(3):
                    cosine += n[b, i] * T[i, j] * normals[k, j]
            if cosine < cosine_min:
                continue
            # A depth z errs along its ray by sigma z^2, and the plane's distance by its part of it.
            unit = (sigma_per_m2 * slope / p[2]) ** 2 + 1e-18
            own[count], shared[count] = unit * points[k, 2] ** 4, unit * q[b, 2] ** 4
            chi2 = distance * distance / (own[count] + shared[count])
            if chi2 > gate * gate:
                continue
            source[count], block[count], off[count] = k, b, distance
            sharing[b] += 1.0
            squares += chi2
            count += 1
        if count < count_min:
            break
        g[:], H[:] = 0.0, 0.0
        for k in range(count):
            # Points in one block share its error: c of them weigh as much as their mean does, whose
            # variance is that of a point over c beside that of the block.
            scale = 1.0 / np.sqrt(own[k] + sharing[block[k]] * shared[k])
            _derivatives(T, points, source[k], n, block[k], scale, J)
            for i in range(6):
                g[i] += J[i] * (off[k] * scale)
                for j in range(i, 6):
                    H[i, j] += J[i] * J[j]
        _mirror(H)
        step = np.linalg.solve(_damped(H), -g)
        # By H step = -g it is the squared length of the step in standard deviations.
        is_last = -np.dot(g, step) < step_min**2 or iteration == iterations - 1
        if is_last:
            H_unbiased[:] = 0.0
            for k in range(count):
                scale = 1.0 / np.sqrt(own[k] + sharing[block[k]] * shared[k])
                for i in range(3):
                    m[0, i] = 0.0
                    for j in range(3):
                        m[0, i] += T[i, j] * normals[source[k], j]
                _derivatives(T, points, source[k], n, block[k], scale, J)
                _derivatives(T, points, source[k], m, 0, scale, J_own)
                for i in range(6):
                    for j in range(i, 6):
                        H_unbiased[i, j] += 0.5 * (J[i] * J_own[j] + J_own[i] * J[j])
            _mirror(H_unbiased)
        T = multiply_transforms(exp_se3(step), T)
        orthonormalise(T)
        if is_last:
            break
    return T, H, H_unbiased, squares, count


@compiled(nogil=True)
def _derivatives(
    T: FloatArray,
    points: FloatArray,
    k: int,
    normals: FloatArray,
    b: int,
    scale: float,
    row: FloatArray,
) -> None:
    """Write into ``row``, (6,), how the scaled distance of point ``k``, moved by ``T``, from a
    plane with normal ``b`` changes by a motion from the left."""
    for i in range(3):
        row[i] = T[i, 0] * points[k, 0] + T[i, 1] * points[k, 1] + T[i, 2] * points[k, 2] + T[i, 3]
    x, y, z = row[0], row[1], row[2]
    row[3], row[4], row[5] = scale * normals[b, 0], scale * normals[b, 1], scale * normals[b, 2]
    row[0], row[1], row[2] = (
        y * row[5] - z * row[4],
        z * row[3] - x * row[5],
        x * row[4] - y * row[3],
    )


@compiled(nogil=True)
def _mirror(H: FloatArray) -> None:
    """Complete a symmetric matrix, (6, 6), of which the upper half is known."""
    for i in range(6):
        for j in range(i):
            H[i, j] = H[j, i]


@compiled(nogil=True)
def _damped(H: FloatArray) -> FloatArray:
    damped = H.copy()
    for i in range(6):
        damped[i, i] += 1e-6 * H[i, i] + 1e-9
    return damped
