"""Submaps: small occupancy grids, each from a run of consecutive key scans (Hess et al. 2016, IV).

Two grow at a time, the younger begun when the older is half full, so that neighbours overlap and
no scan is matched against an empty map. All lie in the local frame, in which scans are placed as
they arrive; a finished one is cut to what it knows and never changes.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from fusion_core.compiled import compiled
from fusion_core.mapping.rays import update_cells
from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray, read_only
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.scan_to_grid import FULL

# As far as an interpolation feels a cell, so that the grid's end shows in none.
_BORDER = 3
# Cells that a grid is larger than what it holds, so that it need not grow with each scan; a large
# one, where growing takes long, by a share.
_ROOM, _ROOM_SHARE = 60, 0.25
# Of a scan's reach: a grid of twice that on a side, at 13 bytes a cell, takes 0.8 GB.
_RANGE_CELLS_MAX = 4_000


class SubmapSettings(StageSettings):
    """Submaps. Hits and misses are weaker than a final map's, so that one scan decides nothing."""

    resolution_m: float = setting(0.05, "Side of a cell", unit="m", ge=0.01, le=1.0)
    key_scans: int = setting(60, "Key scans in a submap", ge=4, le=1000)
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
    """Raises ValueError where a scan reaches over more cells than a grid may be large."""
    # A hundredth of a cell: what rounding adds to a whole number of them is none.
    if max_range_m / resolution_m > _RANGE_CELLS_MAX + 0.01:
        raise ValueError(
            f"max_range_m = {max_range_m:g} over resolution_m = {resolution_m:g} is "
            f"{max_range_m / resolution_m:.0f} cells, more than {_RANGE_CELLS_MAX}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Submap:
    """A finished submap: of key scans ``first`` to ``end``, the latter not included.

    ``occupancy``: (rows, columns) uint8 as ``scan_to_grid`` takes it, in the local frame.
    ``corner_m``: (x, y) of the outer corner of its cell (0, 0).
    """

    first: int
    end: int
    occupancy: ByteArray
    corner_m: tuple[float, float]
    resolution_m: float

    def __post_init__(self) -> None:
        read_only(self.occupancy)

    def obstacles_m(self) -> FloatArray:
        """(n, 2) middles, in the local frame, of the cells that are rather occupied than free."""
        rows, columns = np.nonzero(self.occupancy > FULL / 2.0)
        cells = np.stack([columns, rows], axis=1) + 0.5
        middles_m: FloatArray = np.array(self.corner_m) + self.resolution_m * cells
        return middles_m


class GrowingSubmap:
    """A submap that takes scans; its grid grows with what they meet."""

    def __init__(self, centre_m: FloatArray, first: int, travel_m: float, settings: SubmapSettings):
        """``centre_m``: (2,); points are taken up to ``travel_m`` and their reach from there."""
        self._settings = settings
        self._hit, self._miss = _log_odds(settings.p_hit), _log_odds(settings.p_miss)
        self._limit = _log_odds(settings.p_limit)
        self.first = first
        self.scans = 0
        # All (column, row). Beyond these limits nothing is taken.
        half = int(np.ceil((settings.max_range_m + travel_m) / settings.resolution_m))
        self._limits = np.floor(centre_m / settings.resolution_m) + np.array([[-half], [half]])
        # The cells met so far, the last not included; and the first one of the grid.
        self._met: tuple[IntArray, IntArray] | None = None
        self._corner: IntArray = np.zeros(2, dtype=np.int64)
        self._log_odds = np.empty((0, 0))
        self._updated_in_scan = np.empty((0, 0), dtype=np.int32)
        self.occupancy: ByteArray = np.empty((0, 0), dtype=np.uint8)

    @property
    def corner_m(self) -> tuple[float, float]:
        """(x, y) of the outer corner of cell (0, 0) in the local frame."""
        column, row = self._corner.tolist()
        return column * self._settings.resolution_m, row * self._settings.resolution_m

    def add_scan(self, pose_local_scan: FloatArray, points_m: FloatArray) -> None:
        """Add the points (n, 2) of a scan and the ways to them; what lies too far is left out."""
        self.scans += 1
        ends = transform_planar_points(pose_local_scan, points_m) / self._settings.resolution_m
        origin = pose_local_scan[:2] / self._settings.resolution_m
        ends = np.ascontiguousarray(ends[self._is_near(ends)])
        if ends.size == 0 or not self._is_near(origin):
            return
        low = np.floor(np.minimum(ends.min(axis=0), origin)).astype(np.int64)
        high = np.floor(np.maximum(ends.max(axis=0), origin)).astype(np.int64) + 1
        self._make_room(low, high)
        update_cells(
            self._log_odds,
            self._updated_in_scan,
            int(self._corner[1]),
            int(self._corner[0]),
            self.scans,
            origin,
            ends,
            np.ones(ends.shape[0], dtype=np.bool_),
            self._hit,
            self._miss,
            -self._limit,
            self._limit,
        )
        part = _part(low - self._corner, high - self._corner)
        _refresh(
            self.occupancy[part], self._log_odds[part], self._updated_in_scan[part], self.scans
        )

    def finish(self, end: int) -> Submap:
        """Cut to the cells that some scan met."""
        # No scan had a point: a submap of one free cell matches nothing, as it should.
        low, occupancy = self._corner, np.zeros((1, 1), dtype=np.uint8)
        if self._met is not None:
            low, high = self._met
            occupancy = self.occupancy[_part(low - self._corner, high - self._corner)].copy()
        column, row = low.tolist()
        resolution_m = self._settings.resolution_m
        return Submap(
            first=self.first,
            end=end,
            occupancy=occupancy,
            corner_m=(column * resolution_m, row * resolution_m),
            resolution_m=resolution_m,
        )

    def _is_near(self, places: FloatArray) -> BoolArray:
        near: BoolArray = ((places >= self._limits[0]) & (places < self._limits[1])).all(axis=-1)
        return near

    def _make_room(self, low: IntArray, high: IntArray) -> None:
        """Have the cells from ``low`` to ``high``, the latter not included, and some about them."""
        before = self._met
        if before is not None:
            low, high = np.minimum(low, before[0]), np.maximum(high, before[1])
        self._met = low, high
        end = self._corner + np.array(self.occupancy.shape[::-1])
        if ((low >= self._corner + _BORDER) & (high <= end - _BORDER)).all():
            return
        room = np.maximum(_ROOM, (_ROOM_SHARE * (high - low)).astype(np.int64))
        corner = low - room
        columns, rows = (high + room - corner).tolist()
        occupancy = np.zeros((rows, columns), dtype=np.uint8)
        log_odds = np.full((rows, columns), np.nan)
        updated_in_scan = np.zeros((rows, columns), dtype=np.int32)
        if before is not None:
            old = _part(before[0] - self._corner, before[1] - self._corner)
            new = _part(before[0] - corner, before[1] - corner)
            occupancy[new] = self.occupancy[old]
            log_odds[new] = self._log_odds[old]
            updated_in_scan[new] = self._updated_in_scan[old]
        self._corner, self.occupancy = corner, occupancy
        self._log_odds, self._updated_in_scan = log_odds, updated_in_scan


def _part(begin: IntArray, end: IntArray) -> tuple[slice, slice]:
    """Rows and columns of a grid from a (column, row) to another, the latter not included."""
    return slice(int(begin[1]), int(end[1])), slice(int(begin[0]), int(end[0]))


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1.0 - probability)))


@compiled()
def _refresh(
    occupancy: ByteArray, log_odds: FloatArray, updated_in_scan: npt.NDArray[np.int32], scan: int
) -> None:
    """The probability of each cell that the scan has changed."""
    rows, columns = occupancy.shape
    for r in range(rows):
        for c in range(columns):
            if updated_in_scan[r, c] == scan:
                occupancy[r, c] = int(FULL / (1.0 + np.exp(-log_odds[r, c])) + 0.5)
