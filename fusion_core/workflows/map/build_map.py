"""Motion, SLAM and a map of a recording (Li 2022; Fu 2024, its Cartographer side)."""

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.exporting.figures_slam import write_effective_particles, write_trajectory_figure
from fusion_core.exporting.g2o import write_g2o
from fusion_core.exporting.output_folder import plan_output, results_folder
from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.files.atomic import write_text
from fusion_core.model.errors import MappingFailed, MissingStream, SettingsError
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.slam_view import SlamObserver, no_observer
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.topics import Streams
from fusion_core.workflows.fuse.figures import printable
from fusion_core.workflows.fuse.settings import PresetName
from fusion_core.workflows.map.estimators import PlacedScans, SlamKind, place_scans
from fusion_core.workflows.map.extrinsics import find_extrinsics
from fusion_core.workflows.map.motion_prior import MotionKind, choose_map_streams, open_motion_prior
from fusion_core.workflows.map.occupancy_maps import (
    CameraBeams,
    build_maps,
    overlay_camera_map,
    write_maps,
)
from fusion_core.workflows.map.report import MapSummary, build_report
from fusion_core.workflows.map.scan_source import LidarScans, ScanKind, ScanSource, open_scans
from fusion_core.workflows.map.settings import MapSettings, map_settings, map_settings_toml
from fusion_core.workflows.map.write_odometry import write_odometry
from fusion_core.workflows.recorded_poses import recorded_poses
from fusion_core.workflows.source import RoomChoice, input_files, open_source

_TRUSTED_FRACTION_MIN = 0.5
_REPORT_NAME = "report.json"


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """What a person asks of a run.

    ``scan``: what goes in. ``motion``: the prior of SLAM, or all there is without it. ``seed``: of
    the particle filter, over the settings. ``clock_offset_ms``: camera stamp - LiDAR stamp of the
    same instant, taken out.
    """

    scan: ScanKind = "lidar"
    motion: MotionKind = "recorded"
    slam: SlamKind = "pose-graph"
    preset: PresetName = "default"
    settings_file: Path | None = None
    seed: int | None = None
    extrinsics_file: Path | None = None
    clock_offset_ms: float = 0.0
    room: RoomChoice | None = None
    lidar_topic: str | None = None
    pose_topic: str | None = None
    force: bool = False
    overwrite: bool = False

    @property
    def choices(self) -> dict[str, str]:
        """What decides the kind of result, by name."""
        return {"scan": self.scan, "motion": self.motion, "slam": self.slam}

    @property
    def has_virtual_scans(self) -> bool:
        """Whether the scans are cut from depth images."""
        return self.scan in ("camera", "merged")

    @property
    def needs_extrinsics(self) -> bool:
        """Whether it matters where the cameras stand."""
        return self.has_virtual_scans or self.motion in ("visual", "fused")


def build_map(
    recording: Path,
    output: Path,
    options: MapOptions,
    progress: Progress = silent,
    observer: SlamObserver = no_observer,
) -> MapSummary:
    """Trajectory and maps of a recording into a folder of results.

    Raises ScanLoomError: RecordingError and MissingStream for the input, SettingsError, ExportError
    for the folder, MappingFailed where no scan can be placed, or where more than half cannot be
    trusted, or were left out; of these the results are written all the same.
    """
    if options.slam == "none" and options.motion == "none":
        raise MissingStream(
            "without SLAM and without motion there are no poses.",
            file=recording,
            advice="Choose a --slam, or a --motion.",
        )
    if options.extrinsics_file is not None and not options.needs_extrinsics:
        raise SettingsError(
            f"--scan {options.scan} with --motion {options.motion} takes no extrinsics.",
            file=options.extrinsics_file,
            advice="Leave --extrinsics out, or use --scan merged or camera, or --motion visual.",
        )
    preset, settings = map_settings(options.preset, options.settings_file, options.seed)
    settings_text = map_settings_toml(settings, preset)
    with open_source(recording, options.room) as opened:
        plan = plan_output(
            output,
            command="map",
            inputs=[*input_files(opened), *_given(options)],
            also_read=[recording, options.settings_file],
            settings_text=settings_text + _identity(options),
            seed=settings.particles.seed,
            force=options.force,
            overwrite=options.overwrite,
            progress=progress,
        )
        if plan.is_done:
            summary = _skipped(output)
        else:
            with results_folder(plan) as folder:
                summary = _run(
                    opened, output, folder, options, settings, settings_text, progress, observer
                )
    if summary.report["trusted_share"] < _TRUSTED_FRACTION_MIN:
        raise _untrusted(summary.report, output)
    return summary


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


def _given(options: MapOptions) -> list[Path]:
    return [] if options.extrinsics_file is None else [options.extrinsics_file]


def _identity(options: MapOptions) -> str:
    """What was asked beyond the settings, as part of what makes two runs the same."""
    identity: dict[str, str | None] = {
        **options.choices,
        "lidar": options.lidar_topic,
        "pose": options.pose_topic,
        "clock_offset_ms": repr(options.clock_offset_ms),
    }
    if options.room is not None:
        identity["room"] = str(options.room)
    return json.dumps(identity)


