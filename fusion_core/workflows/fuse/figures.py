"""The paper's figures for a fused recording.

Figs. 3, 4, 5, 7 and 8 show one frame, the showcase; Fig. 6 needs a truth and Fig. 9 maps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from fusion_core.alignment.curves import (
    CurveSampling,
    RowSampling,
    offset_of_yaw,
    yaw_of_offset_rad,
)
from fusion_core.alignment.search import Peak
from fusion_core.alignment.similarity import Metric, SimilarityField
from fusion_core.evaluation.fuse_folder import open_fuse_folder, read_frames
from fusion_core.exporting.figures import format_stamp
from fusion_core.exporting.figures_alignment import (
    CurvePair,
    FieldPanel,
    MetricColumn,
    SynchronizedFrame,
    write_aligned,
    write_similarity,
)
from fusion_core.exporting.figures_maps import write_maps
from fusion_core.exporting.figures_registration import (
    RansacPairs,
    RecallCurves,
    write_pairs,
    write_recall,
)
from fusion_core.exporting.figures_repair import RepairedCurve, write_fused_depth, write_repair
from fusion_core.exporting.tables import CsvTable
from fusion_core.mapping.difference import compare_maps
from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.names import escape_undecodable
from fusion_core.model.progress import Progress, silent
from fusion_core.model.rig import Camera
from fusion_core.worker_processes import WorkerPool
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.color_of_frame import nearest_color_image, remap_color
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import curves_at
from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.fuse.table_1 import table_1_row, write_table_1

_METRIC_NAMES: dict[Metric, str] = {
    "pearson": "Pearson, eq. (2)",
    "inverse_cosine": "1 − cosine, eq. (3) as printed",
    "cosine": "cosine",
    "euclidean": "inverse Euclidean, eq. (4)",
}
_FIG_4_SHEETS: dict[str, tuple[Metric, Metric]] = {
    "fig4_similarity.png": ("pearson", "euclidean"),
    "fig4_similarity_cosine.png": ("inverse_cosine", "cosine"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class FigureData:
    """The results of a run that the figures show.

    ``showcase``: the frame that is shown, None where none was fused; ``scores``: the counts of
    Table 1. ``grids``: maps by name, the truth's as "reference", empty without poses, which come
    from ``pose_source``. ``fuse_dir``: the result folder that ``truth``, if given, is compared
    with.
    """

    session: Session
    alignment: RecordingAlignment
    showcase: FusedFrame | None
    scores: dict[str, int]
    grids: dict[str, OccupancyGrid]
    pose_source: str | None
    preset: str
    fuse_dir: Path
    truth: Path | None


# A figure yet to be drawn, by any process: it returns why it was left out, None where it was not.
_Figure = Callable[[], str | None]


def prepare_to_draw() -> None:
    """What a worker does while the results are finished: import what drawing does."""
    import matplotlib.backends.backend_agg
    import matplotlib.style  # noqa: F401  # exporting.figures does with the first figure


def write_figures(
    folder: Path, data: FigureData, pool: WorkerPool, progress: Progress = silent
) -> list[str]:
    """Draw the figures that the data allow into ``folder``; return why others are left out.

    Raises ExportError where a file cannot be written, and what the progress function raises.
    """
    session, truth, frame = data.session, data.truth, data.showcase
    folder.mkdir(exist_ok=True)
    name = session.recording.path.resolve().name
    heading = f"{printable(name)}, preset {data.preset}"
    if session.virtual_row is not None:
        heading += f", virtual LiDAR, row {session.virtual_row}"
    notes: list[str] = []
    write_table_1(folder / "table1.csv", [table_1_row(name, data.scores)])
    drawn = _similarity_figures(folder, heading, data)
    if frame is None:
        notes.append("No frame to show: Figs. 3, 5, 7 and 8 are left out.")
    else:
        drawn += _showcase_figures(folder, heading, session, frame)
        if frame.match.registration is None:
            notes.append(f"Fig. 5 is left out: {frame.match.refusal}")
    if truth is not None:
        drawn.append(partial(_write_recall, folder, heading, data.fuse_dir, truth))
    if data.grids:
        maps_heading = f"{heading}\nposes of {data.pose_source}"
        drawn.append(partial(_write_maps, folder, maps_heading, data.grids))
    left_out = pool.in_order(_draw, drawn, lambda figure: figure, submitted_ahead=1)
    for number in range(1, len(drawn) + 1):
        progress(number, len(drawn), "drawing figures")
        _, note = next(left_out)
        notes += [] if note is None else [note]
    return notes


def _draw(figure: _Figure) -> str | None:
    return figure()


def printable(name: str) -> str:
    """A name in characters that the figures' font has."""
    return escape_undecodable(name).encode("latin-1", errors="replace").decode("latin-1")


