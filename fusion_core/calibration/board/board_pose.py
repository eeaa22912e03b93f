"""A plane of known points in an image: its pose in the camera's frame, with its covariance."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.calibration.board.pose_minimiser import minimise_pose
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.lens.projection import project_with_jacobian
from fusion_core.lens.undistortion import undistort_pixels
from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import make_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanePose:
    """``T_camera_plane``: (4, 4). ``covariance``: (6, 6) of POSE_PARAMETERS for corners of 1 px
    standard deviation. ``residuals_px``: (N, 2) measured - projected."""

    T_camera_plane: FloatArray
    covariance: FloatArray
    residuals_px: FloatArray

    @property
    def rms_px(self) -> float:
        """Root mean square of the distances, Song's (18)."""
        return reprojection_rms(self.residuals_px)

    def errors_px(
        self, points_m: FloatArray, pixels: FloatArray, intrinsics: CameraIntrinsics
    ) -> FloatArray:
        """(N, 2) measured - projected of other points of the plane."""
        seen = transform_points(self.T_camera_plane, points_m)
        return pixels - project_with_jacobian(seen, intrinsics)[0]


def fit_plane_pose(
    points_m: FloatArray, pixels: FloatArray, intrinsics: CameraIntrinsics
) -> PlanePose | None:
    """The best of ``fit_plane_poses``; None where there is none."""
    return min(
        fit_plane_poses(points_m, pixels, intrinsics), key=lambda fit: fit.rms_px, default=None
    )


def fit_plane_poses(
    points_m: FloatArray, pixels: FloatArray, intrinsics: CameraIntrinsics
) -> list[PlanePose]:
    """Poses of points with z = 0, (N, 3), seen at (N, 2) pixels: none, one or two.

    Both poses of a plane that explain the same homography (Collins and Bartoli 2014) are refined
    by Levenberg-Marquardt.
    """
    rays = undistort_pixels(pixels, intrinsics)
    if points_m.shape[0] < 4 or not np.isfinite(rays).all():
        return []
    try:
        count, rotations, translations, _ = cv2.solvePnPGeneric(
            points_m, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        return []
    fits = [
        _refine(_transform(r, t), points_m, pixels, intrinsics)
        for r, t in zip(rotations[:count], translations[:count], strict=True)
        if np.isfinite(r).all() and np.isfinite(t).all()
    ]
    return [fit for fit in fits if fit is not None]


def pose_jacobian(T_camera_b: FloatArray, points_in_camera_m: FloatArray) -> FloatArray:
    """(N, 3, 6) derivatives of points R p + t by an error of the pose (POSE_PARAMETERS)."""
    turned = points_in_camera_m - T_camera_b[:3, 3]
    jacobian = np.zeros((turned.shape[0], 3, 6))
    # d(Exp(w) R p)/dw = -[R p]x
    jacobian[:, 0, 1], jacobian[:, 0, 2] = turned[:, 2], -turned[:, 1]
    jacobian[:, 1, 0], jacobian[:, 1, 2] = -turned[:, 2], turned[:, 0]
    jacobian[:, 2, 0], jacobian[:, 2, 1] = turned[:, 1], -turned[:, 0]
    jacobian[:, :, 3:] = np.eye(3)
    return jacobian


def _transform(
    rotation_vector: cv2.typing.MatLike, translation_m: cv2.typing.MatLike
) -> FloatArray:
    rotation, _ = cv2.Rodrigues(rotation_vector)
    return make_transform(
        np.asarray(rotation, np.float64), np.asarray(translation_m, np.float64).ravel()
    )


def _refine(
    T_start: FloatArray, points_m: FloatArray, pixels: FloatArray, intrinsics: CameraIntrinsics
) -> PlanePose | None:
    def evaluate(T: FloatArray) -> tuple[FloatArray, FloatArray]:
        seen = transform_points(T, points_m)
        projected, by_point = project_with_jacobian(seen, intrinsics)
        return (projected - pixels).ravel(), (by_point @ pose_jacobian(T, seen)).reshape(-1, 6)

    T = minimise_pose(evaluate, T_start, T_start, np.ones(6, dtype=np.bool_))
    seen = transform_points(T, points_m)
    if (seen[:, 2] <= 0.0).any():
        return None
    projected, by_point = project_with_jacobian(seen, intrinsics)
    J = np.einsum("nij,njk->nik", by_point, pose_jacobian(T, seen)).reshape(-1, 6)
    information = J.T @ J
    if np.linalg.cond(information) > 1e14:
        return None
    return PlanePose(
        T_camera_plane=T,
        covariance=np.linalg.inv(information),
        residuals_px=pixels - projected,
    )
