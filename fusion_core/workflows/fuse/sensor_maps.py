"""LiDAR-only, camera-only and fused maps of one recording, from the same poses (Xu Fig. 9)."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fusion_core.exporting.map_picture import write_difference_picture, write_grid_picture
from fusion_core.exporting.ros_map import write_ros_map
from fusion_core.mapping.difference import compare_maps
from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import MapDifference, OccupancyGrid
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.scan_queue import ranges_without_burrs_m
from fusion_core.workflows.recorded_poses import PoseLookup


class SensorMaps:
    """Three grids that grow with the mapped area only.

    A range longer than the side of the largest map is in none of them. A grid that would grow
    larger than that is given up, and the others go on.
    """

    def __init__(self, poses: PoseLookup, settings: GridSettings) -> None:
        self._poses = poses
        self._side_max_m = settings.side_max_m
        self._far = dict.fromkeys(("lidar", "camera", "fused"), 0)
        self._failed: dict[str, str] = {}
        self._builders = {name: GridBuilder(settings) for name in ("lidar", "camera", "fused")}
        self.scans_without_pose = 0

    def add_camera(self, frame: FusedFrame) -> None:
        """Add the camera's ranges in the LiDAR's plane."""
        pose = self._poses.at(frame.match.scan.stamp_ns)
        if pose is not None:
            self._add(
                "camera",
                pose,
                frame.match.correspondence.azimuth_rad,
                frame.match.correspondence.camera_range_m,
                frame.match.scan,
            )

    def add_scan(self, raw: LaserScan, repaired: LaserScan) -> None:
        """Add a scan, raw to the LiDAR's map and repaired to the fused one."""
        pose = self._poses.at(raw.stamp_ns)
        if pose is None:
            self.scans_without_pose += 1
            return
        self._add("lidar", pose, raw.angles_rad, raw.ranges_m, raw)
        trusted_m = ranges_without_burrs_m(raw, repaired)
        self._add("fused", pose, repaired.angles_rad, trusted_m, raw)

    def _add(
        self, name: str, pose: FloatArray, angles: FloatArray, ranges: FloatArray, scan: LaserScan
    ) -> None:
        if name in self._failed:
            return
        far = ranges > self._side_max_m
        if far.any():
            self._far[name] += int(np.count_nonzero(far))
            ranges = np.where(far, np.nan, ranges)
        try:
            self._builders[name].add_scan(
                pose, np.ascontiguousarray(angles), np.ascontiguousarray(ranges), scan.range_max_m
            )
        except MappingFailed as error:
            self._failed[name] = str(error)

    def write(self, folder: Path) -> tuple[dict[str, OccupancyGrid], list[str]]:
        """Write each map that has a known cell, and the difference of all; returns the maps and
        why any is missing. Nothing can be added after that."""
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
