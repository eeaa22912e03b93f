"""Points of a camera's frame to pixels, with the distortion of its lens."""

from functools import lru_cache

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.sensors import CameraIntrinsics

# How finely the image's diagonal is searched for the place where the distortion folds back.
_FOLD_STEPS = 2000


def project_points(points_in_camera_m: FloatArray, intrinsics: CameraIntrinsics) -> FloatArray:
    """(N, 2) pixels (u, v) of (N, 3) points in the optical frame, inside the image or not.

    NaN for a point that is not ahead, and for one so far from the axis that the polynomial of the
    distortion folds back there: it would appear where the lens does not show it.
    """
    pixels = np.full((points_in_camera_m.shape[0], 2), np.nan)
    seen = points_in_camera_m[:, 2] > 0.0
    radius = np.hypot(points_in_camera_m[seen, 0], points_in_camera_m[seen, 1])
    seen[seen] = radius < _largest_radius(intrinsics) * points_in_camera_m[seen, 2]
    if not seen.any():
        return pixels
    pixels[seen] = _project(points_in_camera_m[seen], intrinsics)[0]
    return pixels


def project_with_jacobian(
    points_in_camera_m: FloatArray, intrinsics: CameraIntrinsics
) -> tuple[FloatArray, FloatArray]:
    """(N, 2) pixels and (N, 2, 3) their derivatives by the point, of points ahead that the lens
    shows."""
    pixels, jacobian = _project(points_in_camera_m, intrinsics)
    first = 11 if intrinsics.is_fisheye else 3
    # A translation of the camera's frame moves every point by itself.
    by_translation = jacobian[:, first : first + 3].reshape(-1, 2, 3)
    return pixels, by_translation


def inside_image(pixels: FloatArray, intrinsics: CameraIntrinsics) -> BoolArray:
    """(N,) whether pixels lie in the image; NaN does not."""
    u, v = pixels[:, 0], pixels[:, 1]
    right, below = intrinsics.width - 0.5, intrinsics.height - 0.5
    inside: BoolArray = (u >= -0.5) & (u < right) & (v >= -0.5) & (v < below)
    return inside


def _project(
    points_in_camera_m: FloatArray, intrinsics: CameraIntrinsics
) -> tuple[FloatArray, FloatArray]:
    """(N, 2) pixels, and OpenCV's Jacobian, (2 N, ...), whose columns its models order each in
    their way."""
    points = np.ascontiguousarray(points_in_camera_m, np.float64).reshape(-1, 1, 3)
    project = cv2.fisheye.projectPoints if intrinsics.is_fisheye else cv2.projectPoints
    origin = np.zeros(3)
    pixels, jacobian = project(
        points, origin, origin, intrinsics.matrix, intrinsics.opencv_distortion
    )
    return np.asarray(pixels, np.float64).reshape(-1, 2), np.asarray(jacobian, np.float64)


@lru_cache(maxsize=16)
def _largest_radius(intrinsics: CameraIntrinsics) -> float:
    """The tangent of the angle from the axis up to which the distortion grows with the angle."""
    if intrinsics.is_straight:
        return np.inf
    coefficients = intrinsics.opencv_distortion
    if intrinsics.is_fisheye:
        angle = np.linspace(0.0, 0.5 * np.pi, _FOLD_STEPS, endpoint=False)
        powers = angle[:, np.newaxis] ** (2 * np.arange(1, 5))
        distorted = angle * (1.0 + powers @ coefficients)
        return float(np.tan(angle[_last_growing(distorted)]))
    # The tangential terms are left out: they are small, and have no one radius.
    k = np.zeros(8)
    k[: min(8, coefficients.size)] = coefficients[:8]
    corner = max(
        np.hypot(u - intrinsics.cx, (v - intrinsics.cy) * intrinsics.fx / intrinsics.fy)
        for u in (0, intrinsics.width)
        for v in (0, intrinsics.height)
    )
    # Twice the image: what lies beyond cannot be seen by a lens that the model describes.
    radius = np.linspace(0.0, 2.0 * corner / intrinsics.fx, _FOLD_STEPS)
    r2 = radius**2
    above = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    below = 1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    with np.errstate(divide="ignore", invalid="ignore"):
        distorted = radius * above / below
    return float(radius[_last_growing(distorted)])


def _last_growing(values: FloatArray) -> int:
    falls = np.flatnonzero(~(np.diff(values) > 0.0))
    return int(falls[0]) if falls.size else values.size - 1
