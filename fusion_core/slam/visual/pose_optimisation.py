"""The pose of one image by the landmarks that it sees: Gauss-Newton on SE(3).

ORB-SLAM2 (Mur-Artal & Tardos 2017), §III-B, motion-only bundle adjustment: a robust sum over the
errors of u, v and inverse depth. A small motion xi = (omega, v) acts from the left:
T_camera_map <- exp(xi) T_camera_map.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import BoolArray, FloatArray, read_only
from fusion_core.slam.visual.observation_noise import CHI2_DEPTH, CHI2_PIXEL

# Outliers are told apart after each round and may come back, as in ORB-SLAM2.
_ROUNDS = 4
_ITERATIONS = 10
# A step below a hundredth of a millimetre and of a milliradian changes nothing.
_STEP_MIN = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseFit:
    """``T_camera_map``: (4, 4). ``is_inlier``: (N,). ``information``: (6, 6) of a small motion from
    the left, rotation first, by the inliers."""

    T_camera_map: FloatArray
    is_inlier: BoolArray
    information: FloatArray

    def __post_init__(self) -> None:
        for array in (self.T_camera_map, self.is_inlier, self.information):
            read_only(array)


def optimise_pose(
    T_camera_map: FloatArray,
    points_in_map_m: FloatArray,
    pixels: FloatArray,
    depths_m: FloatArray,
    pixel_sigmas: FloatArray,
    depth_sigma_per_m2: float,
    camera: FloatArray,
) -> PoseFit:
    """Fit the pose to N observations, from a start.

    ``points_in_map_m``: (N, 3). ``pixels``: (N, 2). ``depths_m``: (N,), NaN where missing.
    ``pixel_sigmas``: (N,). ``camera``: (4,) fx, fy, cx, cy. Fewer than three inliers leave the
    start as it is.
    """
    T, inliers, information = _optimise(
        # Copied: for arrays that are read-only it would be compiled once more.
        np.array(T_camera_map, np.float64, order="C"),
        np.array(points_in_map_m, np.float64, order="C"),
        np.ascontiguousarray(pixels, np.float64),
        np.ascontiguousarray(depths_m, np.float64),
        np.ascontiguousarray(pixel_sigmas, np.float64),
        depth_sigma_per_m2,
        camera,
        _ROUNDS,
        _ITERATIONS,
        _STEP_MIN,
        CHI2_PIXEL,
        CHI2_DEPTH,
    )
    return PoseFit(T_camera_map=T, is_inlier=inliers, information=information)


@compiled(nogil=True)
def exp_se3(xi: FloatArray) -> FloatArray:
    """(4, 4) of a small motion (6,), rotation first (Barfoot 2017, eqs. 7.85, 7.86)."""
    wx, wy, wz = xi[0], xi[1], xi[2]
    angle2 = wx * wx + wy * wy + wz * wz
    if angle2 < 1e-10:
        a, b, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        angle = np.sqrt(angle2)
        a = np.sin(angle) / angle
        b = (1.0 - np.cos(angle)) / angle2
        c = (1.0 - a) / angle2
    W = np.zeros((3, 3))
    W[0, 1], W[0, 2], W[1, 2] = -wz, wy, -wx
    W[1, 0], W[2, 0], W[2, 1] = wz, -wy, wx
    WW = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                WW[i, j] += W[i, k] * W[k, j]
    T = np.eye(4)
    for i in range(3):
        for j in range(3):
            one = 1.0 if i == j else 0.0
            T[i, j] = one + a * W[i, j] + b * WW[i, j]
            T[i, 3] += (one + b * W[i, j] + c * WW[i, j]) * xi[3 + j]
    return T


@compiled(nogil=True)
def multiply_transforms(A: FloatArray, B: FloatArray) -> FloatArray:
    """(4, 4) A B of rigid motions."""
    C = np.eye(4)
    for i in range(3):
        for j in range(4):
            total = A[i, 3] if j == 3 else 0.0
            for k in range(3):
                total += A[i, k] * B[k, j]
            C[i, j] = total
    return C


@compiled(nogil=True)
def orthonormalise(T: FloatArray) -> None:
    """Make the rotation of T (4, 4) one again, in place: products of many lose it by rounding, and
    the velocity that is taken from pose to pose lets such an error grow."""
    for row in range(2):
        for before in range(row):
            dot = T[row, 0] * T[before, 0] + T[row, 1] * T[before, 1] + T[row, 2] * T[before, 2]
            for j in range(3):
                T[row, j] -= dot * T[before, j]
        norm = np.sqrt(T[row, 0] ** 2 + T[row, 1] ** 2 + T[row, 2] ** 2)
        for j in range(3):
            T[row, j] /= norm
    T[2, 0] = T[0, 1] * T[1, 2] - T[0, 2] * T[1, 1]
    T[2, 1] = T[0, 2] * T[1, 0] - T[0, 0] * T[1, 2]
    T[2, 2] = T[0, 0] * T[1, 1] - T[0, 1] * T[1, 0]


@compiled(nogil=True)
def _optimise(
    T_start: FloatArray,
    points: FloatArray,
    pixels: FloatArray,
    depths: FloatArray,
    sigmas: FloatArray,
    inverse_depth_sigma: float,
    camera: FloatArray,
    rounds: int,
    iterations: int,
    step_min: float,
    chi2_pixel: float,
    chi2_depth: float,
) -> tuple[FloatArray, BoolArray, FloatArray]:
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    count = len(points)
    T = T_start.copy()
    inlier = np.ones(count, np.bool_)
    H = np.zeros((6, 6))
    g = np.zeros(6)
    J = np.zeros((3, 6))
    for round_ in range(rounds):
        robust = round_ < rounds - 1
        for _ in range(iterations):
            H[:] = 0.0
            g[:] = 0.0
            used = 0
            for i in range(count):
                if not inlier[i]:
                    continue
                x = T[0, 0] * points[i, 0] + T[0, 1] * points[i, 1] + T[0, 2] * points[i, 2]
                y = T[1, 0] * points[i, 0] + T[1, 1] * points[i, 1] + T[1, 2] * points[i, 2]
                z = T[2, 0] * points[i, 0] + T[2, 1] * points[i, 1] + T[2, 2] * points[i, 2]
                x, y, z = x + T[0, 3], y + T[1, 3], z + T[2, 3]
                if z < 0.01:
                    continue
                used += 1
                iz = 1.0 / z
                rows = 2 if np.isnan(depths[i]) else 3
                w = 1.0 / sigmas[i]
                ru = (fx * x * iz + cx - pixels[i, 0]) * w
                rv = (fy * y * iz + cy - pixels[i, 1]) * w
                rd = 0.0
                # d(x, y, z) / d(omega, v) = [-[p]x, I].
                a, b, c = fx * iz * w, -fx * x * iz * iz * w, fy * iz * w
                d = -fy * y * iz * iz * w
                J[0, 0], J[0, 1], J[0, 2] = b * y, a * z - b * x, -a * y
                J[0, 3], J[0, 4], J[0, 5] = a, 0.0, b
                J[1, 0], J[1, 1], J[1, 2] = -c * z + d * y, -d * x, c * x
                J[1, 3], J[1, 4], J[1, 5] = 0.0, c, d
                if rows == 3:
                    e = -iz * iz / inverse_depth_sigma
                    rd = (iz - 1.0 / depths[i]) / inverse_depth_sigma
                    J[2, 0], J[2, 1], J[2, 2] = e * y, -e * x, 0.0
                    J[2, 3], J[2, 4], J[2, 5] = 0.0, 0.0, e
                chi2 = ru * ru + rv * rv + rd * rd
                weight = 1.0
                limit = chi2_depth if rows == 3 else chi2_pixel
                if robust and chi2 > limit:
                    # Huber.
                    weight = np.sqrt(limit / chi2)
                for r in range(rows):
                    residual = ru if r == 0 else (rv if r == 1 else rd)
                    for j in range(6):
                        wj = weight * J[r, j]
                        g[j] += wj * residual
                        for k in range(j, 6):
                            H[j, k] += wj * J[r, k]
            for j in range(6):
                for k in range(j):
                    H[j, k] = H[k, j]
            if used < 3:
                return T_start, inlier, H
            damped = H.copy()
            for j in range(6):
                damped[j, j] += 1e-9 * H[j, j] + 1e-9
            step = np.linalg.solve(damped, -g)
            T = multiply_transforms(exp_se3(step), T)
            orthonormalise(T)
            if np.abs(step).max() < step_min:
                break
        kept = 0
        for i in range(count):
            x = T[0, 0] * points[i, 0] + T[0, 1] * points[i, 1] + T[0, 2] * points[i, 2] + T[0, 3]
            y = T[1, 0] * points[i, 0] + T[1, 1] * points[i, 1] + T[1, 2] * points[i, 2] + T[1, 3]
            z = T[2, 0] * points[i, 0] + T[2, 1] * points[i, 1] + T[2, 2] * points[i, 2] + T[2, 3]
            if z < 0.01:
                inlier[i] = False
                continue
            ru = (fx * x / z + cx - pixels[i, 0]) / sigmas[i]
            rv = (fy * y / z + cy - pixels[i, 1]) / sigmas[i]
            chi2, limit = ru * ru + rv * rv, chi2_pixel
            if not np.isnan(depths[i]):
                rd = (1.0 / z - 1.0 / depths[i]) / inverse_depth_sigma
                chi2, limit = chi2 + rd * rd, chi2_depth
            inlier[i] = chi2 <= limit
            kept += inlier[i]
        if kept < 3:
            return T_start, inlier, H
    return T, inlier, H
