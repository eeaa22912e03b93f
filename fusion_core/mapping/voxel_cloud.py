"""A voxel-grid average of points: memory grows with the surfaces seen, not the points added."""

import numpy as np
from numpy.typing import NDArray

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import MappingFailed

# Three voxel indices of 21 bits fit the key, an int64.
_INDEX_BITS = 21
_INDEX_END = 1 << (_INDEX_BITS - 1)
_SHIFTS: IntArray = np.array([0, _INDEX_BITS, 2 * _INDEX_BITS])
# Points are buffered (24 MB) so that sorting is amortised.
_BUFFERED_MIN = 1 << 20


class VoxelCloud:
    """The mean of the points in each voxel, and of what they carry, as their colour.

    ``voxel_m``: side of a voxel. ``voxels_max`` bounds the memory, about 150 bytes each while
    the buffer is flushed, and 50 more for each value that a point carries (``channels``). Where
    that does not suffice, the voxels become twice as large if the cloud ``coarsens``.
    """

    def __init__(
        self,
        voxel_m: float,
        voxels_max: int = 4_000_000,
        *,
        channels: int = 0,
        coarsens: bool = False,
    ) -> None:
        if not voxel_m > 0.0:
            raise ValueError(f"voxel_m must be positive, got {voxel_m}")
        self._voxel_m = voxel_m
        self._voxels_max = voxels_max
        self._channels = channels
        self._coarsens = coarsens
        self._keys: IntArray = np.empty(0, dtype=np.int64)
        # x, y, z and the values carried.
        self._sums: FloatArray = np.empty((0, 3 + channels))
        self._counts: IntArray = np.empty(0, dtype=np.int64)
        self._buffered: list[FloatArray] = []
        self._buffered_count = 0

    @property
    def voxel_m(self) -> float:
        """Side of a voxel, by now."""
        return self._voxel_m

    def add(self, points_m: FloatArray, values: NDArray[np.generic] | None = None) -> None:
        """Add (N, 3) finite points that carry (N, ``channels``) values.

        Raises MappingFailed where the cloud becomes too large.
        """
        if points_m.ndim != 2 or points_m.shape[1] != 3 or not np.isfinite(points_m).all():
            raise ValueError(f"points_m must be (N, 3) and finite, got {points_m.shape}")
        carried = np.empty((len(points_m), 0)) if values is None else values
        if carried.shape != (len(points_m), self._channels):
            raise ValueError(f"values must be (N, {self._channels}), got {carried.shape}")
        self._buffered.append(np.hstack([points_m, carried], dtype=np.float64))
        self._buffered_count += len(points_m)
        if self._buffered_count >= max(_BUFFERED_MIN, self._keys.size):
            self._flush()

    def points_m(self) -> FloatArray:
        """(M, 3) one point per voxel, in the order of the voxels.

        Raises MappingFailed as ``add``.
        """
        return self._means(slice(0, 3))

    def values(self) -> FloatArray:
        """(M, ``channels``) the mean of the values in each voxel, in the order of ``points_m``.

        Raises MappingFailed as ``add``.
        """
        return self._means(slice(3, None))

    def _means(self, columns: slice) -> FloatArray:
        self._flush()
        means: FloatArray = self._sums[:, columns] / self._counts[:, np.newaxis]
        return means

    def _flush(self) -> None:
        if not self._buffered:
            return
        added = np.concatenate(self._buffered)
        self._buffered, self._buffered_count = [], 0
        self._join_voxels(np.concatenate([self._keys, self._keys_of(added[:, :3])]), added)
        while len(self._keys) > self._voxels_max:
            if not self._coarsens:
                raise MappingFailed(
                    f"the cloud exceeds {self._voxels_max} voxels of {self._voxel_m:g} m.",
                    advice="Choose a larger voxel.",
                )
            self._voxel_m *= 2.0
            index = (self._keys[:, np.newaxis] >> _SHIFTS) & (2 * _INDEX_END - 1)
            # Doubling is exact: the voxel of a point lies in its coarser one.
            self._join_voxels(_join_indices((index >> 1) + _INDEX_END // 2), self._sums[:0])

    def _join_voxels(self, keys: IntArray, added: FloatArray) -> None:
        """Join the voxels, and points added to them, that have one key.

        ``keys``: (M + N,) of the M voxels and of the points. ``added``: (N, 3 + ``channels``).
        """
        order = np.argsort(keys, kind="stable")
        keys = keys[order]
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        self._keys = keys[first]
        if not first.size:
            return
        counts = np.concatenate([self._counts, np.ones(len(added), dtype=np.int64)])
        self._counts = np.add.reduceat(counts[order], first)
        sums = np.empty((first.size, added.shape[1]))
        # Column by column: copies of all of them would be most of the memory.
        for column in range(added.shape[1]):
            values = np.concatenate([self._sums[:, column], added[:, column]])
            sums[:, column] = np.add.reduceat(values[order], first)
        self._sums = sums

    def _keys_of(self, points_m: FloatArray) -> IntArray:
        """(N,) non-negative key of each point's voxel."""
        cells = np.floor(points_m / self._voxel_m)
        if not (np.abs(cells) < _INDEX_END).all():
            raise MappingFailed(
                f"a point lies {np.abs(points_m).max():.4g} m from the map's origin, too far for "
                f"voxels of {self._voxel_m:g} m.",
                advice="Check the poses, or choose a larger voxel.",
            )
        return _join_indices(cells.astype(np.int64) + _INDEX_END)


def _join_indices(index: IntArray) -> IntArray:
    """(N,) keys of (N, 3) non-negative indices."""
    keys: IntArray = (index[:, 2] << 2 * _INDEX_BITS) | (index[:, 1] << _INDEX_BITS) | index[:, 0]
    return keys
