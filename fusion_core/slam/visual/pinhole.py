"""The camera of visual SLAM: a camera matrix alone, distortion being taken off its features."""

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.sensors import CameraIntrinsics

# What is nearer is not in front of the camera.
_DEPTH_MIN_M = 1e-2


def camera_parameters(intrinsics: CameraIntrinsics) -> FloatArray:
    """(4,) fx, fy, cx, cy."""
    return np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy], np.float64)


def unproject(pixels: FloatArray, depths_m: FloatArray, camera: FloatArray) -> FloatArray:
    """(N, 3) in the optical frame of (N, 2) pixels at (N,) depths; NaN where there is none."""
    return np.column_stack(
        [
            (pixels[:, 0] - camera[2]) / camera[0] * depths_m,
            (pixels[:, 1] - camera[3]) / camera[1] * depths_m,
            depths_m,
        ]
    )


def project(points_in_camera_m: FloatArray, camera: FloatArray) -> FloatArray:
    """(N, 2) pixels of (N, 3) points; NaN of what lies behind the camera or at it."""
    z = points_in_camera_m[:, 2]
    z = np.where(z > _DEPTH_MIN_M, z, np.nan)
    return np.column_stack(
        [
            camera[0] * points_in_camera_m[:, 0] / z + camera[2],
            camera[1] * points_in_camera_m[:, 1] / z + camera[3],
        ]
    )
