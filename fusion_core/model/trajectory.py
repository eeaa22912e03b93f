"""A body's poses in the map over time."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.errors import StampOutsideRange
from fusion_core.model.geometry import planar_from_transform, transform_from_planar
from fusion_core.model.interpolation import interpolate_transform
from fusion_core.model.stamps import find_neighbours


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """Poses of one body in one map.

    ``stamps_ns``: (N,) int64, N >= 1, strictly increasing.
    ``T_map_body``: (N, 4, 4) float64, each maps body coordinates to map coordinates.
    """

    stamps_ns: IntArray
    T_map_body: FloatArray

    def __post_init__(self) -> None:
        count = self.stamps_ns.size
        if self.stamps_ns.shape != (count,) or self.stamps_ns.dtype != np.int64 or count == 0:
            raise ValueError(f"stamps_ns must be (N,) int64, N >= 1, got {self.stamps_ns.shape}")
        if self.T_map_body.shape != (count, 4, 4) or self.T_map_body.dtype != np.float64:
            raise ValueError(
                f"T_map_body must be ({count}, 4, 4) float64, got {self.T_map_body.shape}"
            )
        if np.any(np.diff(self.stamps_ns) <= 0):
            raise ValueError("stamps_ns must be strictly increasing")
        if not np.isfinite(self.T_map_body).all():
            raise ValueError("T_map_body must be finite")
        read_only(self.stamps_ns)
        read_only(self.T_map_body)

    @classmethod
    def from_planar(cls, stamps_ns: IntArray, poses: FloatArray) -> "Trajectory":
        """From (N, 3) poses x, y, yaw in metres and radians."""
        return cls(stamps_ns=stamps_ns, T_map_body=transform_from_planar(poses.reshape(-1, 3)))

    @property
    def planar_poses(self) -> FloatArray:
        """(N, 3) poses x, y, yaw; height, pitch and roll are dropped."""
        return planar_from_transform(self.T_map_body)

    def pose_at(self, stamp_ns: int) -> FloatArray:
        """(4, 4) T_map_body at an instant, interpolated between its two neighbours.

        Raises StampOutsideRange before the first and after the last stamp.
        """
        neighbours = find_neighbours(self.stamps_ns, stamp_ns)
        if neighbours is None:
            raise StampOutsideRange(
                "no pose",
                stamp_ns=stamp_ns,
                start_ns=int(self.stamps_ns[0]),
                end_ns=int(self.stamps_ns[-1]),
            )
        before, after, _, fraction = neighbours
        if before == after:
            exact: FloatArray = self.T_map_body[after].copy()
            return exact
        return interpolate_transform(self.T_map_body[before], self.T_map_body[after], fraction)
