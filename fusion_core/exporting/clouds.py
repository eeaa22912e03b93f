"""Point clouds as PLY and PCD."""

from pathlib import Path

import numpy as np

from fusion_core.files.atomic import atomic_path
from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.errors import ExportError


def write_cloud(path: Path, points_m: FloatArray, rgb: ByteArray | None = None) -> None:
    """Write points, binary, in the format that the suffix names (``.ply`` or ``.pcd``).

    ``points_m``: (N, 3), finite. ``rgb``: (N, 3) uint8 or None. Raises ExportError for an empty
    cloud, which neither format can hold, and for another suffix.
    """
    # Imported here: it takes most of a second and 200 MiB.
    import open3d as o3d

    if path.suffix not in (".ply", ".pcd"):
        raise ExportError(
            f"{path.suffix!r} is not a point cloud format.", file=path, advice="Use .ply or .pcd."
        )
    if points_m.shape[0] == 0:
        raise ExportError("the cloud has no points.", file=path)
    if points_m.shape[1:] != (3,) or not np.isfinite(points_m).all():
        raise ValueError(f"points_m must be (N, 3) and finite, got {points_m.shape}")
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_m))
    if rgb is not None:
        cloud.colors = o3d.utility.Vector3dVector(rgb.astype(np.float64) / 255.0)
    with atomic_path(path) as temporary:
        if not o3d.io.write_point_cloud(temporary, cloud):
            raise ExportError("cannot be written.", file=path, advice="Free space on the disk.")
