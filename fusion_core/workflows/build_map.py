"""Motion, SLAM and a map of a recording with a planar LiDAR (Fu 2024, its Cartographer side)."""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fusion_core.exporting.atomic import write_text
from fusion_core.exporting.g2o import write_g2o
from fusion_core.exporting.manifest import OutputPlan, plan_output, results_folder
from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.mapping.grid import GridBuilder
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray
from fusion_core.model.errors import MappingFailed, MissingStream
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import LaserScan
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.topics import Streams, choose_streams
from fusion_core.slam.pose_graph_slam import SlamResult, pose_graph_slam
from fusion_core.workflows.map_settings import MapSettings, map_settings, map_settings_toml
from fusion_core.workflows.maps import write_map
from fusion_core.workflows.poses import Poses, recorded_poses
from fusion_core.workflows.source import RoomChoice, input_files, open_source

Slam = Literal["none", "pose-graph"]
Motion = Literal["recorded", "wheel", "none"]

# Nothing here is drawn at random.
_SEED = 0
_TRUSTED_SHARE_MIN = 0.5
_REPORT_NAME = "report.json"


@dataclass(frozen=True, kw_only=True)
class MapOptions:
    """What a person asks of a run; ``motion`` is the prior of SLAM, or all there is without it."""

    slam: Slam = "pose-graph"
    motion: Motion = "recorded"
    settings_file: Path | None = None
    room: RoomChoice | None = None
    lidar_topic: str | None = None
    pose_topic: str | None = None
    force: bool = False
    overwrite: bool = False


@dataclass(frozen=True, kw_only=True)
class MapSummary:
    """What a run has to report: report.json's content, and the seconds of its stages.

    The seconds stand in no file, since they alone differ from run to run; a skipped run has none.
    """

    output: Path
    skipped: bool
    report: dict[str, Any]
    seconds: Mapping[str, float]

    def to_json(self) -> dict[str, Any]:
        """One machine-readable result."""
        return {
            "output": str(self.output),
            "skipped": self.skipped,
            **self.report,
            "seconds": dict(self.seconds),
        }

    def lines(self) -> list[str]:
        """The same for people."""
        report = self.report
        lines = [
            f"scans      {report['scans']} of {report['duration_s']:.1f} s, "
            f"{report['path_m']:.1f} m of way",
        ]
        if "loops" in report:
            lines.append(
                f"graph      {report['key_scans']} key scans, {report['edges']} edges, "
                f"{report['loops']} loops ({report['loops_dropped']} dropped)"
            )
        for stretch in report["untrusted"]:
            lines.append(
                f"untrusted  {stretch['from_s']:.3f} s to {stretch['to_s']:.3f} s: "
                f"{stretch['scans']} scans do not fit"
            )
        lines += [f"time       {name} {value:.1f} s" for name, value in self.seconds.items()]
        lines += [f"note       {note}" for note in report["notes"]]
        if self.skipped:
            lines.append("Nothing was done, the results were there already (--force redoes).")
        return [*lines, f"results    {self.output}"]


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
            settings_text=settings_text + _asked(options),
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


def _asked(options: MapOptions) -> str:
    """What was asked beyond the settings, as part of what makes two runs the same."""
    asked = {
        "command": "map",
        "slam": options.slam,
        "motion": options.motion,
        "lidar": options.lidar_topic,
        "pose": options.pose_topic,
    }
    if options.room is not None:
        asked["room"] = str(options.room)
    return json.dumps(asked)


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
    streams = _streams(recording, options)
    scans = _Scans(recording, streams)
    poses = _motion(recording, streams, scans.frame_id, options.motion)
    notes = list(streams.notes)
    if poses is not None:
        notes.append(f"Motion from {poses.source}.")
    else:
        notes.append("Without odometry the length of a bare corridor is a guess.")
    seconds = {"motion": time.perf_counter() - start_s}
    result: SlamResult | None = None
    if options.slam == "pose-graph":
        result = pose_graph_slam(scans, poses.at if poses else None, settings, progress)
        seconds.update(result.seconds)
        placed = _Placed(result.stamps_ns, result.poses_map_scan, result.trusted)
    else:
        assert poses is not None
        placed = _placed_by_motion(scans, poses)
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
        if result is not None:
            write_g2o(folder / "graph.g2o", result.graph)
        write_text(folder / "settings.toml", settings_text)
        seconds["map"] = time.perf_counter() - start_s
        if scans.out_of_order:
            notes.append(f"{scans.out_of_order} scans out of order in time are left out.")
        report = _report(placed, result, options, [*notes, *recording.warnings])
        write_text(folder / _REPORT_NAME, json.dumps(report, indent=2, allow_nan=False) + "\n")
    return MapSummary(output=plan.folder, skipped=False, report=report, seconds=seconds)


