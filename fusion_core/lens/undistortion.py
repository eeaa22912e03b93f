"""Pixels to rays: the inverse of ``project_points``."""

import cv2
import numpy as np

from fusion_core.lens.projection import project_points
from fusion_core.model.conventions import Float32Array, FloatArray
from fusion_core.model.sensors import CameraIntrinsics

# Newton's or fixed-point steps until the pixel is met to 1e-10 of the focal length.
_UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-10)
# A ray that comes back farther away than this was not inverted: beyond the fold of the distortion.
_RETURN_PX = 0.5


def undistort_pixels(pixels: FloatArray | Float32Array, intrinsics: CameraIntrinsics) -> FloatArray:
    """(N, 2) x / z and y / z of the rays through (N, 2) pixels. Beyond the fold of the distortion
    they are of no use."""
    given = np.ascontiguousarray(pixels, np.float64).reshape(1, -1, 2)
    if given.size == 0:
        return np.empty((0, 2))
    K, coefficients = intrinsics.matrix, intrinsics.opencv_distortion
    if intrinsics.is_fisheye:
        rays = cv2.fisheye.undistortPoints(given, K, coefficients, criteria=_UNTIL)
    else:
        rays = cv2.undistortPoints(given, K, coefficients, criteria=_UNTIL)
    return np.asarray(rays, np.float64).reshape(-1, 2)


def pixel_rays(pixels: FloatArray, intrinsics: CameraIntrinsics) -> FloatArray:
    """(N, 3) directions with z = 1 in the optical frame of (N, 2) pixels, NaN where the lens model
    has no inverse."""
    rays = np.concatenate([undistort_pixels(pixels, intrinsics), np.ones((len(pixels), 1))], axis=1)
    off = np.linalg.norm(project_points(rays, intrinsics) - pixels, axis=1)
    # NaN, for a ray that cannot be projected, compares false.
    rays[~(off < _RETURN_PX)] = np.nan
    return rays


def straight_pixels(pixels: FloatArray | Float32Array, intrinsics: CameraIntrinsics) -> FloatArray:
    """(N, 2) where the same camera without distortion would show (N, 2) pixels, NaN where the lens
    model has no inverse."""
    exact = pixels.astype(np.float64)
    if intrinsics.is_straight:
        return exact
    rays = pixel_rays(exact, intrinsics)
    return rays[:, :2] * (intrinsics.fx, intrinsics.fy) + (intrinsics.cx, intrinsics.cy)
