"""Submaps: small occupancy grids, each from a run of consecutive key scans (Hess et al. 2016, IV).

Two grow at a time, the younger begun when the older is half full, so that neighbours overlap and
no scan is matched against an empty map. All lie in the local frame, in which scans are placed as
they arrive; a finished one is cut to what it knows and never changes.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from fusion_core.mapping.rays import update_cells
from fusion_core.model.conventions import ByteArray, FloatArray, read_only
from fusion_core.model.planar_poses import move_points
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.scan_to_grid import FULL


class SubmapSettings(StageSettings):
    """Submaps. Hits and misses are weaker than a final map's, so that one scan decides nothing."""

    resolution_m: float = setting(0.05, "Side of a cell", unit="m", ge=0.01, le=1.0)
    key_scans: int = setting(60, "Key scans in a submap", ge=4, le=1000)
    reach_m: float = setting(30.0, "Points farther away are not used", unit="m", ge=1.0, le=200.0)
    p_hit: float = setting(0.6, "Probability of occupied given a hit", gt=0.5, le=0.99)
    p_miss: float = setting(0.48, "Probability of occupied given a pass", ge=0.01, le=0.5)
    p_limit: float = setting(0.98, "Highest probability; lowest is 1 minus it", gt=0.5, le=0.999)


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
    """A submap that takes scans; its grid covers what its scans can reach."""

    def __init__(self, centre_m: FloatArray, first: int, travel_m: float, settings: SubmapSettings):
        """``centre_m``: (2,) where the first scan is; ``travel_m``: how far the last can be."""
        self._settings = settings
        self.first = first
        self.scans = 0
        resolution_m = settings.resolution_m
        half = int(np.ceil((settings.reach_m + travel_m) / resolution_m)) + 2
        self._column, self._row = (int(cell) for cell in np.floor(centre_m / resolution_m) - half)
        shape = (2 * half, 2 * half)
        self._log_odds = np.full(shape, np.nan)
        self._updated_in_scan = np.zeros(shape, dtype=np.int32)
        self.occupancy: ByteArray = np.zeros(shape, dtype=np.uint8)

    @property
    def corner_m(self) -> tuple[float, float]:
        """(x, y) of the outer corner of cell (0, 0) in the local frame."""
        resolution_m = self._settings.resolution_m
        return self._column * resolution_m, self._row * resolution_m

    def add_scan(self, pose_local_scan: FloatArray, points_m: FloatArray) -> None:
        """Add the points (n, 2) of a scan and the ways to them; what lies outside is left out."""
        settings = self._settings
        self.scans += 1
        ends = move_points(pose_local_scan, points_m) / settings.resolution_m
        corner = np.array([self._column, self._row])
        size = self.occupancy.shape[0]
        inside = ((ends >= corner) & (ends < corner + size)).all(axis=1)
        origin = pose_local_scan[:2] / settings.resolution_m
        if not inside.any() or not ((origin >= corner) & (origin < corner + size)).all():
            return
        ends = np.ascontiguousarray(ends[inside])
        update_cells(
            self._log_odds,
            self._updated_in_scan,
            self._row,
            self._column,
            self.scans,
            origin,
            ends,
            np.ones(ends.shape[0], dtype=np.bool_),
            _log_odds(settings.p_hit),
            _log_odds(settings.p_miss),
            _log_odds(1.0 - settings.p_limit),
            _log_odds(settings.p_limit),
        )
        touched = np.floor(np.vstack([origin[np.newaxis], ends]) - corner).astype(np.int64)
        low, high = touched.min(axis=0), touched.max(axis=0) + 1
        part = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
        _refresh(
            self.occupancy[part], self._log_odds[part], self._updated_in_scan[part], self.scans
        )

    def finish(self, end: int) -> Submap:
        """Cut to the cells that some scan met."""
        known = np.isfinite(self._log_odds)
        rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
        if rows.size == 0:
            # No scan had a point: a submap of one free cell matches nothing, as it should.
            rows, columns = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
        part = (
            slice(int(rows[0]), int(rows[-1]) + 1),
            slice(int(columns[0]), int(columns[-1]) + 1),
        )
        resolution_m = self._settings.resolution_m
        return Submap(
            first=self.first,
            end=end,
            occupancy=self.occupancy[part].copy(),
            corner_m=(
                (self._column + part[1].start) * resolution_m,
                (self._row + part[0].start) * resolution_m,
            ),
            resolution_m=resolution_m,
        )


def _log_odds(probability: float) -> float:
    return float(np.log(probability / (1.0 - probability)))


@njit(cache=True)
def _refresh(
    occupancy: ByteArray, log_odds: FloatArray, updated_in_scan: npt.NDArray[np.int32], scan: int
) -> None:
    """The probability of each cell that the scan has changed."""
    rows, columns = occupancy.shape
    for r in range(rows):
        for c in range(columns):
            if updated_in_scan[r, c] == scan:
                occupancy[r, c] = int(FULL / (1.0 + np.exp(-log_odds[r, c])) + 0.5)
