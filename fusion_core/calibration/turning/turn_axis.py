"""Which way a LiDAR lies on its turning axis, by the sharpness of the cloud of a turn."""

import numpy as np

from fusion_core.calibration.turning.turn import rotate_about_z
from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import make_transform, transform_points

_VOXEL_M = 0.15
_LETTERS = ("x", "y", "z")


def axis_aligned_mountings() -> dict[str, FloatArray]:
    """(4, 4) T_axis_lidar for an axis along each of the LiDAR's own, named ``+z`` and so on.

    The x of ``axis`` is the LiDAR's own, its zero of azimuth, as Song's X_L is; where that is the
    axis itself, it is the LiDAR's y.
    """
    mountings = {}
    for column in range(3):
        for sign in (1.0, -1.0):
            axis = sign * np.eye(3)[column]
            across = np.eye(3)[1 if column == 0 else 0]
            rotation = np.stack([across, np.cross(axis, across), axis])
            name = f"{'+' if sign > 0 else '-'}{_LETTERS[column]}"
            mountings[name] = make_transform(rotation, np.zeros(3))
    return mountings


def occupied_voxels(
    points_in_lidar_m: FloatArray, axis_angles_rad: FloatArray, T_axis_lidar: FloatArray
) -> int:
    """In how many voxels of 15 cm the points of a turn come to lie: the fewer, the sharper."""
    cloud_m = rotate_about_z(transform_points(T_axis_lidar, points_in_lidar_m), axis_angles_rad)
    return len(np.unique(np.floor(cloud_m / _VOXEL_M).astype(np.int64), axis=0))
