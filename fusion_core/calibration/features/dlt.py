"""The camera's pose by direct linear transformation (Song 2022 §2.2.2, eqs. 13 to 17).

M (3 x 4) of (8) has twelve entries, eleven up to its scale. Each pair gives two equations, (16) and
(17), so six pairs suffice unless their points lie in one plane.
"""

import numpy as np

from fusion_core.lens.undistortion import straight_pixels
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import make_transform
from fusion_core.model.sensors import CameraIntrinsics

DLT_PAIRS_MIN = 6
# Thickness of the points' cloud, of its length. A wall of 3 m seen with ranges ±2 cm has 0.007.
_THICKNESS_MIN = 0.01
# M is found where the eleventh singular value of the equations is not zero like the twelfth.
_RANK_MIN = 1e-7


def require_determined(points_m: FloatArray) -> None:
    """Raise CalibrationFailed for fewer than six (N, 3) points, or points in one plane."""
    if len(points_m) < DLT_PAIRS_MIN:
        raise CalibrationFailed(
            f"{len(points_m)} pairs of a point and a pixel do not determine the pose: at least "
            f"{DLT_PAIRS_MIN} are needed.",
            advice="Use a scene with more texture, a denser cloud, or give --guess.",
        )
    spread = np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False)
    if not spread[2] >= _THICKNESS_MIN * spread[0]:
        shown = ", ".join(f"{value / np.sqrt(len(points_m)):.3g}" for value in spread)
        raise CalibrationFailed(
            f"the {len(points_m)} paired points lie in one plane: their singular values are "
            f"{shown} m.",
            advice="Let both sensors see surfaces at different distances, such as a corner.",
        )


def solve_projection(points_m: FloatArray, pixels: FloatArray) -> FloatArray:
    """(3, 4) M with s (u, v, 1) = M (X, Y, Z, 1) (13)-(15) of (N, 3) points and (N, 2) pixels
    without distortion, by least squares of (16), (17) on normalised coordinates.

    Raises CalibrationFailed for too few points, and for points in one plane.
    """
    require_determined(points_m)
    to_unit, X = _normalised(points_m)
    to_unit_px, x = _normalised(pixels)
    ones, zeros = np.ones((len(X), 1)), np.zeros((len(X), 4))
    homogeneous = np.hstack([X, ones])
    # (16): u (M₃ · P) = M₁ · P and (17): v (M₃ · P) = M₂ · P.
    rows_u = np.hstack([homogeneous, zeros, -x[:, :1] * homogeneous])
    rows_v = np.hstack([zeros, homogeneous, -x[:, 1:] * homogeneous])
    _, singular, vt = np.linalg.svd(np.vstack([rows_u, rows_v]), full_matrices=False)
    if singular[10] <= _RANK_MIN * singular[0]:
        raise CalibrationFailed(
            f"the pairs do not determine the projection matrix: the eleventh of the equations' "
            f"singular values is {singular[10]:.2g}, the first {singular[0]:.2g}.",
            advice="Let both sensors see surfaces at different distances, such as a corner.",
        )
    M = np.linalg.inv(to_unit_px) @ vt[-1].reshape(3, 4) @ to_unit
    # The scale's sign puts the points ahead of the camera.
    ahead = np.median(points_m @ M[2, :3] + M[2, 3])
    scale = (-1.0 if ahead < 0.0 else 1.0) / float(np.linalg.norm(M[2, :3]))
    scaled: FloatArray = M * scale
    return scaled


def pose_from_projection(M: FloatArray, K: FloatArray) -> FloatArray:
    """(4, 4) T_camera_lidar of a (3, 4) M and a known (3, 3) K: [R | T] = K⁻¹ M up to scale, R the
    nearest proper rotation."""
    Rt = np.linalg.solve(K, M)
    u, singular, vt = np.linalg.svd(Rt[:, :3])
    proper = np.diag([1.0, 1.0, np.linalg.det(u @ vt)])
    return make_transform(u @ proper @ vt, Rt[:, 3] / singular.mean())


def solve_pose(
    points_m: FloatArray, pixels: FloatArray, intrinsics: CameraIntrinsics
) -> tuple[FloatArray, FloatArray]:
    """(4, 4) T_camera_lidar of (N, 3) points and (N, 2) pixels of a camera with distortion, and
    (4, 4) with K⁻¹ M in its first three rows, which reprojects the pairs as (8) does."""
    ideal = straight_pixels(pixels, intrinsics)
    known = np.isfinite(ideal).all(axis=1)
    M = solve_projection(points_m[known], ideal[known])
    K = intrinsics.matrix
    return pose_from_projection(M, K), np.vstack([np.linalg.solve(K, M), [0.0, 0.0, 0.0, 1.0]])


def _normalised(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A similarity that moves (N, d) values to mean 0 and mean square 1 on each axis (Hartley
    1997), as a (d + 1, d + 1) matrix, and the values moved."""
    centre = values.mean(axis=0)
    scale = 1.0 / max(float(np.sqrt(((values - centre) ** 2).mean())), 1e-12)
    dimension = values.shape[1]
    matrix = np.eye(dimension + 1)
    matrix[:dimension, :dimension] *= scale
    matrix[:dimension, dimension] = -scale * centre
    return matrix, scale * (values - centre)
