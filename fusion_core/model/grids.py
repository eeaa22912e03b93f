"""Occupancy grids: free, occupied and unknown are three states, and unknown is not one half."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True)
class OccupancyGrid:
    """A map. Row 0 is the smallest y, column 0 the smallest x (not an image's order).

    ``log_odds``: (rows, columns) float64, NaN where no ray ever passed (unknown).
    ``origin_m``: (x, y) of the outer corner of cell (0, 0) in the map frame.
    """

    resolution_m: float
    origin_m: tuple[float, float]
    log_odds: FloatArray
    frame_id: str = "map"

    def __post_init__(self) -> None:
        if self.log_odds.ndim != 2 or self.log_odds.dtype != np.float64:
            raise ValueError(f"log_odds must be (rows, columns) float64, got {self.log_odds.shape}")
        if not self.resolution_m > 0.0:
            raise ValueError(f"resolution_m must be positive, got {self.resolution_m}")
        read_only(self.log_odds)

    @property
    def known(self) -> BoolArray:
        """(rows, columns): cells that some ray has passed or hit."""
        return np.isfinite(self.log_odds)

    @property
    def probability(self) -> FloatArray:
        """(rows, columns) probability of being occupied, NaN where unknown."""
        return 1.0 / (1.0 + np.exp(-self.log_odds))

    def to_numpy(self) -> NDArray[np.int8]:
        """(rows, columns) as nav_msgs/OccupancyGrid has it: 0 free to 100 occupied, -1 unknown."""
        percent = np.where(self.known, np.rint(100.0 * self.probability), -1.0)
        return percent.astype(np.int8)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapDifference:
    """Which of several maps has an obstacle where, on a canvas that covers all of them.

    ``names``: of the maps, first to last. ``states``: (rows, columns) uint8 in the order of
    OccupancyGrid: ``UNKNOWN`` in every map, ``FREE`` in at least one and occupied in none, else
    ``FREE`` plus a bit mask of the maps in which the cell is occupied (1 the first, 2 the second).
    """

    UNKNOWN: ClassVar[int] = 0
    FREE: ClassVar[int] = 1

    names: tuple[str, ...]
    resolution_m: float
    origin_m: tuple[float, float]
    states: ByteArray

    def __post_init__(self) -> None:
        if self.states.ndim != 2 or self.states.dtype != np.uint8:
            raise ValueError(f"states must be (rows, columns) uint8, got {self.states.shape}")
        read_only(self.states)

    @property
    def legend(self) -> dict[int, str]:
        """A label for every state, whether it occurs or not."""
        legend = {self.UNKNOWN: "unknown", self.FREE: "free"}
        everywhere = 2 ** len(self.names) - 1
        for mask in range(1, everywhere + 1):
            having = [name for i, name in enumerate(self.names) if mask & (1 << i)]
            only = "" if mask == everywhere else "only "
            legend[self.FREE + mask] = f"{only}{' and '.join(having)}"
        return legend
