"""An occupancy grid from planar scans at known poses."""

import numpy as np

from fusion_core.mapping.growing_grid import CellBounds, GrowingGrid, LogOddsUpdate, log_odds
from fusion_core.mapping.height_bands import BeamHeights
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.polar import points_from_polar
from fusion_core.settings import StageSettings, setting

# Memory: a cell takes 12 bytes (float64, int32), and three grids may exist at once: 2.3 GB.
_CELLS_MAX = 64_000_000


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


# Hornung et al. 2013; Fu 2024 (8) leaves the increments to OctoMap.
OCTOMAP = GridSettings(p_hit=0.7, p_miss=0.4, p_lowest=0.1192, p_highest=0.971)


class GridBuilder:
    """Adds scans to a map one by one. Memory follows the mapped area, not the number of scans.

    Cell borders lie on whole multiples of the resolution, so that maps from several builders
    share one raster.
    """

    def __init__(self, settings: GridSettings) -> None:
        self._settings = settings
        update = LogOddsUpdate(
            hit=log_odds(settings.p_hit),
            miss=log_odds(settings.p_miss),
            lowest=log_odds(settings.p_lowest),
            highest=log_odds(settings.p_highest),
        )
        self._grid = GrowingGrid(update, cells_max=settings.cells_max)

    def add_scan(
        self,
        pose: FloatArray,
        angles_rad: FloatArray,
        ranges_m: FloatArray,
        range_max_m: float,
        heights: BeamHeights | None = None,
    ) -> None:
        """Add one scan.

        ``pose``: (3,) x, y, yaw of T_map_lidar. ``angles_rad``, ``ranges_m``: (N,), NaN where
        missing: such a beam adds nothing, since unknown is not free. A range beyond
        ``range_max_m`` frees the cells up to there and hits none. ``heights``: of the N beams of a
        camera, which then frees no cell for what it does not look at, and hits the surfaces behind.

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
        reached_m = np.minimum(ranges_m[valid], range_max_m)
        origin = np.ascontiguousarray(pose[:2] / self._settings.resolution_m, dtype=np.float64)
        ends = self._ends_of(pose, angles_rad[valid], reached_m)
        is_hit = ranges_m[valid] <= range_max_m
        if heights is None:
            self._grid.reserve(self._bounds_of(np.vstack([origin[np.newaxis], ends])))
            self._grid.add_scan(origin, ends, is_hit)
            return
        further = heights.behind_m <= range_max_m
        behind = self._ends_of(
            pose, np.broadcast_to(angles_rad, further.shape)[further], heights.behind_m[further]
        )
        self._grid.reserve(self._bounds_of(np.vstack([origin[np.newaxis], ends, behind])))
        self._grid.add_scan_with_heights(
            origin,
            ends,
            is_hit,
            heights.of(valid),
            behind,
            heights.behind_surfaces_m[further],
            self._settings.resolution_m,
        )

    def mark_unconfirmed(
        self, pose: FloatArray, angles_rad: FloatArray, ranges_m: FloatArray
    ) -> None:
        """Mark the cells of returns, of which nobody knows whether something is there.

        Cells that are unknown so far become undecided (log odds of 0), the rest stay; no cell is
        cleared. Arguments as in ``add_scan``.

        Raises MappingFailed where the map would exceed ``cells_max``.
        """
        valid = ranges_m > 0.0
        if not valid.any():
            return
        ends = self._ends_of(pose, angles_rad[valid], ranges_m[valid])
        self._grid.reserve(self._bounds_of(ends))
        self._grid.mark_undecided(ends)

    def _ends_of(
        self, pose: FloatArray, angles_rad: FloatArray, ranges_m: FloatArray
    ) -> FloatArray:
        """(n, 2) ends of the beams in cells."""
        along_m = points_from_polar(ranges_m, angles_rad + pose[2])
        ends: FloatArray = (pose[:2] + along_m) / self._settings.resolution_m
        return ends

    def build(self) -> OccupancyGrid:
        """The map so far, cut to the known cells.

        Raises MappingFailed where no beam has reached it.
        """
        grid = self._grid
        rows, columns = np.nonzero(np.isfinite(grid.log_odds))
        if rows.size == 0:
            raise MappingFailed("no cell of the map is known: no scan has a valid beam.")
        known = (
            slice(int(rows.min()), int(rows.max()) + 1),
            slice(int(columns.min()), int(columns.max()) + 1),
        )
        resolution_m = self._settings.resolution_m
        first_column, first_row = grid.bounds.low.tolist()
        return OccupancyGrid(
            resolution_m=resolution_m,
            origin_m=(
                (first_column + known[1].start) * resolution_m,
                (first_row + known[0].start) * resolution_m,
            ),
            log_odds=grid.log_odds[known].copy(),
        )

    def _bounds_of(self, points: FloatArray) -> CellBounds:
        """The cells of (N, 2) points x, y in cell units, if the map may grow so far."""
        lowest, highest = points.min(axis=0), points.max(axis=0)
        cells_max = self._settings.cells_max
        # In floats first: a wild pose must not overflow an integer.
        if not float(np.prod(highest - lowest + 1.0)) <= cells_max or (
            float(np.abs(points).max()) > np.iinfo(np.int32).max
        ):
            raise self._too_large(lowest, highest)
        bounds = CellBounds(
            np.floor(lowest).astype(np.int64), np.floor(highest).astype(np.int64) + 1
        )
        reached = self._grid.reached
        if (bounds if reached is None else bounds.union(reached)).size > cells_max:
            raise self._too_large(lowest, highest)
        return bounds

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
