"""Submaps: small occupancy grids, each from consecutive keyframes (Hess et al. 2016, IV.B).

Two grow at a time, the younger begun when the older is half full, so that neighbours overlap and
no scan is matched with an empty map. All lie in the local frame; a finished one is cut to the
cells that its scans reached, and never changes.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from fusion_core.compiled import compiled
from fusion_core.mapping.growing_grid import CellBounds, GrowingGrid, LogOddsUpdate, log_odds
from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, read_only
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.identifiers import NodeId
from fusion_core.slam.scan_to_grid import FULL, ProbabilityGrid

# Cells about the known ones, so that no interpolation there meets the grid's end: bicubic
# convolution reads two cells to either side, and one more is for rounding.
_BORDER = 3
# Memory: a grid of twice the range on a side, at 13 bytes a cell, takes 0.8 GB.
_RANGE_CELLS_MAX = 4_000


class SubmapSettings(StageSettings):
    """Submaps. Hits and passes weigh less than in a final map, so that it takes several scans."""

    resolution_m: float = setting(0.05, "Side of a cell", unit="m", ge=0.01, le=1.0)
    keyframes: int = setting(60, "Keyframes in a submap", ge=4, le=1000, formerly="key_scans")
    max_range_m: float = setting(
        30.0, "Points farther away are not used", unit="m", ge=1.0, le=200.0, formerly="reach_m"
    )
    p_hit: float = setting(0.6, "Probability of occupied given a hit", gt=0.5, le=0.99)
    p_miss: float = setting(0.48, "Probability of occupied given a pass", ge=0.01, le=0.5)
    p_limit: float = setting(0.98, "Highest probability; lowest is 1 minus it", gt=0.5, le=0.999)

    @model_validator(mode="after")
    def _bounded_cells(self) -> Self:
        check_grid_size(self.max_range_m, self.resolution_m)
        return self


def check_grid_size(max_range_m: float, resolution_m: float) -> None:
    """Raises ValueError where the range spans more cells than a grid may have."""
    # A tolerance of a hundredth of a cell, for rounding.
    if max_range_m / resolution_m > _RANGE_CELLS_MAX + 0.01:
        raise ValueError(
            f"max_range_m = {max_range_m:g} over resolution_m = {resolution_m:g} is "
            f"{max_range_m / resolution_m:.0f} cells, more than {_RANGE_CELLS_MAX}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Submap:
    """A finished submap of the keyframes from ``first`` to ``end``, the latter not included.

    ``grid``: in the local frame, its cells read-only.
    """

    first: NodeId
    end: NodeId
    grid: ProbabilityGrid

    def __post_init__(self) -> None:
        read_only(self.grid.cells)

    def obstacles_m(self) -> FloatArray:
        """(n, 2) centres, in the local frame, of the cells with a probability above one half."""
        rows, columns = np.nonzero(self.grid.cells > FULL / 2.0)
        cells = np.stack([columns, rows], axis=1) + 0.5
        centres_m: FloatArray = np.array(self.grid.corner_m) + self.grid.resolution_m * cells
        return centres_m


class GrowingSubmap:
    """A submap to which scans are added; its grid grows with them."""

    def __init__(
        self, centre_m: FloatArray, first: NodeId, travel_m: float, settings: SubmapSettings
    ):
        """``centre_m``: (2,); points farther than ``travel_m`` and a range from it are left out."""
        self.first = first
        self.scans = 0
        self._resolution_m = settings.resolution_m
        limit = log_odds(settings.p_limit)
        self._log_odds = GrowingGrid(
            LogOddsUpdate(
                hit=log_odds(settings.p_hit),
                miss=log_odds(settings.p_miss),
                lowest=-limit,
                highest=limit,
            ),
            border=_BORDER,
        )
        half = int(np.ceil((settings.max_range_m + travel_m) / settings.resolution_m))
        self._limits = np.floor(centre_m / settings.resolution_m) + np.array([[-half], [half]])
        self._cells: ByteArray = np.empty((0, 0), dtype=np.uint8)

    @property
    def grid(self) -> ProbabilityGrid:
        """As it is now, in the local frame, with cells that the next scan changes."""
        return ProbabilityGrid(
            self._cells, self._corner_m(self._log_odds.bounds), self._resolution_m
        )

    def add_scan(self, pose_local_scan: FloatArray, points_m: FloatArray) -> None:
        """Add the points (n, 2) of a scan and the rays to them, eq. 3; without those too far."""
        self.scans += 1
        ends = transform_planar_points(pose_local_scan, points_m) / self._resolution_m
        origin = pose_local_scan[:2] / self._resolution_m
        ends = np.ascontiguousarray(ends[self._is_within_limits(ends)])
        if ends.size == 0 or not self._is_within_limits(origin):
            return
        scan = CellBounds(
            np.floor(np.minimum(ends.min(axis=0), origin)).astype(np.int64),
            np.floor(np.maximum(ends.max(axis=0), origin)).astype(np.int64) + 1,
        )
        self._reserve(scan)
        self._log_odds.add_scan(origin, ends, np.ones(ends.shape[0], dtype=np.bool_))
        part = scan.slices_in(self._log_odds.bounds)
        _refresh_probabilities(
            self._cells[part],
            self._log_odds.log_odds[part],
            self._log_odds.updated_in_scan[part],
            self._log_odds.scans,
        )

    def finish(self, end: NodeId) -> Submap:
        """Crop the grid to the cells that some scan updated."""
        reached = self._log_odds.reached
        if reached is None:
            # No scan had a point: a submap of one free cell, which matches nothing.
            cells, corner_m = np.zeros((1, 1), dtype=np.uint8), (0.0, 0.0)
        else:
            cells = self._cells[reached.slices_in(self._log_odds.bounds)].copy()
            corner_m = self._corner_m(reached)
        grid = ProbabilityGrid(cells, corner_m, self._resolution_m)
        return Submap(first=self.first, end=end, grid=grid)

    def _corner_m(self, bounds: CellBounds) -> tuple[float, float]:
        column, row = bounds.low.tolist()
        return column * self._resolution_m, row * self._resolution_m

    def _is_within_limits(self, places: FloatArray) -> BoolArray:
        within: BoolArray = ((places >= self._limits[0]) & (places < self._limits[1])).all(axis=-1)
        return within

    def _reserve(self, scan: CellBounds) -> None:
        """Make log odds and probabilities cover a scan's cells."""
        reached, bounds = self._log_odds.reached, self._log_odds.bounds
        if not self._log_odds.reserve(scan):
            return
        cells = np.zeros(self._log_odds.log_odds.shape, dtype=np.uint8)
        if reached is not None:
            cells[reached.slices_in(self._log_odds.bounds)] = self._cells[reached.slices_in(bounds)]
        self._cells = cells


