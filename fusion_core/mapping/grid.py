"""An occupancy grid from planar scans at known poses."""

from dataclasses import dataclass

import numpy as np

from fusion_core.mapping.rays import update_cells
from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.settings import StageSettings, setting

# A growing cell is a float64 and an int32, and three grids stand side by side: 2.3 GB.
_CELLS_MAX = 64_000_000
# Room on each side when a map must grow: as much as the largest map allows.
_PADDINGS = (4, 16, 64)


class GridSettings(StageSettings):
    """Occupancy grid. The probabilities are OctoMap's (Hornung 2013)."""

    resolution_m: float = setting(0.05, "Side of a cell", unit="m", ge=0.001, le=10.0)
    p_hit: float = setting(0.7, "Probability of occupied given a hit", ge=0.5, le=0.999)
    p_miss: float = setting(0.4, "Probability of occupied given a pass", ge=0.001, le=0.5)
    p_lowest: float = setting(0.1192, "Lowest probability a cell can reach", ge=0.001, le=0.5)
    p_highest: float = setting(0.971, "Highest probability a cell can reach", ge=0.5, le=0.999)
    cells_max: int = setting(_CELLS_MAX, "Largest map", unit="cells", ge=1, le=_CELLS_MAX)

    @property
    def side_max_m(self) -> float:
        """Side of the largest square map."""
        return self.resolution_m * float(np.sqrt(self.cells_max))


@dataclass(frozen=True, slots=True)
class _Bounds:
    """Whole cells: rows and columns from first (included) to end (not included)."""

    first_row: int
    first_column: int
    row_end: int
    column_end: int

    @property
    def shape(self) -> tuple[int, int]:
        return self.row_end - self.first_row, self.column_end - self.first_column

    @property
    def size(self) -> int:
        return self.shape[0] * self.shape[1]

    def union(self, other: "_Bounds") -> "_Bounds":
        return _Bounds(
            min(self.first_row, other.first_row),
            min(self.first_column, other.first_column),
            max(self.row_end, other.row_end),
            max(self.column_end, other.column_end),
        )

    def padded(self, share: int) -> "_Bounds":
        """Wider on each side by one part in ``share``, so that a growing map is seldom copied."""
        rows, columns = (max(32, length // share) for length in self.shape)
        return _Bounds(
            self.first_row - rows,
            self.first_column - columns,
            self.row_end + rows,
            self.column_end + columns,
        )

    def part_of(self, other: "_Bounds") -> tuple[slice, slice]:
        """Where these cells lie in an array that covers ``other``."""
        row = self.first_row - other.first_row
        column = self.first_column - other.first_column
        return slice(row, row + self.shape[0]), slice(column, column + self.shape[1])


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1.0 - probability)))


