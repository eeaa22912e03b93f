"""``scanloom map``: motion, SLAM and maps of a recording (Li 2022; Fu 2024, Cartographer side)."""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fusion_core.exporting.output_folder import RunRequest, plan_output, results_folder
from fusion_core.files.atomic import write_text
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.slam_view import SlamObserver, no_observer
from fusion_core.model.visual_slam_view import VisualSlamObserver, unobserved
from fusion_core.worker_processes import WorkerPool
from fusion_core.workflows.fuse.figures import printable
from fusion_core.workflows.map.estimators import place_scans
from fusion_core.workflows.map.grid_fusion import (
    FusedGrids,
    fuse_named_grids,
    fusion_notes,
    fusion_report,
    write_fusion,
)
from fusion_core.workflows.map.map_input import open_map_input
from fusion_core.workflows.map.occupancy_maps import build_maps, overlay_camera_map
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.report import MapSummary, build_report
from fusion_core.workflows.map.settings import MapSettings, map_settings, map_settings_toml
from fusion_core.workflows.map.visual.build_visual_map import map_visually, untracked
from fusion_core.workflows.map.visual.report import VisualMapSummary
from fusion_core.workflows.map.visual.settings import (
    visual_map_settings,
    visual_map_settings_toml,
)
from fusion_core.workflows.map.write_odometry import write_odometry
from fusion_core.workflows.map.write_results import write_maps, write_trajectory
from fusion_core.workflows.source import input_files, open_source

# The majority of the scans must fit the map, or it is more likely wrong than right.
_TRUSTED_FRACTION_MIN = 0.5
_REPORT_NAME = "report.json"


def build_map(
    recording: Path,
    output: Path,
    options: MapOptions,
    progress: Progress = silent,
    observer: SlamObserver = no_observer,
    visual_observer: VisualSlamObserver = unobserved,
) -> MapSummary:
    """Trajectory and maps of a recording into a folder of results.

    Raises ScanLoomError: RecordingError and MissingStream for the input, SettingsError, ExportError
    for the folder, MappingFailed where no scan can be placed, or where fewer than half of the scans
    are trusted (of the images, by visual SLAM); in the last case the results are written all the
    same. ``observer`` sees scans placed, ``visual_observer`` images.
    """
    options.require_consistent(recording)
    if options.is_visual:
        return _build_visual_map(recording, output, options, progress, visual_observer)
    preset, settings = map_settings(options.preset, options.settings_file, options.seed)
    settings_text = map_settings_toml(settings, preset)
    extrinsics = [] if options.extrinsics_file is None else [options.extrinsics_file]
    with open_source(recording, options.room) as opened:
        request = RunRequest(
            command="map",
            inputs=[*input_files(opened), *extrinsics],
            also_read=[recording, options.settings_file],
            settings_text=settings_text + options.identity(),
            seed=settings.particles.seed,
            labels=options.labels,
        )
        plan = plan_output(
            output, request, force=options.force, overwrite=options.overwrite, progress=progress
        )
        if plan.is_done:
            report = json.loads((output / _REPORT_NAME).read_text(encoding="utf-8"))
            seconds: dict[str, float] = {}
        else:
            with results_folder(plan) as folder, WorkerPool(options.workers) as pool:
                report, seconds = _map_into(
                    folder, opened, options, settings, pool, progress, observer
                )
                write_text(folder / "settings.toml", settings_text)
    if report["trusted_share"] < _TRUSTED_FRACTION_MIN:
        raise _untrusted(report, output)
    _require_fusion(report, options, output)
    return MapSummary(output=output, is_skipped=plan.is_done, report=report, seconds=seconds)


def _require_fusion(report: Mapping[str, Any], options: MapOptions, output: Path) -> None:
    if options.fusion != "none" and "grid_fusion" not in report:
        raise MappingFailed(
            f"--fusion {options.fusion} needs two grids, and one of them could not be drawn.",
            file=output,
            advice="The notes in report.json say why.",
        )


