"""The LiDAR's own map beside that of visual SLAM, and the fusion of the two.

The scans are drawn along the camera's path and not along one of their own: both grids then lie in
one frame, and their misalignment shows what the mount, the clocks and the two sensors' ranges
leave, without the difference of two estimates of the path. They share no beam, as (10) asks.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.mapping.grid import GridSettings
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import MissingStream
from fusion_core.model.geometry import invert_transform, planar_from_transform
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress
from fusion_core.model.recording import Recording
from fusion_core.recordings.topics import Streams
from fusion_core.slam.visual.visual_slam import VisualSlamResult
from fusion_core.workflows.fuse.sensor_maps import write_map
from fusion_core.workflows.map.estimators import PlacedScans
from fusion_core.workflows.map.grid_fusion import (
    fuse_named_grids,
    fusion_notes,
    fusion_report,
    require_two_sensors,
    write_fusion,
)
from fusion_core.workflows.map.occupancy_maps import build_maps
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.scan_source import LidarScans
from fusion_core.workflows.map.visual.settings import VisualMapSettings


def require_fusible(
    recording: Recording, streams: Streams, options: MapOptions, T_lidar_camera: FloatArray | None
) -> None:
    """Raise MissingStream for a fusion without a LiDAR, or where nothing tells its mount."""
    if options.fusion == "none":
        return
    require_two_sensors(recording, streams, options.fusion)
    if T_lidar_camera is None:
        raise MissingStream(
            f"does not tell where the camera stands on the LiDAR: --fusion {options.fusion} takes "
            "the maps of both.",
            file=recording.path,
            advice="Give --extrinsics FILE, or use --fusion none.",
        )


def draw_lidar_map(
    recording: Recording,
    streams: Streams,
    result: VisualSlamResult,
    T_map_first: FloatArray,
    T_lidar_camera: FloatArray,
    settings: GridSettings,
    range_max_m: float,
    progress: Progress,
) -> tuple[OccupancyGrid | None, list[str]]:
    """The scans' grid along the path of the images, and notes on it.

    ``T_map_first``: (4, 4) see ``MapFrame``. Scans in gaps between images of more than a second
    are left out. None where no scan has a pose.
    """
    tracked = result.is_tracked
    T_map_lidar = T_map_first @ result.T_map_camera[tracked] @ invert_transform(T_lidar_camera)
    placed = PlacedScans(
        stamps_ns=result.stamps_ns[tracked],
        poses_map_scan=planar_from_transform(T_map_lidar),
        trusted=np.ones(np.count_nonzero(tracked), dtype=np.bool_),
        seconds={},
    )
    scans = LidarScans(recording, streams)
    grids, notes = build_maps({"lidar": scans}, placed, settings, range_max_m, progress)
    return grids.get("lidar"), [*scans.notes, *notes]


def write_lidar_map(
    folder: Path,
    lidar: OccupancyGrid,
    camera: OccupancyGrid | None,
    options: MapOptions,
    settings: VisualMapSettings,
    heading: str,
) -> tuple[Mapping[str, Any], list[str]]:
    """``map_lidar``, and ``map_fused`` with its evidence where a fusion is asked for: the entries
    of report.json, and notes."""
    write_map(folder, "map_lidar", lidar)
    if options.fusion == "none" or camera is None:
        return {}, []
    fused = fuse_named_grids(
        {"lidar": lidar, "camera": camera}, options.fusion, settings.grid_fusion
    )
    write_map(folder, "map_fused", fused.result)
    write_fusion(folder, fused, f"{heading}, fusion {options.fusion}")
    return {"grid_fusion": fusion_report(fused)}, fusion_notes(fused)
