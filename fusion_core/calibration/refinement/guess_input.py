"""What a refinement from a guess takes: points that have a place, and an image and a guess that
belong to them, or one clear line."""

import numpy as np

from fusion_core.lens.projection import inside_image, project_points
from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import rigid_fault, transform_points
from fusion_core.model.sensors import CameraIntrinsics

_POINTS_MIN = 300
# The far end of any LiDAR's range is 500 m.
_RANGE_MAX_M = 1000.0
_WITHOUT_INTENSITY = "edges alone were compared: give a cloud with intensity to be surer."


def usable_points(
    points_in_lidar_m: FloatArray, intensity: FloatArray | None, notes: list[str]
) -> tuple[FloatArray, FloatArray | None]:
    """Points with a place, away from the origin, and their intensity if it says anything."""
    if points_in_lidar_m.ndim != 2 or points_in_lidar_m.shape[1] != 3:
        raise ValueError(f"points must be (N, 3), got {points_in_lidar_m.shape}")
    if intensity is not None and intensity.shape != points_in_lidar_m.shape[:1]:
        raise ValueError(f"intensity must be (N,), got {intensity.shape}")
    points = np.asarray(points_in_lidar_m, dtype=np.float64)
    with np.errstate(invalid="ignore", over="ignore"):
        range_m = np.linalg.norm(points, axis=1)
    use = np.isfinite(range_m) & (range_m > 0.0)
    if not use.any():
        raise CalibrationFailed("None of the cloud's points has a finite position.")
    median_m = float(np.median(range_m[use]))
    if median_m > _RANGE_MAX_M:
        raise CalibrationFailed(
            f"The cloud's points are {median_m:g} m away in the median.",
            advice="Give it in metres: these look like millimetres.",
        )
    points = points[use]
    if intensity is None:
        notes.append(f"Warning: the cloud has no intensity, so {_WITHOUT_INTENSITY}")
        return points, None
    values = np.asarray(intensity, dtype=np.float64)[use]
    known = np.isfinite(values)
    if not known.any():
        notes.append(f"Warning: the cloud's intensity is nowhere a number, so {_WITHOUT_INTENSITY}")
        return points, None
    if np.ptp(values[known]) == 0.0:
        notes.append(
            f"Warning: the cloud's intensity is {values[known][0]:g} at all points, so "
            f"{_WITHOUT_INTENSITY}"
        )
        return points, None
    return points, np.where(known, values, np.nan)


def require_image(grey: ByteArray, intrinsics: CameraIntrinsics) -> None:
    if grey.ndim != 2:
        raise ValueError(f"the image must be (H, W) grey values, got {grey.shape}")
    if grey.shape != (intrinsics.height, intrinsics.width):
        raise CalibrationFailed(
            f"The image has {grey.shape[1]} x {grey.shape[0]} pixels, but the intrinsics are of "
            f"images of {intrinsics.width} x {intrinsics.height}.",
            advice="Give the intrinsics of this image's size.",
        )
    if grey.min() == grey.max():
        raise CalibrationFailed(
            f"All pixels of the image have the value {grey.min():g}.",
            advice="Give an image that shows the scene.",
        )


def require_rigid(T_guess: FloatArray) -> None:
    if fault := rigid_fault(T_guess):
        raise CalibrationFailed(
            f"The guess is no rigid transform: {fault}.",
            advice="Give a rotation matrix with determinant 1.",
        )


def in_image(
    points: FloatArray, intrinsics: CameraIntrinsics, T_camera_lidar: FloatArray
) -> BoolArray:
    pixels = project_points(transform_points(T_camera_lidar, points), intrinsics)
    return inside_image(pixels, intrinsics)


def thinned_points(
    points: FloatArray,
    intensity: FloatArray | None,
    intrinsics: CameraIntrinsics,
    T_guess: FloatArray,
    points_max: int,
    seed: int,
    notes: list[str],
) -> tuple[FloatArray, FloatArray | None]:
    """No more points than a minute's work; refused where there are too few."""
    count = int(in_image(points, intrinsics, T_guess).sum())
    if count < _POINTS_MIN:
        raise CalibrationFailed(
            f"Only {count} of {len(points)} points lie in the image at the guess; "
            f"{_POINTS_MIN} are needed.",
            advice="Check that the guess maps LiDAR coordinates to the camera's (x right, y down, "
            "z ahead), in metres.",
        )
    if count <= points_max:
        return points, intensity
    notes.append(f"Of {count} points in the image, {points_max} were drawn.")
    drawn = np.random.default_rng(seed).random(len(points))
    kept = drawn < points_max / count
    return points[kept], None if intensity is None else intensity[kept]
