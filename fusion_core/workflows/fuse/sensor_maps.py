"""LiDAR-only, camera-only and fused maps of one recording, from the same poses (Xu Fig. 9).

In the fused map a return that neither the camera nor the scans before and after confirm, nor a
person, clears no ray: its cell alone is marked, as not confirmed.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.exporting.map_picture import write_difference_picture, write_grid_picture
from fusion_core.exporting.ros_map import write_ros_map
from fusion_core.mapping.confirmation import PlacedScan, confirmed_fraction
from fusion_core.mapping.difference import compare_maps
from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import MapDifference, OccupancyGrid
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.frame_result import FrameResult
from fusion_core.workflows.fuse.scan_queue import ranges_without_burrs_m
from fusion_core.workflows.recorded_poses import PoseLookup

# 99 % of the differences between two ranges of one surface: 2.5 of their standard deviations.
_SAME_RETURN_SIGMA = 2.5 * np.sqrt(2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Confirmation:
    """What confirms a return: at least ``least`` of the beams that other scans point at it, to
    within the noise of ``scale``."""

    scale: NoiseScale
    least: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _RepairedScan:
    """A raw scan at its pose, the ranges (N,) to trust of it, and which of them the camera or a
    person has confirmed."""

    raw: PlacedScan
    trusted_m: FloatArray
    is_confirmed: BoolArray


class SensorMaps:
    """Three grids that grow with the mapped area only.

    A range longer than the side of the largest map is in none of them. A grid that would grow
    larger than that is given up, and the others go on. Without a ``confirmation`` every return of
    a repaired scan is in the fused map.
    """

    def __init__(
        self, poses: PoseLookup, settings: GridSettings, confirmation: Confirmation | None
    ) -> None:
        self._confirmation = confirmation
        # By identity: some drivers give two scans one stamp.
        self._confirmed: dict[int, BoolArray] = {}
        self._recent: deque[_RepairedScan] = deque(maxlen=3)
        self._poses = poses
        self._side_max_m = settings.side_max_m
        self._far = dict.fromkeys(("lidar", "camera", "fused"), 0)
        self._failed: dict[str, str] = {}
        self._builders = {name: GridBuilder(settings) for name in ("lidar", "camera", "fused")}
        self.scans_without_pose = 0

    def add_camera(self, scan: LaserScan, result: FrameResult) -> None:
        """Add the camera's ranges in the LiDAR's plane. Their ``scan`` must be added later."""
        of_scan = self._confirmed.setdefault(id(scan), np.zeros(scan.ranges_m.size, dtype=np.bool_))
        of_scan[result.beam[result.is_confirmed]] = True
        pose = self._poses.at(scan.stamp_ns)
        if pose is not None:
            self._add("camera", pose, result.azimuth_rad, result.camera_range_m, scan)

    def add_scan(self, raw: LaserScan, repaired: LaserScan) -> None:
        """Add a scan, raw to the LiDAR's map and repaired to the fused one; scans come in order."""
        pose = self._poses.at(raw.stamp_ns)
        nothing = np.zeros(raw.ranges_m.size, dtype=np.bool_)
        is_confirmed = self._confirmed.pop(id(raw), nothing)
        if pose is None:
            self.scans_without_pose += 1
            return
        self._add("lidar", pose, raw.angles_rad, raw.ranges_m, raw)
        self._recent.append(
            _RepairedScan(
                raw=PlacedScan(pose=pose, scan=raw),
                trusted_m=ranges_without_burrs_m(raw, repaired),
                is_confirmed=is_confirmed,
            )
        )
        if len(self._recent) == 2:
            self._fuse(self._recent[0], [self._recent[1]])
        elif len(self._recent) == 3:
            self._fuse(self._recent[1], [self._recent[0], self._recent[2]])

    def _fuse_last(self) -> None:
        if self._recent:
            *before, last = self._recent
            self._fuse(last, before[-1:])
            self._recent.clear()

    def _fuse(self, repaired: _RepairedScan, others: list[_RepairedScan]) -> None:
        """Add a repaired scan to the fused map. ``others``: the scans before and after."""
        placed, trusted_m = repaired.raw, self._without_far("fused", repaired.trusted_m)
        pose, scan = placed.pose, placed.scan
        unconfirmed_m = None
        if self._confirmation is not None and others:
            # What was repaired is confirmed already.
            alone = (trusted_m == scan.ranges_m) & ~repaired.is_confirmed
            tolerance_m = _SAME_RETURN_SIGMA * self._confirmation.scale.sigma_at(scan.ranges_m)
            fraction = confirmed_fraction(placed, [other.raw for other in others], tolerance_m)
            alone &= fraction < self._confirmation.least
            unconfirmed_m = np.where(alone & (scan.ranges_m <= scan.range_max_m), trusted_m, np.nan)
            trusted_m = np.where(alone, np.nan, trusted_m)
        self._add("fused", pose, scan.angles_rad, trusted_m, scan)
        if unconfirmed_m is not None:
            self._mark_unconfirmed(pose, scan.angles_rad, unconfirmed_m)

    def _mark_unconfirmed(self, pose: FloatArray, angles: FloatArray, ranges: FloatArray) -> None:
        if "fused" in self._failed:
            return
        try:
            self._builders["fused"].mark_unconfirmed(pose, angles, ranges)
        except MappingFailed as error:
            self._failed["fused"] = str(error)

    def _add(
        self, name: str, pose: FloatArray, angles: FloatArray, ranges: FloatArray, scan: LaserScan
    ) -> None:
        if name in self._failed:
            return
        ranges = self._without_far(name, ranges)
        try:
            self._builders[name].add_scan(
                pose, np.ascontiguousarray(angles), np.ascontiguousarray(ranges), scan.range_max_m
            )
        except MappingFailed as error:
            self._failed[name] = str(error)

    def _without_far(self, name: str, ranges_m: FloatArray) -> FloatArray:
        """(B,) without those that no map can hold, which are counted."""
        far = ranges_m > self._side_max_m
        self._far[name] += int(np.count_nonzero(far))
        return np.where(far, np.nan, ranges_m)

    def write(self, folder: Path) -> tuple[dict[str, OccupancyGrid], list[str]]:
        """Write each map that has a known cell, and the difference of all; returns the maps and
        why any is missing. Nothing can be added after that."""
        self._fuse_last()
        grids: dict[str, OccupancyGrid] = {}
        notes = []
        for name in list(self._builders):
            if self._far[name]:
                notes.append(
                    f"{self._far[name]} ranges are not in the {name} map: they are longer than "
                    f"{self._side_max_m:g} m, the side of the largest (grid.cells_max)."
                )
            if name in self._failed:
                notes.append(f"No {name} map: {self._failed[name]}")
                continue
            try:
                # Popped one by one to free their memory: a builder is larger than its map.
                grids[name] = self._builders.pop(name).build()
            except MappingFailed as error:
                notes.append(f"No {name} map: {error.problem}")
                continue
            write_map(folder, f"map_{name}", grids[name])
        difference = difference_of(grids)
        if difference is not None:
            write_difference_picture(folder / "map_difference.png", difference)
        return grids, notes


def write_map(folder: Path, name: str, grid: OccupancyGrid) -> None:
    """``name.pgm`` and ``name.yaml`` for robots, ``name.png`` for people."""
    write_ros_map(folder, name, grid)
    write_grid_picture(folder / f"{name}.png", grid)


def difference_of(grids: Mapping[str, OccupancyGrid]) -> MapDifference | None:
    """Where the maps of a recording differ, None where there are not two."""
    return compare_maps(grids) if len(grids) > 1 else None
