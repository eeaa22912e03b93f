"""Motion, SLAM and a map of a recording (Li 2022; Fu 2024, its Cartographer side)."""

import json
import time
from dataclasses import dataclass
from pathlib import Path

from fusion_core.exporting.atomic import write_text
from fusion_core.exporting.g2o import write_g2o
from fusion_core.exporting.manifest import OutputPlan, plan_output, results_folder
from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.mapping.grid import GridBuilder
from fusion_core.model.errors import MappingFailed, MissingStream
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.trajectory import Trajectory
from fusion_core.workflows.estimators import Placed, Slam, place
from fusion_core.workflows.map_report import MapSummary, report_of
from fusion_core.workflows.map_settings import MapSettings, map_settings, map_settings_toml
from fusion_core.workflows.maps import write_map
from fusion_core.workflows.motion_source import MotionKind, map_streams, recorded_motion
from fusion_core.workflows.scan_source import LidarScans, Scans
from fusion_core.workflows.source import RoomChoice, input_files, open_source

# Nothing here is drawn at random.
_SEED = 0
_TRUSTED_SHARE_MIN = 0.5
_REPORT_NAME = "report.json"


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """What a person asks of a run; ``motion`` is the prior of SLAM, or all there is without it."""

    slam: Slam = "pose-graph"
    motion: MotionKind = "recorded"
    settings_file: Path | None = None
    room: RoomChoice | None = None
    lidar_topic: str | None = None
    pose_topic: str | None = None
    force: bool = False
    overwrite: bool = False

    @property
    def asked(self) -> dict[str, str]:
        """What decides the kind of result, by name."""
        return {"slam": self.slam, "motion": self.motion}


def build_map(
    recording: Path, output: Path, options: MapOptions, progress: Progress = silent
) -> MapSummary:
    """Trajectory and map of a recording into a folder of results.

    Raises ScanLoomError: RecordingError and MissingStream for the input, SettingsError, ExportError
    for the folder, MappingFailed where no scan can be placed, or where more than half cannot be
    trusted; of these the results are written all the same.
    """
    if options.slam == "none" and options.motion == "none":
        raise MissingStream(
            "without SLAM and without motion there are no poses.",
            file=recording,
            advice="Choose --slam pose-graph, or a --motion.",
        )
    settings = map_settings(options.settings_file)
    settings_text = map_settings_toml(settings)
    with open_source(recording, options.room) as opened:
        plan = plan_output(
            output,
            inputs=input_files(opened),
            settings_text=settings_text + _identity(options),
            seed=_SEED,
            force=options.force,
            overwrite=options.overwrite,
            progress=progress,
        )
        if plan.skip:
            summary = _skipped(output)
        else:
            summary = _run(opened, plan, options, settings, settings_text, progress)
    if summary.report["trusted_share"] < _TRUSTED_SHARE_MIN:
        raise MappingFailed(
            f"only {summary.report['trusted_share']:.0%} of the scans fit the map.",
            file=output,
            advice="Look at the map and at report.json; give a --motion where there is one.",
        )
    return summary


def _identity(options: MapOptions) -> str:
    """What was asked beyond the settings, as part of what makes two runs the same."""
    identity: dict[str, str | None] = {
        "command": "map",
        **options.asked,
        "lidar": options.lidar_topic,
        "pose": options.pose_topic,
    }
    if options.room is not None:
        identity["room"] = str(options.room)
    return json.dumps(identity)


def _skipped(output: Path) -> MapSummary:
    report = json.loads((output / _REPORT_NAME).read_text(encoding="utf-8"))
    return MapSummary(output=output, skipped=True, report=report, seconds={})


def _run(
    recording: Recording,
    plan: OutputPlan,
    options: MapOptions,
    settings: MapSettings,
    settings_text: str,
    progress: Progress,
) -> MapSummary:
    start_s = time.perf_counter()
    streams = map_streams(recording, options.lidar_topic, options.pose_topic)
    scans = LidarScans(recording, streams)
    notes = list(streams.notes)
    motion = None
    if options.motion == "none":
        notes.append("Without odometry the length of a bare corridor is a guess.")
    else:
        motion = recorded_motion(
            recording, streams, scans.frame_id, wheel_only=options.motion == "wheel"
        )
        notes.append(f"Motion from {motion.source}.")
    seconds = {"motion": time.perf_counter() - start_s}
    placed = place(scans, motion, options.slam, settings, progress)
    seconds.update(placed.seconds)
    start_s = time.perf_counter()
    grid: OccupancyGrid | None = None
    try:
        grid = _grid(scans, placed, settings, progress)
    except MappingFailed as error:
        # The trajectory is worth keeping where only the raster is too large.
        notes.append(f"No map: {error}")
    with results_folder(plan) as folder:
        if grid is not None:
            write_map(folder, "map_lidar", grid)
        trajectory = Trajectory.from_planar(placed.stamps_ns, placed.poses_map_scan)
        write_tum_trajectory(folder / "trajectory.tum", trajectory)
        if placed.graph is not None:
            write_g2o(folder / "graph.g2o", placed.graph.graph)
        write_text(folder / "settings.toml", settings_text)
        seconds["map"] = time.perf_counter() - start_s
        report = report_of(placed, options.asked, [*notes, *scans.notes], recording.warnings)
        write_text(folder / _REPORT_NAME, json.dumps(report, indent=2, allow_nan=False) + "\n")
    return MapSummary(output=plan.folder, skipped=False, report=report, seconds=seconds)


def _grid(scans: Scans, placed: Placed, settings: MapSettings, progress: Progress) -> OccupancyGrid:
    builder = GridBuilder(settings.grid)
    # A far beam that strays would make a map of the whole range; SLAM uses none of them either.
    reach_m = settings.submaps.reach_m
    pose_of = dict(zip(placed.stamps_ns.tolist(), placed.poses_map_scan, strict=True))
    for done, scan in enumerate(scans):
        progress(done, len(pose_of), "drawing the map")
        pose = pose_of.get(scan.stamp_ns)
        if pose is not None:
            builder.add_scan(pose, scan.angles_rad, scan.ranges_m, min(scan.range_max_m, reach_m))
    return builder.build()
