"""Point clouds as PLY and PCD."""

from pathlib import Path

import numpy as np

from fusion_core.files.atomic import atomic_path
from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray
from fusion_core.model.errors import ExportError


def require_cloud_suffix(path: Path) -> None:
    """Raise ExportError for a file that ``write_cloud`` has no format for."""
    if path.suffix not in (".ply", ".pcd"):
        raise ExportError(
            f"{path.suffix!r} is not a point cloud format.", file=path, advice="Use .ply or .pcd."
        )


def write_cloud(
    path: Path,
    points_m: FloatArray,
    rgb: ByteArray | None = None,
    intensity: Float32Array | FloatArray | None = None,
) -> None:
    """Write points, binary, in the format that the suffix names (``.ply`` or ``.pcd``).

    ``points_m``: (N, 3), finite. ``rgb``: (N, 3) uint8 or None. ``intensity``: (N,) or None, NaN
    where it is missing; written as float32 of that name. Raises ExportError for an empty cloud,
    which neither format can hold, and for another suffix.
    """
    # Imported here: it takes most of a second and 200 MiB.
    import open3d as o3d

    require_cloud_suffix(path)
    count = points_m.shape[0]
    if count == 0:
        raise ExportError("the cloud has no points.", file=path)
    if points_m.shape[1:] != (3,) or not np.isfinite(points_m).all():
        raise ValueError(f"points_m must be (N, 3) and finite, got {points_m.shape}")
    from_numpy = o3d.core.Tensor.from_numpy
    # Readers of PCD expect 32 bits.
    dtype = np.float32 if path.suffix == ".pcd" else np.float64
    cloud = o3d.t.geometry.PointCloud(from_numpy(points_m.astype(dtype)))
    if rgb is not None:
        if rgb.shape != (count, 3) or rgb.dtype != np.uint8:
            raise ValueError(f"rgb must be ({count}, 3) uint8, got {rgb.shape} {rgb.dtype}")
        cloud.point.colors = from_numpy(rgb.copy())
    if intensity is not None:
        if intensity.shape != (count,):
            raise ValueError(f"intensity must be ({count},), got {intensity.shape}")
        cloud.point.intensity = from_numpy(intensity.astype(np.float32)[:, np.newaxis])
    with atomic_path(path) as temporary:
        if not o3d.t.io.write_point_cloud(temporary, cloud):
            raise ExportError("cannot be written.", file=path, advice="Free space on the disk.")