def _skipped(output: Path) -> MapSummary:
    report = json.loads((output / _REPORT_NAME).read_text(encoding="utf-8"))
    return MapSummary(output=output, is_skipped=True, report=report, seconds={})


def _run(
    recording: Recording,
    output: Path,
    folder: Path,
    options: MapOptions,
    settings: MapSettings,
    settings_text: str,
    progress: Progress,
    observer: SlamObserver,
) -> MapSummary:
    start_s = time.perf_counter()
    streams = choose_map_streams(recording, options.lidar_topic, options.pose_topic)
    sources = _Sources(recording, streams, options, settings, progress)
    motion = sources.motion
    seconds = {"motion": time.perf_counter() - start_s}
    placed = place_scans(
        sources.scans, motion.at if motion else None, options.slam, settings, progress, observer
    )
    seconds.update(placed.seconds)
    start_s = time.perf_counter()
    reach_m = settings.submaps.max_range_m
    grids, no_maps = build_maps(sources.drawn, placed, settings.grid, reach_m, progress)
    if sources.has_layers:
        grids = overlay_camera_map(grids)
    notes = [*sources.notes, *placed.notes, *no_maps]
    report = build_report(
        placed, sources.scans.recorded_count, options.choices, notes, recording.warnings
    )
    heading = printable(recording.path.resolve().name)
    write_maps(folder, grids, heading)
    _write_way(folder, placed, grids.get(options.scan), heading)
    if motion is not None:
        write_odometry(folder, motion)
    write_text(folder / "settings.toml", settings_text)
    write_text(folder / _REPORT_NAME, json.dumps(report, indent=2, allow_nan=False) + "\n")
    seconds["maps"] = time.perf_counter() - start_s
    return MapSummary(output=output, is_skipped=False, report=report, seconds=seconds)


class _Sources:
    """The scans to place, their motion, and the scans to draw."""

    def __init__(
        self,
        recording: Recording,
        streams: Streams,
        options: MapOptions,
        settings: MapSettings,
        progress: Progress,
    ) -> None:
        self._streams = streams
        lidar = LidarScans(recording, streams) if streams.lidar is not None else None
        # A pass over the odometry, which virtual scans alone need.
        recorded = None
        if options.has_virtual_scans and lidar is not None:
            recorded = recorded_poses(recording, streams, lidar.frame_id)
        placed_cameras = None
        if options.has_virtual_scans or options.extrinsics_file is not None:
            placed_cameras = find_extrinsics(
                recording, streams, settings, file=options.extrinsics_file, progress=progress
            )
        self.scans = open_scans(
            recording,
            streams,
            options.scan,
            settings.virtual_scan,
            chain=settings,
            cameras=placed_cameras,
            motion=recorded.at if recorded else None,
            clock_offset_ms=options.clock_offset_ms,
            progress=progress,
        )
        self.motion = open_motion_prior(
            recording,
            streams,
            self.scans,
            options.motion,
            settings,
            progress,
            extrinsics=placed_cameras,
            clock_offset_ms=options.clock_offset_ms,
        )
        self.drawn: dict[str, ScanSource] = {options.scan: self.scans}
        self.has_layers = options.scan == "merged" and settings.virtual_scan.layers
        if self.has_layers:
            self.drawn = {options.scan: CameraBeams(self.scans)}
        if lidar is not None and options.scan != "lidar":
            self.drawn = {"lidar": lidar, **self.drawn}

    @property
    def notes(self) -> list[str]:
        """For people, complete once the scans were read."""
        if self.motion is None:
            motion = ["Without odometry the length of a bare corridor is a guess."]
        else:
            motion = [f"Motion from {self.motion.source}.", *self.motion.notes]
        return [*self._streams.notes, *motion, *self.scans.notes]


def _write_way(folder: Path, placed: PlacedScans, grid: OccupancyGrid | None, heading: str) -> None:
    """The trajectory, the estimator's own results, and their figures."""
    stamps_ns, poses = placed.stamps_ns, placed.poses_map_scan
    write_tum_trajectory(folder / "trajectory.tum", Trajectory.from_planar(stamps_ns, poses))
    loops_m = np.zeros((0, 4))
    if placed.graph is not None:
        graph = placed.graph.graph
        write_g2o(folder / "graph.g2o", graph)
        ends = (graph.first[graph.is_loop], graph.second[graph.is_loop])
        loops_m = np.hstack([graph.poses_map_node[end, :2] for end in ends])
    write_trajectory_figure(
        folder / "trajectory.png", heading, grid, poses, placed.trusted, loops_m
    )
    if placed.particles is not None:
        result = placed.particles
        write_effective_particles(
            folder / "effective.png",
            heading,
            stamps_ns[result.key],
            result.effective,
            result.resampled,
            result.weights.size,
        )
