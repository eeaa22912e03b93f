"""One fit of a lens to the corners of boards: Zhang 2000 (pinhole with the distortion of Brown) or
Kannala and Brandt 2006 (fisheye), by OpenCV."""

from typing import Literal

import cv2
import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.sensors import CameraIntrinsics

CameraModel = Literal["pinhole", "fisheye"]
_UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-10)
# Fisheye lenses that fill the image with 60 to 200 degrees: starts, as fractions of its width.
_FISHEYE_STARTS = (1.0 / np.pi, 0.5, 1.0)


def fit_lens(
    points_m: FloatArray,
    corners_px: list[FloatArray],
    shape: tuple[int, int],
    model: CameraModel,
    higher: bool,
    start: CameraIntrinsics | None,
) -> CameraIntrinsics | None:
    """The intrinsics of images with ``shape`` (height, width) that show the board's (N, 3) points
    at (N, 2) corners each; None where OpenCV finds none.

    ``higher``: with the highest terms of the distortion. ``start``: intrinsics to begin with.
    """
    fit = _fit_pinhole if model == "pinhole" else _fit_fisheye
    try:
        return fit(points_m, corners_px, shape, higher, start)
    except (cv2.error, ValueError):
        # ValueError: the fit ran off to intrinsics that no camera has.
        return None


def _fit_pinhole(
    points_m: FloatArray,
    corners_px: list[FloatArray],
    shape: tuple[int, int],
    higher: bool,
    start: CameraIntrinsics | None,
) -> CameraIntrinsics:
    objects = [points_m.astype(np.float32)] * len(corners_px)
    images = [corners.astype(np.float32) for corners in corners_px]
    K, coefficients, flags = np.eye(3) if start is None else start.matrix, np.zeros(5), 0
    if start is not None:
        coefficients[: len(start.distortion)] = start.distortion
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    if not higher:
        flags |= cv2.CALIB_FIX_K3
    _, fitted, distortion, _, _ = cv2.calibrateCamera(
        objects, images, shape[::-1], K, coefficients, flags=flags, criteria=_UNTIL
    )
    kept = np.asarray(distortion, np.float64).ravel()[: 5 if higher else 4]
    return _intrinsics(np.asarray(fitted, np.float64), kept, shape, "plumb_bob")


def _fit_fisheye(
    points_m: FloatArray,
    corners_px: list[FloatArray],
    shape: tuple[int, int],
    higher: bool,
    start: CameraIntrinsics | None,
) -> CameraIntrinsics:
    # OpenCV 5 takes one row of points for each image, not one column.
    objects = [points_m.reshape(1, -1, 3)] * len(corners_px)
    images = [corners.reshape(1, -1, 2) for corners in corners_px]
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
    if not higher:
        flags |= cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_K4
    starts = []
    if start is None:
        for focal_px in (fraction * max(shape) for fraction in _FISHEYE_STARTS):
            K = np.diag([focal_px, focal_px, 1.0])
            K[:2, 2] = 0.5 * (np.array(shape[::-1]) - 1.0)
            starts.append((K, np.zeros((4, 1))))
    else:
        known = np.zeros((4, 1))
        known[: len(start.distortion), 0] = start.distortion
        starts.append((start.matrix, known))
    fits = []
    for K, coefficients in starts:
        try:
            fits.append(
                cv2.fisheye.calibrate(
                    objects, images, shape[::-1], K, coefficients, flags=flags, criteria=_UNTIL
                )[:3]
            )
        except cv2.error:
            continue
    if not fits:
        raise ValueError("no start converges")
    _, fitted, distortion = min(fits, key=lambda fit: fit[0])
    kept = np.asarray(distortion, np.float64).ravel()[: 4 if higher else 2]
    return _intrinsics(np.asarray(fitted, np.float64), kept, shape, "equidistant")


def _intrinsics(
    K: FloatArray, coefficients: FloatArray, shape: tuple[int, int], model: str
) -> CameraIntrinsics:
    return CameraIntrinsics(
        width=shape[1],
        height=shape[0],
        fx=float(K[0, 0]),
        fy=float(K[1, 1]),
        cx=float(K[0, 2]),
        cy=float(K[1, 2]),
        distortion_model=model,
        distortion=tuple(map(float, coefficients)),
    )
