"""The pose that projects points to their pixels with the least error: robust least squares on
SE(3)."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from fusion_core.calibration.pose_error import apply_pose_error
from fusion_core.lens.projection import project_points
from fusion_core.lens.undistortion import pixel_rays
from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.geometry import make_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics

# Residual of a point that is behind the camera or beyond the lens, in px: far, and finite.
_LOST_PX = 1e4
# Steps of the numeric derivative: rad and m.
_STEP = np.array([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseFit:
    """``T_camera_lidar`` (4, 4), ``jacobian`` (N, 2, 6) of the projected pixels by POSE_PARAMETERS,
    ``residuals_px`` (N, 2) projected minus seen (18).

    ``T_projection``: (4, 4) what points are reprojected by. It is the pose, except after DLT, whose
    (8) is K⁻¹ M: affine, with a freedom more than a pose for each error of the pairs.
    """

    T_camera_lidar: FloatArray
    T_projection: FloatArray
    jacobian: FloatArray
    residuals_px: FloatArray

    def __post_init__(self) -> None:
        for array in (self.T_camera_lidar, self.T_projection, self.jacobian, self.residuals_px):
            read_only(array)


def reprojection_residuals(
    T_camera_lidar: FloatArray,
    points_m: FloatArray,
    pixels: FloatArray,
    intrinsics: CameraIntrinsics,
) -> FloatArray:
    """(N, 2) projected minus seen, (8); a point that the camera cannot see is far away."""
    projected = project_points(transform_points(T_camera_lidar, points_m), intrinsics)
    return np.nan_to_num(projected - pixels, nan=_LOST_PX)


def pose_without_start(
    points_m: FloatArray, pixels: FloatArray, intrinsics: CameraIntrinsics
) -> FloatArray:
    """(4, 4) T_camera_lidar of (N, 3) points and (N, 2) pixels, N >= 4, by SQPnP (Terzakis and
    Lourakis 2020); the points may lie in one plane."""
    rays = pixel_rays(pixels, intrinsics)
    known = np.isfinite(rays).all(axis=1)
    _, rotation, translation = cv2.solvePnP(
        np.ascontiguousarray(points_m[known]),
        np.ascontiguousarray(rays[known, :2]),
        np.eye(3),
        None,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    matrix, _ = cv2.Rodrigues(rotation)
    place_m = np.asarray(translation, np.float64).reshape(3)
    return make_transform(np.asarray(matrix, np.float64), place_m)


def fit_pose(
    points_m: FloatArray,
    pixels: FloatArray,
    intrinsics: CameraIntrinsics,
    T_start: FloatArray,
    *,
    scale_px: float | None,
) -> PoseFit:
    """The pose nearest to ``T_start`` that fits (N, 3) points to (N, 2) pixels.

    ``scale_px``: residual at which a pair begins to lose weight (Cauchy); None: least squares.
    """

    def residuals(error: FloatArray) -> FloatArray:
        T = apply_pose_error(T_start, error)
        return reprojection_residuals(T, points_m, pixels, intrinsics).ravel()

    if scale_px is None:
        solved = least_squares(residuals, np.zeros(6), method="trf", x_scale="jac")
    else:
        solved = least_squares(
            residuals, np.zeros(6), method="trf", x_scale="jac", loss="cauchy", f_scale=scale_px
        )
    T = apply_pose_error(T_start, solved.x)
    return PoseFit(
        T_camera_lidar=T,
        T_projection=T,
        jacobian=pose_jacobian(T, points_m, pixels, intrinsics),
        residuals_px=reprojection_residuals(T, points_m, pixels, intrinsics),
    )


def pose_jacobian(
    T_camera_lidar: FloatArray,
    points_m: FloatArray,
    pixels: FloatArray,
    intrinsics: CameraIntrinsics,
) -> FloatArray:
    """(N, 2, 6) derivatives of the projected pixels by the pose's error, by central differences."""
    columns = []
    for k in range(6):
        step = np.zeros(6)
        step[k] = _STEP[k]
        ahead, behind = (
            reprojection_residuals(
                apply_pose_error(T_camera_lidar, sign * step), points_m, pixels, intrinsics
            )
            for sign in (1.0, -1.0)
        )
        columns.append((ahead - behind) / (2.0 * _STEP[k]))
    return np.stack(columns, axis=-1)
