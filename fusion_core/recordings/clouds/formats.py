"""A point cloud from a file, told by its content."""

import os
from pathlib import Path

import numpy as np

from fusion_core.files.regular_file import open_regular
from fusion_core.model.conventions import Float32Array
from fusion_core.model.errors import RecordingError
from fusion_core.model.sensors import PointCloud
from fusion_core.recordings.clouds.bad_cloud import BadCloud
from fusion_core.recordings.clouds.kitti_bin import is_kitti_bin, read_kitti_bin, refuse_bin
from fusion_core.recordings.clouds.pcd import is_pcd, read_pcd
from fusion_core.recordings.clouds.ply import is_ply, read_ply

READABLE_CLOUDS = (
    "Readable are clouds as PCD (ascii, binary, binary_compressed), PLY, and KITTI's .bin."
)
_HEAD_BYTES = 512
# Farther than any LiDAR sees. A room in millimetres is beyond it, and a map in coordinates of the
# Earth, of which float32 would leave centimetres.
_RANGE_MAX_M = 1000.0


def cloud_format(path: Path, head: bytes, size_bytes: int) -> str | None:
    """The format of a cloud file by its first bytes, its name and its size; None for no cloud."""
    if is_pcd(head):
        return "PCD"
    if is_ply(head):
        return "PLY"
    return "KITTI .bin" if is_kitti_bin(path, head, size_bytes) else None


def read_cloud(path: Path, warnings: list[str] | None = None) -> PointCloud:
    """The cloud in a PCD, PLY or KITTI .bin file, in its own frame, with the intensity if it has
    one; points without a finite position are NaN, and keep their place.

    A point whose coordinates are all 0 has no position, either: some drivers write a missing one
    so. What a damaged file still holds is read, and ``warnings`` gets a line for each loss; without
    ``warnings`` such a file is an error. Stamps are 0: these files have none.

    Raises RecordingError for a file that is no cloud, has no points, is not in metres around the
    scanner or contradicts itself.
    """
    losses: list[str] = []
    try:
        values = _read_values(path, losses)
    except OSError as error:
        raise RecordingError(
            f"cannot be read: {error.strerror or error}.",
            file=path,
            advice="Check the path and its permissions.",
        ) from error
    except BadCloud as error:
        raise RecordingError(
            f"is no cloud that can be read: {error}.", file=path, advice=error.advice
        ) from error
    cloud = _as_cloud(values)
    measured_m = cloud.xyz_m[np.isfinite(cloud.xyz_m[:, 0])]
    if len(measured_m) == 0:
        raise RecordingError(
            f"has no point with a finite position among {len(values)}.",
            file=path,
            advice="Record the cloud again.",
        )
    usual_m = float(np.median(np.abs(measured_m).max(axis=1)))
    if usual_m > _RANGE_MAX_M:
        raise RecordingError(
            f"has half of its points more than {usual_m:.0f} m from the origin.",
            file=path,
            advice="Lengths are in metres, and the scanner is near the origin.",
        )
    if losses and warnings is None:
        raise RecordingError(" ".join(losses), file=path, advice="Copy it again from its source.")
    if warnings is not None:
        warnings += [f"{path.name}: {loss}" for loss in losses]
    return cloud


def _read_values(path: Path, losses: list[str]) -> Float32Array:
    with open_regular(path) as file:
        size_bytes = os.fstat(file.fileno()).st_size
        if size_bytes == 0:
            raise BadCloud("it is empty")
        head = file.read(_HEAD_BYTES)
        file.seek(0)
        match cloud_format(path, head, size_bytes):
            case "PCD":
                return read_pcd(file, size_bytes, losses)
            case "PLY":
                return read_ply(file, losses)
            case "KITTI .bin":
                return read_kitti_bin(file, size_bytes)
    if path.suffix.lower() == ".bin":
        raise refuse_bin(size_bytes)
    raise BadCloud("its content is of no known format", READABLE_CLOUDS)


def _as_cloud(values: Float32Array) -> PointCloud:
    xyz_m = np.ascontiguousarray(values[:, :3])
    xyz_m[~np.isfinite(xyz_m).all(axis=1) | ~xyz_m.any(axis=1)] = np.nan
    intensity = None
    if values.shape[1] > 3:
        intensity = np.ascontiguousarray(values[:, 3])
        intensity[~np.isfinite(intensity)] = np.nan
    return PointCloud(stamp_ns=0, received_ns=None, frame_id="", xyz_m=xyz_m, intensity=intensity)