def _similarity_figures(folder: Path, heading: str, data: FigureData) -> list[_Figure]:
    session, alignment, frame = data.session, data.alignment, data.showcase
    cameras = session.rig.cameras
    columns = {}
    for metric, name in _METRIC_NAMES.items():
        recording = _field_panel(
            alignment.fields[metric],
            alignment.peaks.get(metric),
            alignment.curve,
            alignment.row,
            cameras[0],
            alignment.mount.yaw_rad,
        )
        panel = curves = None
        if frame is not None:
            match = frame.match
            camera = cameras[match.pair.camera_index if match.images == 1 else 0]
            peak = match.search.peaks_without_prior.get(metric)
            panel = _field_panel(
                match.search.fields[metric],
                peak,
                match.curve,
                match.row,
                camera,
                alignment.mount.yaw_rad,
            )
            if peak is not None:
                lidar_m, depth_m = curves_at(
                    match, (peak.u, peak.v), masked=session.settings.search.mask_holes
                )
                curves = CurvePair(lidar_m=lidar_m, depth_m=depth_m)
        columns[metric] = MetricColumn(name=name, frame=panel, recording=recording, curves=curves)
    shown = f"Fig. 4, scores over (u, v)\n{heading}"
    if frame is not None:
        searched = _frame_name(session, frame)
        if frame.match.images > 1:
            stamp = format_stamp(frame.match.stamp_ns)
            searched = f"panorama of {frame.match.images} images at {stamp}"
        shown += f"\n{searched}, its own peaks"
    kind = "frames" if len(cameras) == 1 else "panoramas"
    return [
        partial(
            write_similarity,
            folder / file_name,
            shown,
            [columns[metric] for metric in metrics],
            mean_of=f"{alignment.frames} {kind}",
        )
        for file_name, metrics in _FIG_4_SHEETS.items()
    ]


def _field_panel(
    field: SimilarityField,
    peak: Peak | None,
    curve: CurveSampling,
    row: RowSampling,
    camera: Camera,
    mount_yaw_rad: float,
) -> FieldPanel:
    return FieldPanel(
        scores=field.scores,
        u_first=field.u_first,
        peak=None if peak is None else (peak.u, peak.v),
        runner_up=None if peak is None else (peak.runner_up_u, peak.runner_up_v),
        peak_score=float("nan") if peak is None else peak.score,
        yaw_at_zero_deg=float(np.rad2deg(yaw_of_offset_rad(0.0, curve, row.left_rad))),
        step_deg=float(np.rad2deg(curve.step_rad)),
        mount_u=offset_of_yaw(mount_yaw_rad, curve, row),
        middle_row=camera.intrinsics.cy,
        focal_px=camera.intrinsics.fy,
    )


def _frame_name(session: Session, frame: FusedFrame) -> str:
    topic = printable(session.rig.cameras[frame.match.pair.camera_index].topic)
    return f"{topic} at {format_stamp(frame.match.stamp_ns)}"