class ActiveSubmaps:
    """The growing submaps, the older one of which scans are matched with, and the finished ones."""

    def __init__(self, settings: SubmapSettings, keyframe_distance_m: float) -> None:
        self._settings = settings
        # A margin of one half: keyframes taken for their rotation add distance, too. Set by hand.
        self._travel_m = 1.5 * settings.keyframes * keyframe_distance_m
        self._growing: list[GrowingSubmap] = []
        self.finished: list[Submap] = []

    @property
    def matched(self) -> ProbabilityGrid | None:
        """The older submap's grid, None where there is no submap yet."""
        return self._growing[0].grid if self._growing else None

    def insert(self, node: NodeId, pose_local_scan: FloatArray, points_m: FloatArray) -> None:
        """Add a keyframe to the growing submaps, finish the older and begin a younger in time."""
        full = self._settings.keyframes
        if self._growing and self._growing[0].scans >= full:
            self.finished.append(self._growing.pop(0).finish(node))
        if not self._growing or (len(self._growing) == 1 and self._growing[0].scans >= full // 2):
            self._growing.append(
                GrowingSubmap(pose_local_scan[:2], node, self._travel_m, self._settings)
            )
        for submap in self._growing:
            submap.add_scan(pose_local_scan, points_m)

    def end_segment(self, node: NodeId) -> None:
        """Finish the growing submaps: keyframe ``node`` and those after it have others."""
        self.finished += [submap.finish(node) for submap in self._growing]
        self._growing = []

    def all_until(self, node: NodeId) -> tuple[Submap, ...]:
        """All submaps, of the keyframes before ``node``."""
        return (*self.finished, *(submap.finish(node) for submap in self._growing))


@compiled()
def _refresh_probabilities(
    cells: ByteArray, log_odds: FloatArray, updated_in_scan: npt.NDArray[np.int32], scan: int
) -> None:
    """The probability of each cell that the scan has changed."""
    rows, columns = cells.shape
    for r in range(rows):
        for c in range(columns):
            if updated_in_scan[r, c] == scan:
                cells[r, c] = int(FULL / (1.0 + np.exp(-log_odds[r, c])) + 0.5)
