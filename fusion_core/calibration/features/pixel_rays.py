"""Pixels to rays, where the lens model has an inverse."""

import numpy as np

from fusion_core.calibration.projection import project_points
from fusion_core.calibration.undistortion import undistort_pixels
from fusion_core.model.conventions import FloatArray
from fusion_core.model.sensors import CameraIntrinsics

# A ray that comes back farther away than this was not inverted: beyond the fold of the distortion.
_RETURN_PX = 0.5


def pixel_rays(pixels: FloatArray, intrinsics: CameraIntrinsics) -> FloatArray:
    """(N, 3) directions with z = 1 in the optical frame of (N, 2) pixels, NaN where the lens model
    has no inverse."""
    rays = np.concatenate([undistort_pixels(pixels, intrinsics), np.ones((len(pixels), 1))], axis=1)
    off = np.linalg.norm(project_points(rays, intrinsics) - pixels, axis=1)
    # NaN, for a ray that cannot be projected, compares false.
    rays[~(off < _RETURN_PX)] = np.nan
    return rays


def ideal_pixels(pixels: FloatArray, intrinsics: CameraIntrinsics) -> FloatArray:
    """(N, 2) where the same camera without distortion would show (N, 2) pixels."""
    rays = pixel_rays(pixels, intrinsics)
    return rays[:, :2] * (intrinsics.fx, intrinsics.fy) + (intrinsics.cx, intrinsics.cy)