class GridBuilder:
    """Adds scans to a map one by one. Memory follows the mapped area, not the number of scans.

    Cell borders lie on whole multiples of the resolution, so that maps from several builders
    share one raster.
    """

    def __init__(self, settings: GridSettings) -> None:
        self._settings = settings
        self._bounds = _Bounds(0, 0, 0, 0)
        # What some scan has reached; the rest of the bounds is room to grow.
        self._reached = self._bounds
        self._log_odds: FloatArray = np.empty((0, 0))
        self._updated_in_scan = np.empty((0, 0), dtype=np.int32)
        self._scans = 0

    def add_scan(
        self, pose: FloatArray, angles_rad: FloatArray, ranges_m: FloatArray, range_max_m: float
    ) -> None:
        """Add one scan.

        ``pose``: (3,) x, y, yaw of T_map_lidar. ``angles_rad``, ``ranges_m``: (N,), NaN where
        missing: such a beam adds nothing, since unknown is not free. A range beyond
        ``range_max_m`` frees the cells up to there and hits none.

        Raises MappingFailed where the map would exceed ``cells_max``.
        """
        if angles_rad.shape != ranges_m.shape or ranges_m.ndim != 1:
            raise ValueError(
                f"angles and ranges must be (N,), got {angles_rad.shape}, {ranges_m.shape}"
            )
        if not np.isfinite(pose).all():
            raise ValueError(f"pose must be finite, got {pose}")
        valid = ranges_m > 0.0
        if not valid.any():
            return
        azimuths_rad = angles_rad[valid] + pose[2]
        directions = np.stack([np.cos(azimuths_rad), np.sin(azimuths_rad)], axis=1)
        reached_m = np.minimum(ranges_m[valid], range_max_m)
        resolution_m = self._settings.resolution_m
        origin = np.ascontiguousarray(pose[:2] / resolution_m, dtype=np.float64)
        ends = (pose[:2] + reached_m[:, np.newaxis] * directions) / resolution_m
        self._make_room(np.vstack([origin[np.newaxis], ends]))
        self._scans += 1
        update_cells(
            self._log_odds,
            self._updated_in_scan,
            self._bounds.first_row,
            self._bounds.first_column,
            self._scans,
            origin,
            ends,
            ranges_m[valid] <= range_max_m,
            _log_odds(self._settings.p_hit),
            _log_odds(self._settings.p_miss),
            _log_odds(self._settings.p_lowest),
            _log_odds(self._settings.p_highest),
        )

    def build(self) -> OccupancyGrid:
        """The map so far, cut to the known cells.

        Raises MappingFailed where no beam has reached it.
        """
        rows, columns = np.nonzero(np.isfinite(self._log_odds))
        if rows.size == 0:
            raise MappingFailed("no cell of the map is known: no scan has a valid beam.")
        known = (
            slice(int(rows.min()), int(rows.max()) + 1),
            slice(int(columns.min()), int(columns.max()) + 1),
        )
        resolution_m = self._settings.resolution_m
        return OccupancyGrid(
            resolution_m=resolution_m,
            origin_m=(
                (self._bounds.first_column + known[1].start) * resolution_m,
                (self._bounds.first_row + known[0].start) * resolution_m,
            ),
            log_odds=self._log_odds[known].copy(),
        )

    def _make_room(self, points: FloatArray) -> None:
        """Grow the map to hold (N, 2) points x, y in cell units."""
        lowest, highest = points.min(axis=0), points.max(axis=0)
        # In floats first: a wild pose must not overflow an integer.
        if not float(np.prod(highest - lowest + 1.0)) <= self._settings.cells_max or (
            float(np.abs(points).max()) > np.iinfo(np.int32).max
        ):
            raise self._too_large(lowest, highest)
        first: IntArray = np.floor(lowest).astype(np.int64)
        end: IntArray = np.floor(highest).astype(np.int64) + 1
        before, reached = self._bounds, self._reached
        needed = _Bounds(int(first[1]), int(first[0]), int(end[1]), int(end[0]))
        if self._scans > 0:
            needed = needed.union(reached)
        if needed.size > self._settings.cells_max:
            raise self._too_large(lowest, highest)
        self._reached = needed
        if self._scans > 0 and needed.union(before) == before:
            return
        wider = (needed.padded(share) for share in _PADDINGS)
        bounds = next((b for b in wider if b.size <= self._settings.cells_max), needed)
        log_odds = np.full(bounds.shape, np.nan)
        updated_in_scan = np.zeros(bounds.shape, dtype=np.int32)
        if self._scans > 0:
            kept, own = reached.part_of(bounds), reached.part_of(before)
            log_odds[kept] = self._log_odds[own]
            updated_in_scan[kept] = self._updated_in_scan[own]
        self._bounds, self._log_odds, self._updated_in_scan = bounds, log_odds, updated_in_scan

    def _too_large(self, lowest: FloatArray, highest: FloatArray) -> MappingFailed:
        x_m, y_m = (
            f"{low:.4g} to {high:.4g} m"
            for low, high in zip(
                lowest * self._settings.resolution_m,
                highest * self._settings.resolution_m,
                strict=True,
            )
        )
        return MappingFailed(
            f"a scan at x {x_m}, y {y_m} makes the map larger than {self._settings.cells_max} "
            f"cells of {self._settings.resolution_m} m.",
            advice="Check the poses, or set a coarser resolution_m or a larger cells_max.",
        )
