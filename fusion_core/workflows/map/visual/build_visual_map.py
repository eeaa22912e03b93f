"""``scanloom map --slam visual``: the path of an RGB-D camera and the map that it sees."""

import json
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.files.atomic import write_text
from fusion_core.freed_memory import give_freed_memory_back
from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.errors import MappingFailed, SettingsError
from fusion_core.model.progress import Progress
from fusion_core.model.recording import Recording
from fusion_core.model.visual_slam_view import VisualSlamObserver
from fusion_core.recordings.topics import Streams, choose_streams
from fusion_core.slam.submaps import SubmapSettings
from fusion_core.slam.visual.visual_slam import visual_slam
from fusion_core.workflows.fuse.figures import printable
from fusion_core.workflows.map.extrinsics import find_extrinsics
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.rgbd_frames import RgbdFrames, first_camera_extrinsics
from fusion_core.workflows.map.settings import MapSettings
from fusion_core.workflows.map.visual.color_registration import register_colors
from fusion_core.workflows.map.visual.keyframe_views import KeyframeViews
from fusion_core.workflows.map.visual.lidar_map import (
    draw_lidar_map,
    require_fusible,
    write_lidar_map,
)
from fusion_core.workflows.map.visual.map_frame import level_map_frame
from fusion_core.workflows.map.visual.report import build_visual_report
from fusion_core.workflows.map.visual.settings import VisualMapSettings
from fusion_core.workflows.map.visual.write_visual_map import write_trajectories, write_visual_map
from fusion_core.workflows.map.volumes import write_volumes

REPORT_NAME = "report.json"


