"""The chain of Xu 2024 over a whole recording: align, then correspond, classify and repair."""

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.exporting.output_folder import RunRequest, plan_output, results_folder
from fusion_core.exporting.tables import CsvTable, ParquetTable
from fusion_core.files.atomic import write_text
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.progress import Progress, silent
from fusion_core.model.rig import MOUNT_PARAMETERS
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.camera_rig import CameraRig
from fusion_core.workflows.fuse.figures import FigureCollector, write_figures
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.scan_queue import RepairedScanQueue
from fusion_core.workflows.fuse.sensor_maps import SensorMaps
from fusion_core.workflows.fuse.session import (
    FuseOptions,
    Session,
    align_recording,
    fuse_frames,
    open_session,
)
from fusion_core.workflows.fuse.settings import PresetName, chain_settings, settings_toml
from fusion_core.workflows.fuse.tables import (
    FRAME_COLUMNS,
    SAMPLE_SCHEMA,
    alignment_document,
    frame_row,
    sample_columns,
    unpaired_row,
)
from fusion_core.workflows.recorded_poses import PoseLookup, recorded_poses
from fusion_core.workflows.source import input_files, open_source

# Small row groups: what waits for one counts in the memory of every run.
_SAMPLES_PER_GROUP = 8192


@dataclass(frozen=True, kw_only=True)
class FuseSummary:
    """What a run has to report. ``document`` is alignment.json's content; ``scores`` counts the
    frames in the columns of Table 1; ``pose_source`` says where the maps' poses come from, None
    without; ``grids`` are the maps by name. Both are left out where a run is skipped."""

    output: Path
    skipped: bool
    document: dict[str, Any]
    frames: int
    paired: int
    lidar_counts: dict[str, int]
    scores: dict[str, int]
    notes: tuple[str, ...]
    pose_source: str | None = None
    grids: Mapping[str, OccupancyGrid] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """One machine-readable result."""
        return {
            "output": str(self.output),
            "skipped": self.skipped,
            "frames": self.frames,
            "paired": self.paired,
            "classes": self.lidar_counts,
            "scores": self.scores,
            "alignment": self.document,
            "notes": list(self.notes),
        }

    def lines(self) -> list[str]:
        """The same for people."""
        if self.skipped:
            return [f"{self.output} already holds this result; nothing was done (--force redoes)."]
        document = self.document
        virtual = " (virtual LiDAR)" if document["virtual_lidar"] else ""
        lines = [
            f"preset     {document['preset']}{virtual}, pairs along the {document['row_model']}",
            f"offset     u = {document['u']:.2f} samples, v = {document['v']:.1f}, "
            f"{document['metric']} score {document['score']:.3f}",
            *_mount_lines(document),
            f"frames     {self.paired} of {self.frames} depth images paired with a scan",
        ]
        counts = ", ".join(f"{name} {count}" for name, count in self.lidar_counts.items())
        lines.append(f"LiDAR      {counts}")
        lines.extend(f"note       {note}" for note in self.notes)
        lines.append(f"results    {self.output}")
        return lines


def _mount_lines(document: dict[str, Any]) -> Iterator[str]:
    units = {"rad": ("deg", 180.0 / np.pi), "m": ("m", 1.0), "ms": ("ms", 1.0)}
    for name in MOUNT_PARAMETERS:
        unit, factor = units[name.rsplit("_", 1)[1]]
        label = name.rsplit("_", 1)[0].replace("_", " ")
        if document[f"{name}_sd"] is None:
            yield f"mount      {label}: not observable in this recording"
        else:
            value, sd = document[name] * factor, document[f"{name}_sd"] * factor
            yield f"mount      {label} {value:.2f} +- {sd:.2f} {unit}"


