"""A voxel-grid average of points: memory grows with the surfaces seen, not the points added."""

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import MappingFailed

# Three voxel indices of 21 bits fit the key, an int64.
_INDEX_BITS = 21
_INDEX_END = 1 << (_INDEX_BITS - 1)
# Points are buffered (24 MB) so that sorting is amortised.
_BUFFERED_MIN = 1 << 20


class VoxelCloud:
    """The mean of the points in each voxel.

    ``voxel_m``: side of a voxel. ``voxels_max`` bounds the memory, about 150 bytes each while
    the buffer is flushed.
    """

    def __init__(self, voxel_m: float, voxels_max: int = 4_000_000) -> None:
        if not voxel_m > 0.0:
            raise ValueError(f"voxel_m must be positive, got {voxel_m}")
        self._voxel_m = voxel_m
        self._voxels_max = voxels_max
        self._keys: IntArray = np.empty(0, dtype=np.int64)
        self._sums_m: FloatArray = np.empty((0, 3))
        self._counts: IntArray = np.empty(0, dtype=np.int64)
        self._buffered: list[FloatArray] = []
        self._buffered_count = 0

    def add(self, points_m: FloatArray) -> None:
        """Add (N, 3) finite points. Raises MappingFailed where the cloud becomes too large."""
        if points_m.ndim != 2 or points_m.shape[1] != 3 or not np.isfinite(points_m).all():
            raise ValueError(f"points_m must be (N, 3) and finite, got {points_m.shape}")
        self._buffered.append(np.array(points_m, dtype=np.float64))
        self._buffered_count += len(points_m)
        if self._buffered_count >= max(_BUFFERED_MIN, self._keys.size):
            self._flush()

    def points_m(self) -> FloatArray:
        """(M, 3) one point per voxel, in the order of the voxels.

        Raises MappingFailed as ``add``.
        """
        self._flush()
        points: FloatArray = self._sums_m / self._counts[:, np.newaxis]
        return points

    def _flush(self) -> None:
        if not self._buffered:
            return
        added_m = np.concatenate(self._buffered)
        self._buffered, self._buffered_count = [], 0
        keys = np.concatenate([self._keys, self._keys_of(added_m)])
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        if first.size > self._voxels_max:
            raise MappingFailed(
                f"the cloud exceeds {self._voxels_max} voxels of {self._voxel_m:g} m.",
                advice="Choose a larger voxel.",
            )
        counts = np.concatenate([self._counts, np.ones(len(added_m), dtype=np.int64)])
        sums_m = np.concatenate([self._sums_m, added_m])
        self._keys = keys[first]
        if first.size:
            self._counts = np.add.reduceat(counts[order], first)
            self._sums_m = np.add.reduceat(sums_m[order], first, axis=0)

    def _keys_of(self, points_m: FloatArray) -> IntArray:
        """(N,) non-negative key of each point's voxel."""
        cells = np.floor(points_m / self._voxel_m)
        if not (np.abs(cells) < _INDEX_END).all():
            raise MappingFailed(
                f"a point lies {np.abs(points_m).max():.4g} m from the map's origin, too far for "
                f"voxels of {self._voxel_m:g} m.",
                advice="Check the poses, or choose a larger voxel.",
            )
        index = cells.astype(np.int64) + _INDEX_END
        keys: IntArray = (
            (index[:, 2] << 2 * _INDEX_BITS) | (index[:, 1] << _INDEX_BITS) | index[:, 0]
        )
        return keys
