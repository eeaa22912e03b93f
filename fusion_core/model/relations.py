"""Reference relations: relative poses between pairs of instants, without a whole trajectory."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True)
class Relations:
    """Relative poses of one body between pairs of instants (Kümmerle et al. 2009).

    ``first_stamps_ns``, ``second_stamps_ns``: (N,) int64, N >= 1, in any order.
    ``T_first_second``: (N, 4, 4) float64, the body's pose at the second instant seen from its pose
    at the first.
    """

    first_stamps_ns: IntArray
    second_stamps_ns: IntArray
    T_first_second: FloatArray

    def __post_init__(self) -> None:
        count = self.first_stamps_ns.size
        for stamps_ns in (self.first_stamps_ns, self.second_stamps_ns):
            if stamps_ns.shape != (count,) or stamps_ns.dtype != np.int64 or count == 0:
                raise ValueError(f"stamps must be (N,) int64, N >= 1, got {stamps_ns.shape}")
        if self.T_first_second.shape != (count, 4, 4) or self.T_first_second.dtype != np.float64:
            raise ValueError(
                f"T_first_second must be ({count}, 4, 4) float64, got {self.T_first_second.shape}"
            )
        if not np.isfinite(self.T_first_second).all():
            raise ValueError("T_first_second must be finite")
        for array in (self.first_stamps_ns, self.second_stamps_ns, self.T_first_second):
            read_only(array)
