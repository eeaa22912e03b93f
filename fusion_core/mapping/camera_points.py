"""From a depth image to a cloud of obstacle points (Li 2022 §2.2, steps 1 and 2)."""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.mapping.virtual_scan import VirtualScanSettings
from fusion_core.mapping.voxel_cloud import VoxelCloud
from fusion_core.model.conventions import Float32Array, FloatArray
from fusion_core.model.sensors import CameraIntrinsics


def project_to_cloud(
    depth_m: Float32Array,
    intrinsics: CameraIntrinsics,
    floor_from_camera: FloatArray,
    settings: VirtualScanSettings,
) -> FloatArray:
    """(N, 3) x and y in the scan's frame and height above the floor.

    ``depth_m``: (H, W) upright view without distortion, with ``intrinsics``.
    ``floor_from_camera``: (3, 4), points in the view's optical frame to (x, y, height).

    The paper subsamples first and crops by height afterwards. With a stride the order does not
    matter; a voxel across the limit would average floor and obstacle, so the crop comes first.
    """
    if floor_from_camera.shape != (3, 4):
        raise ValueError(f"floor_from_camera must be (3, 4), got {floor_from_camera.shape}")
    stride = settings.sampling == "stride"
    points_m: FloatArray = _points_in_band(
        depth_m,
        (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy),
        np.ascontiguousarray(floor_from_camera, dtype=np.float64),
        settings.row_stride if stride else 1,
        settings.column_stride if stride else 1,
        (settings.depth_min_m, settings.depth_max_m),
        (settings.height_min_m, settings.height_min_per_m, settings.height_max_m),
    )
    if stride or not len(points_m):
        return points_m
    cloud = VoxelCloud(settings.voxel_m)
    cloud.add(points_m)
    return cloud.points_m()


@compiled(error_model="numpy")
def _points_in_band(
    depth_m: Float32Array,
    intrinsics: tuple[float, float, float, float],
    P: FloatArray,
    row_stride: int,
    column_stride: int,
    depths_m: tuple[float, float],
    band: tuple[float, float, float],
) -> FloatArray:
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    lowest_m, rise, highest_m = band
    most = ((height - 1) // row_stride + 1) * ((width - 1) // column_stride + 1)
    points_m = np.empty((most, 3))
    count = 0
    for row in range(0, height, row_stride):
        y = (row - cy) / fy
        for column in range(0, width, column_stride):
            z_m = float(depth_m[row, column])
            # A missing depth is NaN and fails both comparisons.
            if not (z_m > depths_m[0] and z_m <= depths_m[1]):
                continue
            x = (column - cx) / fx
            above_m = z_m * (P[2, 0] * x + P[2, 1] * y + P[2, 2]) + P[2, 3]
            # 2) The paper keeps 0.01 m < z < 0.55 m.
            if not (lowest_m < above_m < highest_m):
                continue
            ahead_m = z_m * (P[0, 0] * x + P[0, 1] * y + P[0, 2])
            aside_m = z_m * (P[1, 0] * x + P[1, 1] * y + P[1, 2])
            if rise > 0.0 and above_m <= lowest_m + rise * np.sqrt(ahead_m**2 + aside_m**2):
                continue
            points_m[count, 0] = ahead_m + P[0, 3]
            points_m[count, 1] = aside_m + P[1, 3]
            points_m[count, 2] = above_m
            count += 1
    return points_m[:count].copy()
