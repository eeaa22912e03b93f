"""Points of a LiDAR in the colours of an image (Song 2022, Fig. 12)."""

import numpy as np

from fusion_core.lens.projection import project_points
from fusion_core.model.conventions import BoolArray, ByteArray, Float32Array, FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import transform_points
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting


class ColoringSettings(StageSettings):
    """Which points the camera sees."""

    cell_deg: float = setting(
        0.4,
        "Width of the cells in which a nearer point hides a farther one: the angle between the "
        "scanner's beams or rings",
        unit="deg",
        ge=0.01,
        le=10.0,
    )
    depth_tolerance: float = setting(
        0.15,
        "How much farther than the nearest point of its cell a point of the same surface may be, "
        "as a fraction: floors and walls are seen at a slant",
        ge=0.0,
        le=10.0,
    )
    depth_tolerance_m: float = setting(
        0.05, "The same as a length, added to the fraction", unit="m", ge=0.0, le=10.0
    )


def color_points(
    points_in_lidar_m: FloatArray | Float32Array,
    rgb_image: ByteArray,
    intrinsics: CameraIntrinsics,
    T_camera_lidar: FloatArray,
    settings: ColoringSettings | None = None,
) -> tuple[ByteArray, BoolArray]:
    """(N, 3) uint8 colours of (N, 3) points, and which of them the camera sees, (N,).

    A point that lies outside the image, behind the camera or behind a nearer surface is not seen,
    nor is one with a NaN; its colour is black. ``rgb_image``: (H, W, 3) uint8, distorted as
    ``intrinsics`` say.

    Raises CalibrationFailed for an image of another size than the intrinsics'.
    """
    settings = ColoringSettings() if settings is None else settings
    height, width = rgb_image.shape[:2]
    if (intrinsics.width, intrinsics.height) != (width, height):
        raise CalibrationFailed(
            f"the image has {width} x {height} pixels, the intrinsics are for "
            f"{intrinsics.width} x {intrinsics.height}.",
            advice="Give the image or the intrinsics of the same size.",
        )
    points_m = points_in_lidar_m.astype(np.float64)
    points_m[~np.isfinite(points_m).all(axis=1)] = np.nan
    points_in_camera_m = transform_points(T_camera_lidar, points_m)
    pixels = project_points(points_in_camera_m, intrinsics)
    # Pixel centres are integers. Comparisons with NaN are false.
    inside = (
        (pixels[:, 0] > -0.5)
        & (pixels[:, 0] < width - 0.5)
        & (pixels[:, 1] > -0.5)
        & (pixels[:, 1] < height - 0.5)
    )
    places = np.flatnonzero(inside)
    distance_m = np.linalg.norm(points_in_camera_m[places], axis=1)
    places = places[~_hidden(pixels[places], distance_m, intrinsics, settings)]
    rgb = np.zeros((points_in_lidar_m.shape[0], 3), np.uint8)
    seen = np.zeros(points_in_lidar_m.shape[0], np.bool_)
    columns, rows = np.rint(pixels[places]).astype(np.int64).T
    rgb[places] = rgb_image[rows, columns]
    seen[places] = True
    return rgb, seen


def _hidden(
    pixels: FloatArray,
    distance_m: FloatArray,
    intrinsics: CameraIntrinsics,
    settings: ColoringSettings,
) -> BoolArray:
    """Which of the points in the image lie behind the nearest point of their cell."""
    cell_px = max(1.0, np.deg2rad(settings.cell_deg) * intrinsics.fx)
    cells = np.floor((pixels + 0.5) / cell_px).astype(np.int64)
    across = int(np.ceil(intrinsics.width / cell_px))
    _, cell = np.unique(cells[:, 1] * across + cells[:, 0], return_inverse=True)
    nearest_m = np.full(cell.max(initial=-1) + 1, np.inf)
    np.minimum.at(nearest_m, cell, distance_m)
    farthest_m = (1.0 + settings.depth_tolerance) * nearest_m + settings.depth_tolerance_m
    return np.asarray(distance_m > farthest_m[cell])
