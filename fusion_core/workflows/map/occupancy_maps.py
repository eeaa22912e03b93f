"""Occupancy grids of a recording from scans that were placed: the scans that SLAM took, and the
LiDAR's own beside them, so that both can be compared on one raster (Xu Fig. 9, Li Fig. 8)."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from fusion_core.exporting import figures_maps
from fusion_core.exporting.map_picture import write_difference_picture
from fusion_core.mapping.canvas import merge_keeping_obstacles
from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.geometry import interpolate_pose
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.sensor_maps import difference_of, write_map
from fusion_core.workflows.map.estimators import PlacedScans
from fusion_core.workflows.map.scan_source import ScanSource

# Between poses farther apart than this nobody knows where a scan was.
_POSE_GAP_MAX_NS = NS_PER_S


def build_maps(
    sources: Mapping[str, ScanSource],
    placed: PlacedScans,
    settings: GridSettings,
    range_max_m: float,
    progress: Progress,
) -> tuple[dict[str, OccupancyGrid], list[str]]:
    """A grid of each source of scans, by name, and why any is missing or coarser than was asked.

    ``reach_m``: a far beam that strays would make a map of the whole range, so that points beyond
    only free the cells up to there.
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
    """The set side of a cell, doubled until all that can be reached from (N, 3) poses has room."""
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
            assert scan.intensities is not None, "merged scans say what the camera met"
            seen = np.where(scan.intensities > 0.0, scan.ranges_m, np.nan)
            yield scan.with_ranges(seen, scan.intensities)


def overlay_camera_map(grids: dict[str, OccupancyGrid]) -> dict[str, OccupancyGrid]:
    """The merged map, drawn of what the camera met alone, over that of the LiDAR's plane."""
    if "lidar" not in grids or "merged" not in grids:
        return grids
    return {**grids, "merged": merge_keeping_obstacles(grids["lidar"], grids["merged"])}


def write_maps(folder: Path, grids: Mapping[str, OccupancyGrid], heading: str) -> None:
    """Each map for robots and for people; where there are two, both side by side and their
    difference."""
    for name, grid in grids.items():
        write_map(folder, f"map_{name}", grid)
    difference = difference_of(grids)
    if difference is not None:
        write_difference_picture(folder / "map_difference.png", difference)
        figures_maps.write_maps(folder / "maps.png", heading, grids, difference)


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
        pose = pose_of_placed(placed, scan.stamp_ns)
        if pose is not None:
            builder.add_scan(
                pose, scan.angles_rad, scan.ranges_m, min(scan.range_max_m, range_max_m)
            )
    return builder.build()


def pose_of_placed(placed: PlacedScans, stamp_ns: int) -> FloatArray | None:
    """(3,) the pose at an instant, between its two neighbours; None outside and in gaps."""
    stamps_ns, poses = placed.stamps_ns, placed.poses_map_scan
    after = int(np.searchsorted(stamps_ns, stamp_ns))
    if after < stamps_ns.size and stamps_ns[after] == stamp_ns:
        exact: FloatArray = poses[after]
        return exact
    if after in (0, stamps_ns.size):
        return None
    gap_ns = int(stamps_ns[after] - stamps_ns[after - 1])
    if gap_ns > _POSE_GAP_MAX_NS:
        return None
    share = (stamp_ns - int(stamps_ns[after - 1])) / gap_ns
    return interpolate_pose(poses[after - 1], poses[after], share)
