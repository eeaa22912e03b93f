"""Pixels to rays: the inverse of ``project_points``."""

import cv2
import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.sensors import CameraIntrinsics

# Newton's or fixed-point steps until the pixel is met to 1e-10 of the focal length.
_UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-10)


def undistort_pixels(pixels: FloatArray, intrinsics: CameraIntrinsics) -> FloatArray:
    """(N, 2) x / z and y / z of the rays through (N, 2) pixels."""
    given = np.ascontiguousarray(pixels, np.float64).reshape(1, -1, 2)
    if given.size == 0:
        return np.empty((0, 2))
    K, coefficients = intrinsics.matrix, intrinsics.opencv_distortion
    if intrinsics.is_fisheye:
        rays = cv2.fisheye.undistortPoints(given, K, coefficients, criteria=_UNTIL)
    else:
        rays = cv2.undistortPoints(given, K, coefficients, criteria=_UNTIL)
    return np.asarray(rays, np.float64).reshape(-1, 2)