def _build_visual_map(
    recording: Path,
    output: Path,
    options: MapOptions,
    progress: Progress,
    observer: VisualSlamObserver,
) -> MapSummary:
    settings = visual_map_settings(options.settings_file)
    settings_text = visual_map_settings_toml(settings)
    extrinsics = [] if options.extrinsics_file is None else [options.extrinsics_file]
    with open_source(recording, options.room) as opened:
        request = RunRequest(
            command="map",
            inputs=[*input_files(opened), *extrinsics],
            also_read=[recording, options.settings_file],
            settings_text=settings_text + options.identity(),
            seed=0,
        )
        plan = plan_output(
            output, request, force=options.force, overwrite=options.overwrite, progress=progress
        )
        seconds: dict[str, float] = {}
        if plan.is_done:
            report = json.loads((output / _REPORT_NAME).read_text(encoding="utf-8"))
        else:
            with results_folder(plan) as folder:
                report, seconds = map_visually(
                    folder, opened, options, settings, progress, observer
                )
                write_text(folder / "settings.toml", settings_text)
    if report["trusted_share"] < _TRUSTED_FRACTION_MIN:
        raise untracked(report, output)
    _require_fusion(report, options, output)
    return VisualMapSummary(output=output, is_skipped=plan.is_done, report=report, seconds=seconds)


def _map_into(
    folder: Path,
    recording: Recording,
    options: MapOptions,
    settings: MapSettings,
    pool: WorkerPool,
    progress: Progress,
    observer: SlamObserver,
) -> tuple[dict[str, Any], dict[str, float]]:
    """Map a recording into an empty folder: its report, and the seconds of each stage."""
    # The scans, and the odometry that predicts them.
    start_s = time.perf_counter()
    inputs = open_map_input(recording, options, settings, pool, progress)
    prior = None if inputs.motion is None else inputs.motion.at
    seconds = {"motion": time.perf_counter() - start_s}

    # SLAM: a pose in the map for each scan.
    assert options.slam != "visual", "visual SLAM places images"
    placed = place_scans(
        inputs.scans,
        prior,
        options.slam,
        settings,
        progress,
        observer,
        () if inputs.motion is None else inputs.motion.independent,
    )
    seconds.update(placed.seconds)

    # Occupancy grids from the placed scans.
    start_s = time.perf_counter()
    range_max_m = settings.submaps.max_range_m
    grids, map_notes = build_maps(inputs.drawn, placed, settings.grid, range_max_m, progress)
    if inputs.has_camera_layer:
        grids = overlay_camera_map(grids)
    fused = _fuse_maps(grids, options, settings)
    if fused is not None:
        grids = {**grids, "fused": fused.result}
        map_notes = [*map_notes, *fusion_notes(fused)]

    # The results as files.
    notes = [*inputs.notes, *placed.notes, *map_notes, *recording.warnings]
    report = build_report(placed, inputs.scans.recorded_count, options.choices, notes)
    heading = (
        f"{printable(recording.path.resolve().name)}, preset {options.preset}\n"
        f"SLAM {options.slam}, scan {options.scan}, motion {options.motion}"
    )
    if fused is not None:
        report |= {"grid_fusion": fusion_report(fused)}
        heading += f", fusion {options.fusion}"
        write_fusion(folder, fused, heading)
    write_maps(folder, grids, heading)
    write_trajectory(folder, placed, grids.get(options.shown_map), heading)
    if inputs.motion is not None:
        write_odometry(folder, inputs.motion)
    write_text(folder / _REPORT_NAME, json.dumps(report, indent=2, allow_nan=False) + "\n")
    seconds["maps"] = time.perf_counter() - start_s
    return report, seconds


def _fuse_maps(
    grids: Mapping[str, OccupancyGrid], options: MapOptions, settings: MapSettings
) -> FusedGrids | None:
    """The fusion of the two sensors' maps; None where none is asked for, or one map is missing."""
    if options.fusion == "none" or len(grids) < 2:
        return None
    return fuse_named_grids(grids, options.fusion, settings.grid_fusion)


def _untrusted(report: Mapping[str, Any], output: Path) -> MappingFailed:
    left_out = report["scans_recorded"] - report["scans"]
    if left_out > _TRUSTED_FRACTION_MIN * report["scans_recorded"]:
        return MappingFailed(
            f"{left_out} of {report['scans_recorded']} scans are left out of the map.",
            file=output,
            advice="The notes in report.json say why: check the clock that stamps them, and how "
            "long the --motion lasts.",
        )
    return MappingFailed(
        f"only {report['trusted_share']:.0%} of the scans fit the map.",
        file=output,
        advice="Look at the map and at report.json; give a --motion where there is one.",
    )