def fuse(
    recording: Path, output: Path, options: FuseOptions, progress: Progress = silent
) -> FuseSummary:
    """Fuse a recording into a folder of results.

    Raises ScanLoomError: RecordingError and MissingStream for the input, SettingsError,
    AlignmentFailed where LiDAR and depth cannot be laid on each other, ExportError for the folder.
    """
    preset, settings = chain_settings(options.preset, options.settings_file, options.seed)
    settings_text = settings_toml(preset, settings)
    with open_source(recording, options.room) as opened:
        inputs = input_files(opened) + ([] if options.truth is None else [options.truth])
        request = RunRequest(
            command="fuse",
            inputs=inputs,
            also_read=[recording, options.settings_file],
            settings_text=settings_text + _options_text(options),
            seed=settings.registration.seed,
        )
        plan = plan_output(
            output, request, force=options.force, overwrite=options.overwrite, progress=progress
        )
        if plan.is_done:
            return _read_summary(output)
        with results_folder(plan) as folder:
            session = open_session(opened, options, settings)
            return _run(session, output, folder, options, preset, settings_text, progress)


def _options_text(options: FuseOptions) -> str:
    """What was asked beyond the settings, as part of what makes two runs the same."""
    asked = {
        "virtual_lidar_row": options.virtual_lidar_row,
        "lidar": options.lidar_topic,
        "depth": options.depth_topics,
        "pose": options.pose_topic,
        "apply_clock_offset": options.apply_clock_offset,
        "maps": options.maps,
        "figures": options.figures,
    }
    if options.room is not None:
        asked["room"] = str(options.room)
    return json.dumps(asked)


def _read_summary(output: Path) -> FuseSummary:
    summary = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    return FuseSummary(
        output=output,
        skipped=True,
        document=json.loads((output / "alignment.json").read_text(encoding="utf-8")),
        frames=summary["frames"],
        paired=summary["paired"],
        lidar_counts=summary["classes"],
        scores=summary["scores"],
        notes=tuple(summary["notes"]),
    )


def _run(
    session: Session,
    output: Path,
    folder: Path,
    options: FuseOptions,
    preset: PresetName,
    settings_text: str,
    progress: Progress,
) -> FuseSummary:
    alignment = align_recording(session, progress)
    notes = [*session.rig.notes, *alignment.notes]
    clock_offset_ms = _clock_offset_to_apply(alignment, options, notes)
    poses: PoseLookup | None = None
    if options.maps and session.virtual_row is None:
        poses = recorded_poses(session.recording, session.streams, session.rig.lidar_frame)
        notes.append(f"Poses from {poses.source}." if poses else "No recorded poses: no maps.")
    outcome = _write_frames(session, alignment, clock_offset_ms, poses, folder, progress)
    notes.extend(outcome.notes)
    document = alignment_document(
        alignment,
        session.rig,
        preset,
        virtual=session.virtual_row is not None,
        notes=notes,
    )
    write_text(folder / "alignment.json", json.dumps(document, indent=2, allow_nan=False) + "\n")
    write_text(folder / "settings.toml", settings_text)
    figure_notes: list[str] = []
    if options.figures:
        progress(0, None, "drawing figures")
        figure_notes = write_figures(
            folder / "figures",
            session,
            alignment,
            outcome.figures,
            outcome.grids,
            preset=preset,
            fuse_dir=folder,
            truth=options.truth,
        )
    summary = FuseSummary(
        output=output,
        skipped=False,
        document=document,
        frames=outcome.frames,
        paired=outcome.paired,
        lidar_counts=outcome.lidar_counts,
        scores=outcome.figures.scores,
        notes=(*notes, *figure_notes, *session.recording.warnings),
        pose_source=None if poses is None else poses.source,
        grids=outcome.grids,
    )
    kept = summary.to_json()
    kept = {key: kept[key] for key in ("frames", "paired", "classes", "scores", "notes")}
    write_text(folder / "summary.json", json.dumps(kept, indent=2) + "\n")
    return summary


def _clock_offset_to_apply(
    alignment: RecordingAlignment, options: FuseOptions, notes: list[str]
) -> float:
    if not options.apply_clock_offset:
        return 0.0
    if alignment.mount.sd[MOUNT_PARAMETERS.index("clock_offset_ms")] is None:
        raise AlignmentFailed(
            "the clock offset is not observable in this recording and cannot be applied.",
            advice="Leave --apply-clock-offset out.",
        )
    notes.append(f"Camera stamps taken {alignment.mount.clock_offset_ms:.1f} ms earlier.")
    return alignment.mount.clock_offset_ms


