"""Occupancy grids from placed scans: of the scans that SLAM used, and of the LiDAR's own beside
them, so that both can be compared on one raster (Xu Fig. 9, Li Fig. 8)."""

from collections.abc import Iterator, Mapping

import numpy as np

from fusion_core.mapping.bayes import fuse_grids_by
from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.mapping.height_bands import VirtualScan
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.map.estimators import PlacedScans
from fusion_core.workflows.map.scan_source import ScanSource


def build_maps(
    sources: Mapping[str, ScanSource],
    placed: PlacedScans,
    settings: GridSettings,
    range_max_m: float,
    progress: Progress,
) -> tuple[dict[str, OccupancyGrid], list[str]]:
    """A grid of each source of scans, by name, and notes on missing or coarser maps.

    ``range_max_m``: farther points only free the cells up to it, so that a stray far beam does not
    enlarge the map.
    """
    grids: dict[str, OccupancyGrid] = {}
    notes = []
    resolution_m = _affordable_resolution_m(placed.poses_map_scan, settings, range_max_m)
    if resolution_m > settings.resolution_m:
        notes.append(
            f"Cells of {resolution_m:g} m and not {settings.resolution_m:g} m: finer ones could be "
            f"more than {settings.cells_max} (grid.cells_max)."
        )
        settings = settings.model_copy(update={"resolution_m": resolution_m})
    for name, scans in sources.items():
        try:
            grids[name] = _build_map(scans, placed, settings, range_max_m, progress)
        except MappingFailed as error:
            # The trajectory is worth keeping where only the raster is too large.
            notes.append(f"No {name} map: {error}")
    return grids, notes


def _affordable_resolution_m(
    poses_map_scan: FloatArray, settings: GridSettings, range_max_m: float
) -> float:
    """The configured cell size, doubled until a map of all within range of the (N, 3) poses is not
    larger than ``cells_max``."""
    sides_m = np.ptp(poses_map_scan[:, :2], axis=0) + 2.0 * range_max_m
    too_many = float(sides_m.prod()) / settings.resolution_m**2 / settings.cells_max
    doublings = int(np.ceil(0.5 * np.log2(too_many))) if too_many > 1.0 else 0
    return float(settings.resolution_m * 2**doublings)


class CameraBeams:
    """Of merged scans only the beams in whose angle the camera met something."""

    def __init__(self, merged: ScanSource) -> None:
        self._merged = merged
        self.frame_id = merged.frame_id
        self.recorded_count = merged.recorded_count

    @property
    def notes(self) -> tuple[str, ...]:
        return self._merged.notes

    def __iter__(self) -> Iterator[LaserScan]:
        for scan in self._merged:
            assert scan.intensities is not None, "merged scans mark the beams that the camera met"
            seen = np.where(scan.intensities > 0.0, scan.ranges_m, np.nan)
            yield scan.with_ranges(seen, scan.intensities)


def overlay_camera_map(grids: dict[str, OccupancyGrid]) -> dict[str, OccupancyGrid]:
    """The map of the camera's beams ("merged") laid over that of the LiDAR's plane by Table 3.

    Where the LiDAR measured what the camera saw, both maps have the LiDAR's range: the states of
    Table 3 may share it, the sum of (10) may not.
    """
    if "lidar" not in grids or "merged" not in grids:
        return grids
    layers = {name: grids[name] for name in ("lidar", "merged")}
    return {**grids, "merged": fuse_grids_by("table", layers)}


def _build_map(
    scans: ScanSource,
    placed: PlacedScans,
    settings: GridSettings,
    range_max_m: float,
    progress: Progress,
) -> OccupancyGrid:
    builder = GridBuilder(settings)
    for done, scan in enumerate(scans):
        progress(done, None, "drawing the map")
        pose = placed.pose_at(scan.stamp_ns)
        if pose is not None:
            heights = scan.heights if isinstance(scan, VirtualScan) else None
            reach_m = min(scan.range_max_m, range_max_m)
            builder.add_scan(pose, scan.angles_rad, scan.ranges_m, reach_m, heights)
    return builder.build()