def _streams(recording: Recording, options: MapOptions) -> Streams:
    """As always, but with the LiDAR's own odometry where there is one: written with each scan, it
    has the scan's very stamp, while another topic's must be interpolated."""
    streams = choose_streams(recording, lidar=options.lidar_topic, pose=options.pose_topic)
    own = f"{streams.lidar}/odom"
    if not any(topic.name == own and topic.role == "odometry" for topic in recording.topics):
        return streams
    return choose_streams(
        recording, lidar=options.lidar_topic, pose=options.pose_topic, odometry=own
    )


class _Scans:
    """The scans of a recording with stamps that increase, any number of times."""

    def __init__(self, recording: Recording, streams: Streams) -> None:
        if streams.lidar is None:
            raise MissingStream(
                "holds no LaserScan.",
                file=recording.path,
                advice="scanloom info lists what it holds.",
            )
        self._recording, self._topic = recording, streams.lidar
        self.out_of_order = 0
        first = next(iter(self), None)
        if first is None:
            raise MissingStream(f"{streams.lidar} holds no scan.", file=recording.path)
        self.frame_id = first.frame_id

    def __iter__(self) -> Iterator[LaserScan]:
        last_ns: int | None = None
        self.out_of_order = 0
        for message in self._recording.messages([self._topic]):
            if not isinstance(message.value, LaserScan):
                continue
            if last_ns is not None and message.value.stamp_ns <= last_ns:
                self.out_of_order += 1
                continue
            last_ns = message.value.stamp_ns
            yield message.value


@dataclass(frozen=True, slots=True)
class _Placed:
    """Scans with a pose: (N,) stamps, (N, 3) poses, (N,) whether each can be trusted."""

    stamps_ns: IntArray
    poses_map_scan: FloatArray
    trusted: BoolArray


def _motion(
    recording: Recording, streams: Streams, lidar_frame: str, motion: Motion
) -> Poses | None:
    """The LiDAR's poses by what was recorded. Raises MissingStream where that is not there."""
    if motion == "none":
        return None
    if motion == "wheel":
        streams = replace(streams, tf=None, pose=None)
    poses = recorded_poses(recording, streams, lidar_frame)
    if poses is None:
        what = "odometry" if motion == "wheel" else "recorded pose"
        raise MissingStream(
            f"holds no {what}.", file=recording.path, advice="Use --motion none with SLAM."
        )
    return poses


def _placed_by_motion(scans: _Scans, poses: Poses) -> _Placed:
    known = [
        (scan.stamp_ns, pose) for scan in scans if (pose := poses.at(scan.stamp_ns)) is not None
    ]
    if not known:
        raise MappingFailed(f"{poses.source} has no pose for any scan.")
    stamps_ns, found = zip(*known, strict=True)
    return _Placed(
        np.array(stamps_ns, dtype=np.int64), np.array(found), np.ones(len(known), dtype=np.bool_)
    )


def _grid(
    scans: _Scans, placed: _Placed, settings: MapSettings, progress: Progress
) -> OccupancyGrid:
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


def _report(
    placed: _Placed, result: SlamResult | None, options: MapOptions, notes: Sequence[str]
) -> dict[str, Any]:
    steps_m = np.hypot(*np.diff(placed.poses_map_scan[:, :2], axis=0).T)
    report: dict[str, Any] = {
        "slam": options.slam,
        "motion": options.motion,
        "scans": int(placed.stamps_ns.size),
        "duration_s": float(placed.stamps_ns[-1] - placed.stamps_ns[0]) / 1e9,
        "path_m": float(steps_m.sum()),
        "trusted_share": float(placed.trusted.mean()),
        "untrusted": untrusted_stretches(placed.stamps_ns, placed.trusted),
        "notes": list(notes),
    }
    if result is not None:
        graph = result.graph
        away_m = np.hypot(*result.residuals[:, :2].T)
        report |= {
            "key_scans": int(result.key.size),
            "edges": int(graph.first.size),
            "loops": result.loops,
            "loops_tried": result.loops_tried,
            "loops_dropped": result.loops_dropped,
            "loop_closures": [
                {
                    "first_s": float(placed.stamps_ns[result.key[graph.first[edge]]]) / 1e9,
                    "second_s": float(placed.stamps_ns[result.key[graph.second[edge]]]) / 1e9,
                    "residual_m": float(away_m[edge]),
                    "residual_rad": float(result.residuals[edge, 2]),
                }
                for edge in np.flatnonzero(graph.is_loop)
            ],
        }
    return report


def untrusted_stretches(stamps_ns: IntArray, trusted: BoolArray) -> list[dict[str, Any]]:
    """Each run of scans that cannot be trusted: stamps of its first and last, and how many."""
    turns = np.flatnonzero(np.diff(np.concatenate([[True], trusted, [True]]).astype(np.int8)))
    return [
        {
            "from_s": float(stamps_ns[first]) / 1e9,
            "to_s": float(stamps_ns[end - 1]) / 1e9,
            "scans": int(end - first),
        }
        for first, end in zip(turns[::2], turns[1::2], strict=True)
    ]