@dataclass(frozen=True, kw_only=True)
class _Outcome:
    frames: int
    paired: int
    lidar_counts: dict[str, int]
    figures: FigureCollector
    grids: dict[str, OccupancyGrid]
    notes: list[str]


def _write_frames(
    session: Session,
    alignment: RecordingAlignment,
    clock_offset_ms: float,
    poses: PoseLookup | None,
    folder: Path,
    progress: Progress,
) -> _Outcome:
    """Run pass 2 and write what it yields as it comes."""
    maps = None if poses is None else SensorMaps(poses, session.settings.grid)
    topics = [camera.topic for camera in session.rig.cameras]
    lidar_topic = session.streams.lidar if session.virtual_row is None else None
    figures = FigureCollector(alignment)
    counts: dict[str, int] = {}
    frames = paired = last_stamp_ns = 0
    grids: dict[str, OccupancyGrid] = {}
    notes: list[str] = []
    with ExitStack() as stack:
        frame_table = stack.enter_context(CsvTable(folder / "frames.csv", FRAME_COLUMNS))
        sample_table = stack.enter_context(
            ParquetTable(
                folder / "samples.parquet", SAMPLE_SCHEMA, rows_per_group=_SAMPLES_PER_GROUP
            )
        )
        mcap = stack.enter_context(Ros2McapWriter(folder / "fused.mcap"))
        merge = RepairedScanQueue()

        def write_scan(raw: LaserScan, repaired: LaserScan) -> None:
            mcap.write_laser_scan(lidar_topic or "/virtual_lidar/scan", repaired)
            if maps is not None:
                maps.add_scan(raw, repaired)

        for entry in fuse_frames(session, alignment, clock_offset_ms):
            if isinstance(entry, LaserScan):
                merge.push(entry)
                for raw, repaired in merge.pop_settled():
                    write_scan(raw, repaired)
                continue
            frames += 1
            progress(frames, session.image_count, "fusing")
            if isinstance(entry, PairedImage):
                topic = topics[entry.camera]
                frame_table.append(unpaired_row(topic, entry))
                mcap.write_depth(topic, entry.image)
                continue
            paired += 1
            topic = topics[entry.camera]
            frame_table.append(frame_row(topic, entry, alignment, session.rig))
            sample_table.append(sample_columns(topic, entry, session.rig))
            mcap.write_depth(topic, repaired_image(entry, session.rig))
            merge.apply_repairs(entry)
            figures.add(entry)
            if maps is not None:
                maps.add_camera(entry)
            for name, count in zip(
                ("good", "hole", "burr", "conflict"),
                np.bincount(entry.classes.lidar_class, minlength=4),
                strict=True,
            ):
                counts[name] = counts.get(name, 0) + int(count)
            last_stamp_ns = max(last_stamp_ns, entry.stamp_ns)
        for raw, repaired in merge.flush():
            write_scan(raw, repaired)
        if maps is not None:
            grids, notes = maps.write(folder)
            if maps.scans_without_pose:
                notes.append(f"{maps.scans_without_pose} scans have no pose and are in no map.")
            if "fused" in grids:
                mcap.write_occupancy_grid("/map_fused", grids["fused"], last_stamp_ns)
    return _Outcome(
        frames=frames,
        paired=paired,
        lidar_counts=counts,
        figures=figures,
        grids=grids,
        notes=notes,
    )


def repaired_image(frame: FusedFrame, rig: CameraRig) -> DepthImage:
    """The stored depth image with the repaired pixels of the curve."""
    depth_m = frame.image.depth_m.copy()
    row, column = rig.views[frame.camera].stored_pixels(
        frame.correspondence.row, frame.correspondence.column
    )
    changed = frame.pixel_changed & (row >= 0)
    depth_m[row[changed], column[changed]] = frame.repair.depth_m[changed]
    return replace(frame.image, depth_m=depth_m)
