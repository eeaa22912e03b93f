"""The pose of a camera from points and where it sees them, by RANSAC."""

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.geometry import make_transform


def ransac_pnp(
    points_m: FloatArray,
    seen: FloatArray,
    K: FloatArray,
    *,
    draws: int,
    threshold: float,
    confidence: float,
    method: int,
) -> tuple[FloatArray, BoolArray] | None:
    """(4, 4) from the points' frame to the camera's, and which points agree with it, (N,).

    ``points_m``: (N, 3). ``seen``: (N, 2) in the units of ``K``, (3, 3), without distortion, as is
    ``threshold``. ``method``: OpenCV's solver of a draw. The pose may not be finite. None where
    OpenCV finds none: the points lie in one place, on one line, or contradict each other.
    """
    try:
        done, turn, shift, inliers = cv2.solvePnPRansac(
            np.ascontiguousarray(points_m, np.float64),
            np.ascontiguousarray(seen, np.float64),
            K,
            None,
            iterationsCount=draws,
            reprojectionError=threshold,
            confidence=confidence,
            flags=method,
        )
    except cv2.error:
        return None
    if not done or inliers is None:
        return None
    agrees = np.zeros(len(points_m), np.bool_)
    agrees[np.asarray(inliers).reshape(-1)] = True
    R = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    return make_transform(R, np.asarray(shift, np.float64).reshape(3)), agrees
