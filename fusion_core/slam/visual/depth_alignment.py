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
    of the images agrees."""
    points = source.points_m.reshape(-1, 3)
    normals = source.normals.reshape(-1, 3)
    known = np.isfinite(normals[:, 0])
    points, normals = points[known], normals[known]
    T = np.array(T_target_source, np.float64)
    information, count = np.zeros((6, 6)), 0
    for iterations, gate in zip(_ITERATIONS, _GATES, strict=True):
        T, information, squares, count = _align(
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
        )
    if count < max(overlap_min * len(points), 6):
        return None
    # Errors above what the noise says make the result as much less certain.
    return T, information / max(1.0, squares / count)


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
) -> tuple[FloatArray, FloatArray, float, int]:
    height, width = target_points.shape[0], target_points.shape[1]
    H = np.zeros((6, 6))
    g, J, p = np.zeros(6), np.zeros(6), np.zeros(3)
    squares, count = 0.0, 0
    for _ in range(iterations):
        H[:] = 0.0
        g[:] = 0.0
        squares, count = 0.0, 0
        for k in range(len(points)):
            row, column = find_block(points[k], T, camera, height, width, p)
            if row < 0:
                continue
            n, q = target_normals[row, column], target_points[row, column]
            if np.isnan(n[0]):
                continue
            off, cosine = 0.0, 0.0
            for i in range(3):
                off += n[i] * (p[i] - q[i])
                turned = 0.0
                for j in range(3):
                    turned += T[i, j] * normals[k, j]
                cosine += n[i] * turned
            if cosine < cosine_min:
                continue
            # A depth z errs along its ray by sigma z^2, and the plane's distance by its part of it.
            slope = (n[0] * p[0] + n[1] * p[1] + n[2] * p[2]) / p[2]
            z, zq = points[k, 2], q[2]
            sigma = sigma_per_m2 * abs(slope) * np.sqrt(z**4 + zq**4) + 1e-9
            off /= sigma
            if abs(off) > gate:
                continue
            J[0] = (p[1] * n[2] - p[2] * n[1]) / sigma
            J[1] = (p[2] * n[0] - p[0] * n[2]) / sigma
            J[2] = (p[0] * n[1] - p[1] * n[0]) / sigma
            for i in range(3):
                J[3 + i] = n[i] / sigma
            squares += off * off
            count += 1
            for i in range(6):
                g[i] += J[i] * off
                for j in range(i, 6):
                    H[i, j] += J[i] * J[j]
        for i in range(6):
            for j in range(i):
                H[i, j] = H[j, i]
        if count < 6:
            break
        damped = H.copy()
        for i in range(6):
            damped[i, i] += 1e-6 * H[i, i] + 1e-9
        step = np.linalg.solve(damped, -g)
        T = multiply_transforms(exp_se3(step), T)
        orthonormalise(T)
        if np.abs(step).max() < step_min:
            break
    return T, H, squares, count