def map_visually(
    folder: Path,
    recording: Recording,
    options: MapOptions,
    settings: VisualMapSettings,
    progress: Progress,
    observer: VisualSlamObserver,
) -> tuple[dict[str, Any], dict[str, float]]:
    """Map a recording into an empty folder: its report, and the seconds of each stage.

    Raises MissingStream where colour, depth or intrinsics lack, MappingFailed where no image can
    start a map.
    """
    streams = choose_streams(recording, lidar=options.lidar_topic)
    _require_lidar_options(recording, streams, options)
    recorded = RgbdFrames(
        recording,
        streams,
        clock_offset_ns=round(options.clock_offset_ms * NS_PER_MS),
        purpose="Visual SLAM",
    )
    extrinsics = None
    if options.extrinsics_file is not None:
        extrinsics = find_extrinsics(
            recording, streams, MapSettings(), file=options.extrinsics_file, progress=progress
        )
    T_lidar_camera, mount_notes = first_camera_extrinsics(recording, streams, extrinsics)
    require_fusible(recording, streams, options, T_lidar_camera)

    # Colour that shows what depth does.
    start_s = time.perf_counter()
    frames = register_colors(recorded, recorded.intrinsics, settings, progress)
    registration_s = time.perf_counter() - start_s

    # The path of the camera, with its keyframes and landmarks.
    one_thread = options.workers == 1
    with nullcontext() if one_thread else ThreadPoolExecutor(1) as executor:
        result = visual_slam(
            frames,
            frames.intrinsics,
            settings,
            progress,
            observer,
            executor=executor,
            image_count=recorded.image_count,
        )
    # Adjusting the whole map takes several times the memory of what is kept.
    give_freed_memory_back()
    seconds = {"color": registration_s, **result.seconds}

    # Level, with the floor at z = 0.
    start_s = time.perf_counter()
    keyframes = result.visual_map.kept_keyframes
    stamps_ns = np.array([keyframe.stamp_ns for keyframe in keyframes], np.int64)
    T_first_keyframe = np.stack([keyframe.T_map_camera for keyframe in keyframes])
    views = KeyframeViews(frames.at, stamps_ns, T_first_keyframe)
    progress(0, None, "looking for the floor")
    map_frame = level_map_frame(views, frames.intrinsics, T_lidar_camera)
    seconds["floor"] = time.perf_counter() - start_s

    # The results as files.
    start_s = time.perf_counter()
    write_trajectories(folder, result, map_frame.T_map_first, T_lidar_camera)
    write_visual_map(folder / "visual_map.npz", result.visual_map, map_frame.T_map_first)
    seconds["results"] = time.perf_counter() - start_s

    # Cloud, surface, octree and grid of the keyframes' images at their final poses.
    start_s = time.perf_counter()
    views = KeyframeViews(frames.at, stamps_ns, map_frame.T_map_first @ T_first_keyframe)
    volumes: dict[str, Any] = {}
    camera_grid = None
    try:
        written = write_volumes(
            folder,
            views,
            frames.intrinsics,
            settings,
            progress,
            floor_height_m=0.0 if map_frame.is_floor_known else None,
        )
        volumes, volume_notes = written.to_report(), written.notes
        camera_grid = written.grid
    except MappingFailed as error:
        # The path is worth keeping where depth is too poor for a map.
        volume_notes = (f"No maps in space: {error}",)

    # The LiDAR's own map along the same path, and what both sensors know together.
    fusion: Mapping[str, Any] = {}
    lidar_notes: list[str] = []
    if streams.lidar is not None and T_lidar_camera is not None:
        grid_settings = settings.grid
        if camera_grid is not None:
            # Two grids are compared cell by cell.
            resolution = {"resolution_m": camera_grid.resolution_m}
            grid_settings = grid_settings.model_copy(update=resolution)
        lidar_grid, lidar_notes = draw_lidar_map(
            recording,
            streams,
            result,
            map_frame.T_map_first,
            T_lidar_camera,
            grid_settings,
            SubmapSettings().max_range_m,
            progress,
        )
        if lidar_grid is not None:
            heading = f"{printable(recording.path.resolve().name)}, SLAM visual"
            fusion, fusion_notes = write_lidar_map(
                folder, lidar_grid, camera_grid, options, settings, heading
            )
            lidar_notes += fusion_notes
    seconds["maps"] = time.perf_counter() - start_s
    notes = [
        *streams.notes,
        *recorded.notes,
        *frames.notes,
        *mount_notes,
        *_lidar_note(streams, T_lidar_camera is not None),
        *map_frame.notes,
        *volume_notes,
        *lidar_notes,
        *result.notes,
        *recording.warnings,
    ]
    report = build_visual_report(result, options.choices, notes) | {
        "color_zoom": frames.zoom,
        "volumes": volumes,
        **fusion,
    }
    write_text(folder / REPORT_NAME, json.dumps(report, indent=2, allow_nan=False) + "\n")
    return report, seconds


def _require_lidar_options(recording: Recording, streams: Streams, options: MapOptions) -> None:
    """Raise SettingsError for what relates the camera to a LiDAR that is not there."""
    if streams.lidar is not None:
        return
    for name, is_given in (
        ("--extrinsics", options.extrinsics_file is not None),
        ("--clock-offset-ms", options.clock_offset_ms != 0.0),
    ):
        if is_given:
            raise SettingsError(
                f"{name} relates the camera to a LiDAR, and there is none.",
                file=recording.path,
                advice="Leave it out.",
            )


def _lidar_note(streams: Streams, is_mounted: bool) -> tuple[str, ...]:
    if streams.lidar is None or is_mounted:
        return ()
    return (
        f"trajectory.tum is the camera's: nothing tells where it stands on {streams.lidar}. "
        "--extrinsics FILE does.",
    )


def untracked(report: dict[str, Any], output: Path) -> MappingFailed:
    """The error for a run in which most images have no pose."""
    return MappingFailed(
        f"only {report['images_tracked']} of {report['images']} images have a pose.",
        file=output,
        advice="report.json says when and why tracking was lost: too little texture or depth, too "
        "fast a motion, or images left out.",
    )
