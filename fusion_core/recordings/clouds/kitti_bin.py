"""KITTI's .bin: x, y, z and reflectance of each point as float32, and nothing else.

Such a file says nothing of itself, so that its name, its size and its values must tell.
"""

from pathlib import Path
from typing import BinaryIO

import numpy as np

from fusion_core.model.conventions import Float32Array
from fusion_core.recordings.clouds.bad_cloud import BadCloud
from fusion_core.recordings.clouds.point_layout import PointField, PointLayout, require_count
from fusion_core.recordings.clouds.rows import read_binary_rows

_LAYOUT = PointLayout(
    tuple(PointField(name, np.dtype("<f4")) for name in ("x", "y", "z", "reflectance"))
)
# Farther than any LiDAR sees, and finer than any measures. Most other bytes would lie beyond either
# if they were read as float32.
_RANGE_MAX_M, _FINEST_M = 1000.0, 1e-6
_ADVICE = "A .bin file must hold x, y, z and reflectance as float32, as KITTI's do."


def is_kitti_bin(path: Path, head: bytes, size_bytes: int) -> bool:
    """Whether a file looks like one by its name, its size and its first points."""
    if path.suffix.lower() != ".bin" or size_bytes % _LAYOUT.row_bytes:
        return False
    points = len(head) // _LAYOUT.row_bytes
    first = np.frombuffer(head, "<f4", 4 * points).reshape(-1, 4)
    return points > 0 and 2 * _count_plausible(first) > points


def read_kitti_bin(file: BinaryIO, size_bytes: int) -> Float32Array:
    """(N, 4) x, y, z and reflectance. Raises BadCloud for values that no LiDAR measures."""
    count = require_count(size_bytes // _LAYOUT.row_bytes)
    values = read_binary_rows(file, _LAYOUT, count)
    plausible = _count_plausible(values)
    if 2 * plausible < count:
        raise BadCloud(
            f"{count - plausible} of {count} points are not where a LiDAR measures", _ADVICE
        )
    return values


def refuse_bin(size_bytes: int) -> BadCloud:
    """What is wrong with a .bin file that does not look like KITTI's."""
    if size_bytes % _LAYOUT.row_bytes:
        return BadCloud(f"its {size_bytes} bytes are no multiple of 16", _ADVICE)
    return BadCloud("its first points are not where a LiDAR measures", _ADVICE)


def _count_plausible(values: Float32Array) -> int:
    """How many points of (N, 4) have coordinates that a LiDAR could have measured."""
    distance_m = np.abs(values[:, :3])
    with np.errstate(invalid="ignore"):
        within = (distance_m < _RANGE_MAX_M) & ((distance_m > _FINEST_M) | (distance_m == 0.0))
    return int(within.all(axis=1).sum())
