"""``scanloom fuse``: the chain of Xu 2024 over a whole recording. The entry is ``fuse``.

Pass 1, ``align_recording``: the offset (u, v), the mount and the noise scale of the recording.
Pass 2, ``fused_results``: each depth image with its scan (a FramePair) is matched
(``match_images``: search, correspondence, registration), classified and repaired
(``classify_and_repair``), by several processes where there are cores for them. The images of
cameras side by side are searched as one panorama.
``ResultWriter`` turns what comes out into tables, a repaired recording and maps; ``write_figures``
draws the paper's figures.
"""

import json
from dataclasses import replace
from pathlib import Path

from fusion_core.exporting.output_folder import RunRequest, plan_output, results_folder
from fusion_core.files.atomic import write_text
from fusion_core.model.errors import AlignmentFailed, ScanLoomError
from fusion_core.model.names import printable
from fusion_core.model.progress import Progress, silent
from fusion_core.model.rig import MOUNT_PARAMETERS
from fusion_core.model.sensors import LaserScan
from fusion_core.worker_processes import WorkerPool
from fusion_core.workflows.fuse.align import RecordingAlignment, align_recording
from fusion_core.workflows.fuse.figures import FigureData, prepare_to_draw, write_figures
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_labels import SessionLabels
from fusion_core.workflows.fuse.fused_results import fuse_again, fused_results, prepare_to_fuse
from fusion_core.workflows.fuse.reference_map import reference_map
from fusion_core.workflows.fuse.result_writer import ResultWriter
from fusion_core.workflows.fuse.session import FuseOptions, Session, open_session
from fusion_core.workflows.fuse.settings import chain_settings, settings_toml
from fusion_core.workflows.fuse.summary import FuseSummary, read_summary, write_summary
from fusion_core.workflows.fuse.tables import alignment_document
from fusion_core.workflows.recorded_poses import PoseLookup, recorded_poses
from fusion_core.workflows.source import input_files, open_source

__all__ = ["FuseSummary", "fuse"]


def fuse(
    recording: Path, output: Path, options: FuseOptions, progress: Progress = silent
) -> FuseSummary:
    """Fuse a recording into a folder of results.

    Raises ScanLoomError: RecordingError and MissingStream for the input, SettingsError,
    AlignmentFailed where LiDAR and depth cannot be aligned, ExportError for the folder,
    WorkerFailed where a process of ``options.workers`` dies.
    """
    preset, settings = chain_settings(options.preset, options.settings_file, options.seed)
    settings_text = settings_toml(preset, settings)
    given = options.given_extrinsics()
    with open_source(recording, options.room) as opened:
        files = (options.truth, options.extrinsics_file)
        inputs = [*input_files(opened), *(file for file in files if file is not None)]
        request = RunRequest(
            command="fuse",
            inputs=inputs,
            also_read=[recording, options.settings_file],
            settings_text=settings_text + _options_text(options),
            seed=settings.registration.seed,
            labels=options.labels,
        )
        plan = plan_output(
            output, request, force=options.force, overwrite=options.overwrite, progress=progress
        )
        if plan.is_done:
            return read_summary(output)
        with results_folder(plan) as folder, WorkerPool(options.workers) as pool:
            pool.start(prepare_to_fuse)
            write_text(folder / "settings.toml", settings_text)
            session = open_session(opened, options, settings, given)
            summary = _run_chain(session, folder, replace(options, preset=preset), pool, progress)
            write_summary(folder, summary)
            return replace(summary, output=output)


def _options_text(options: FuseOptions) -> str:
    """The options besides the settings; runs with equal texts and settings have equal results."""
    values = {
        "virtual_lidar_row": options.virtual_lidar_row,
        "lidar": options.lidar_topic,
        "depth": options.depth_topics,
        "pose": options.pose_topic,
        "apply_clock_offset": options.apply_clock_offset,
        "maps": options.maps,
        "figures": options.figures,
    }
    if options.room is not None:
        values["room"] = str(options.room)
    return json.dumps(values)


def _run_chain(
    session: Session, folder: Path, options: FuseOptions, pool: WorkerPool, progress: Progress
) -> FuseSummary:
    """Run both passes and write all results into ``folder``."""
    alignment = align_recording(session, progress)
    session = alignment.on_rig(session)
    notes = [*session.rig.notes, *alignment.notes]
    clock_offset_ms = _clock_offset_to_apply(alignment, options, notes)
    poses: PoseLookup | None = None
    if options.maps and session.virtual_row is None:
        poses = recorded_poses(session.recording, session.streams, session.rig.lidar_frame)
        notes.append(f"Poses from {poses.source}." if poses else "No recorded poses: no maps.")
    labels: SessionLabels | None = None
    if options.labels is not None:
        labels = SessionLabels(session=session, layer=options.labels)
        notes.append(f"The labels of {printable(options.labels.name)} overrule the classes.")
    with ResultWriter(folder, session, alignment, poses, labels) as results:
        for entry in fused_results(session, alignment, pool, clock_offset_ms, labels):
            if not isinstance(entry, LaserScan):
                progress(results.frames + 1, session.image_count, "fusing")
            results.add(entry)
        showcase: FusedFrame | None = None
        if options.figures:
            showcase = results.figures.showcase(
                lambda task: fuse_again(task, session, alignment, pool)
            )
            pool.restart(prepare_to_draw)
        grids, map_notes = results.finish()
    notes.extend(map_notes)
    document = alignment_document(
        alignment,
        session.rig,
        options.preset,
        virtual=session.virtual_row is not None,
        notes=notes,
    )
    write_text(folder / "alignment.json", json.dumps(document, indent=2, allow_nan=False) + "\n")
    figure_notes: list[str] = []
    if options.figures:
        shown = dict(grids)
        if grids and poses is not None and options.truth is not None:
            try:
                shown["reference"] = reference_map(
                    options.truth, folder, poses, session.settings.grid
                )
            except ScanLoomError as error:
                figure_notes.append(
                    f"Fig. 9 has no reference: {options.truth.name} {error.problem}"
                )
        figure_notes += write_figures(
            folder / "figures",
            FigureData(
                session=session,
                alignment=alignment,
                showcase=showcase,
                scores=results.figures.scores,
                grids=shown,
                # Which topic; how it was joined to the LiDAR is in the notes.
                pose_source=None if poses is None else poses.source.split(" (")[0],
                preset=options.preset,
                fuse_dir=folder,
                truth=options.truth,
            ),
            pool,
            progress,
        )
    return FuseSummary(
        output=folder,
        skipped=False,
        document=document,
        frames=results.frames,
        paired=results.paired,
        lidar_counts=dict(results.lidar_counts),
        scores=results.figures.scores,
        notes=(*notes, *figure_notes, *session.recording.warnings),
        pose_source=None if poses is None else poses.source,
        grids=grids,
    )


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