def _showcase_figures(
    folder: Path, heading: str, session: Session, frame: FusedFrame
) -> list[_Figure]:
    match = frame.match
    about = f"{heading}\n{_frame_name(session, frame)}"
    found = nearest_color_image(session, frame)
    color = (
        None
        if found is None
        else remap_color(found.rgb, session.rig.views[match.pair.camera_index])
    )
    after_ms = None if found is None else (found.stamp_ns - match.stamp_ns) / NS_PER_MS
    aligned = partial(
        write_aligned,
        folder / "fig3_aligned.png",
        f"Fig. 3, aligned in time\n{about}",
        SynchronizedFrame(
            color=color,
            color_after_ms=after_ms,
            depth_m=match.depth_m,
            depth_stamp_ns=match.stamp_ns,
            scan=match.scan,
            gap_ns=match.pair.gap_ns,
            beams_in_view=match.correspondence.beam,
            has_nominal_stamps=session.recording.stamps_are_nominal,
        ),
    )
    drawn: list[_Figure] = [aligned]
    by_sample = session.settings.pairing == "frame"
    if match.registration is not None:
        pairs = partial(
            write_pairs,
            folder / "fig5_pairs.png",
            f"Fig. 5, pairs before and after RANSAC\n{about}",
            RansacPairs(
                lidar_points_m=match.registration.draws.lidar_points_m,
                depth_points_m=match.registration.draws.depth_points_m,
                inliers=match.registration.inliers,
                model=match.registration.model,
                mean_error_m=match.registration.mean_error_m,
                threshold_m=match.registration.draws.inlier_threshold_m,
                draws=match.registration.draws.count,
                axis_names=(
                    (
                        "x: sample × median arc of a sample (m)",
                        "range, holes as 0 (m)",
                    )
                    if by_sample
                    else ("x to the right (m)", "z ahead (m)")
                ),
            ),
        )
        drawn.append(pairs)
    curve = RepairedCurve(
        azimuth_rad=match.correspondence.azimuth_rad,
        row=match.correspondence.row,
        column=match.correspondence.column,
        lidar_m=match.correspondence.lidar_range_m,
        lidar_repaired_m=frame.repair.lidar_range_m,
        lidar_class=frame.classes.lidar_class,
        lidar_source=frame.repair.lidar_source,
        depth_m=match.correspondence.depth_m,
        depth_repaired_m=frame.repair.depth_m,
        depth_class=frame.classes.depth_class,
        depth_source=frame.repair.depth_source,
        depth_as_range_m=match.correspondence.depth_as_range_m,
        camera_range_m=match.correspondence.camera_range_m,
    )
    about_repair = f"Fig. 7, before and after denoising\n{about}"
    about_depth = f"Fig. 8, fused depth image\n{about}"
    drawn += [
        partial(write_repair, folder / "fig7_repair.png", about_repair, match.depth_m, curve),
        partial(
            write_fused_depth,
            folder / "fig8_fused_depth.png",
            about_depth,
            color=color,
            depth_m=match.depth_m,
            curve=curve,
        ),
    ]
    return drawn


def _write_recall(folder: Path, heading: str, fuse_dir: Path, truth: Path) -> str | None:
    """Fig. 6, or why the truth cannot be used for it."""
    try:
        measured = evaluate.noise(fuse_dir, truth)
    except ScanLoomError as error:
        return f"Fig. 6 is left out: {truth.name} {error.problem}"
    over = measured["over_epsilon"]
    factors = np.array(over["epsilon_over_E"])
    numbers = read_frames(open_fuse_folder(fuse_dir)).number
    with np.errstate(invalid="ignore", divide="ignore"):
        own = numbers["epsilon_m"] / numbers["mean_error_m"]
    own = own[np.isfinite(own)]
    write_recall(
        folder / "fig6_recall.png",
        f"Fig. 6, recall over the threshold\n{heading}; "
        f"{over['good_pairs']} good pairs, {over['noise_pairs']} noise pairs",
        RecallCurves(
            epsilon_over_E=factors,
            xi=over["xi"],
            eta=over["eta"],
            band=(over["band"][0], over["band"][1]),
            own_epsilon_over_E=float(np.median(own)) if own.size else float("nan"),
            own_xi=measured["xi"],
            own_eta=measured["eta"],
        ),
    )
    missing = [None] * factors.size
    with CsvTable(folder / "fig6_recall.csv", ("epsilon_over_E", "xi", "eta")) as table:
        for factor, xi, eta in zip(
            factors, over["xi"] or missing, over["eta"] or missing, strict=True
        ):
            table.append({"epsilon_over_E": factor, "xi": xi, "eta": eta})
    return None


def _write_maps(folder: Path, heading: str, grids: dict[str, OccupancyGrid]) -> None:
    pair = {name: grid for name, grid in grids.items() if name in ("lidar", "fused")}
    write_maps(
        folder / "fig9_maps.png",
        f"Fig. 9, maps of one trajectory\n{heading}",
        grids,
        compare_maps(pair) if len(pair) == 2 else None,
    )
