"""``calibrate planar``: the pose of a 2D LiDAR in a camera's frame, in one of three ways.

From pairs of laser points and pixels (Fu 2024 (1)-(4)), from a recording in which both see a board
(Fu §2), or from a recording without one.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict

from fusion_core.calibration.board.board import parse_board
from fusion_core.calibration.board.laser_board import LaserBoardSettings, calibrate_laser_board
from fusion_core.calibration.board.laser_pixels import (
    LaserPixelSettings,
    calibrate_laser_pixels,
)
from fusion_core.calibration.board.laser_segments import SegmentSettings
from fusion_core.calibration.planar.natural_settings import NaturalSettings
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.exporting.extrinsics_files import extrinsics_document
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import CalibrationFailed, SettingsError
from fusion_core.model.extrinsics import POSE_PARAMETERS, ExtrinsicsEstimate
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.recordings.calibration_files.document import read_document
from fusion_core.recordings.calibration_files.extrinsics import read_guess
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics
from fusion_core.recordings.calibration_files.stated_camera import stated_camera
from fusion_core.recordings.laser_pixel_file import read_laser_pixels
from fusion_core.recordings.topics import choose_streams
from fusion_core.settings import SettingsGroup
from fusion_core.workflows.calibrate.board_views import BoardViewSettings, read_board_views
from fusion_core.workflows.calibrate.natural import calibrate_without_board
from fusion_core.workflows.calibrate.result_files import require_result_apart, write_result
from fusion_core.workflows.fuse.settings import PresetName, preset_with_file, with_seed
from fusion_core.workflows.sensor_geometry import first_value
from fusion_core.workflows.source import is_recording, open_source, paths_of

_INTRINSICS_ADVICE = "Give --intrinsics FILE, as scanloom calibrate intrinsics writes it."


class PlanarSettings(SettingsGroup):
    """The settings of every method."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    laser_pixels: LaserPixelSettings = LaserPixelSettings()
    laser_board: LaserBoardSettings = LaserBoardSettings()
    board_views: BoardViewSettings = BoardViewSettings()
    segments: SegmentSettings = SegmentSettings()
    natural: NaturalSettings = NaturalSettings()


PRESETS: dict[PresetName, PlanarSettings] = {
    "default": PlanarSettings(),
    # Fu 2024 states (1)-(4) and no weights: all pairs count the same, and only they decide.
    "published": PlanarSettings(
        laser_pixels=LaserPixelSettings(huber=100.0, starts=0),
        laser_board=LaserBoardSettings(huber=100.0),
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarOptions:
    """What the user has given. ``board``: its size as "7x5", with ``square_m``.
    ``ignore_transforms``: the recording's own, which are the guess where no board is named."""

    intrinsics_file: Path | None = None
    guess_file: Path | None = None
    board: str | None = None
    square_m: float | None = None
    preset: PresetName = "default"
    settings_file: Path | None = None
    seed: int | None = None
    ignore_transforms: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarOutcome:
    """An estimate with what else goes into its file. ``more``: ready for JSON."""

    estimate: ExtrinsicsEstimate
    intrinsics: CameraIntrinsics | None
    camera_frame: str = "camera"
    lidar_frame: str = "lidar"
    more: Mapping[str, Any]


def calibrate_planar(
    source: Path, output: Path, options: PlanarOptions, progress: Progress = silent
) -> dict[str, Any]:
    """Write T_camera_lidar to ``output`` (.json or .toml), and the other forms beside it.

    The result is what ``output`` holds, with ``files`` that were written. Raises ScanLoomError for
    files that cannot be read, for intrinsics of another size, and where the data do not determine
    the pose.
    """
    settings = _settings(options)
    given = [file for file in (options.intrinsics_file, options.guess_file) if file is not None]
    settings_files = [] if options.settings_file is None else [options.settings_file]
    inputs = [*paths_of(source), *given, *settings_files]
    require_result_apart(output, inputs)
    T_guess = None if options.guess_file is None else read_guess(options.guess_file)
    try:
        outcome = _estimate(source, options, settings, T_guess, progress)
    except CalibrationFailed as error:
        if error.file is not None:
            raise
        raise CalibrationFailed(error.problem, file=source, advice=error.advice) from error
    files = write_result(
        output,
        outcome.estimate,
        inputs=inputs,
        camera_frame=outcome.camera_frame,
        lidar_frame=outcome.lidar_frame,
        intrinsics=outcome.intrinsics,
        more=outcome.more,
    )
    return {
        **extrinsics_document(outcome.estimate),
        **outcome.more,
        "files": [str(file) for file in files],
    }


def _settings(options: PlanarOptions) -> PlanarSettings:
    _, settings = preset_with_file(options.preset, PRESETS, options.settings_file)
    if options.seed is None:
        return settings
    return settings.model_copy(
        update={
            "laser_pixels": with_seed(settings.laser_pixels, options.seed),
            "laser_board": with_seed(settings.laser_board, options.seed),
            "natural": with_seed(settings.natural, options.seed),
        }
    )


def _estimate(
    source: Path,
    options: PlanarOptions,
    settings: PlanarSettings,
    T_guess: FloatArray | None,
    progress: Progress,
) -> PlanarOutcome:
    if source.is_file() and not is_recording(source):
        return _from_pairs(source, options, settings, T_guess)
    if options.board is None:
        return _from_natural_scene(source, options, settings, T_guess, progress)
    return _from_board(source, options, settings, T_guess, progress)


def _from_pairs(
    source: Path, options: PlanarOptions, settings: PlanarSettings, T_guess: FloatArray | None
) -> PlanarOutcome:
    points_m, pixels = read_laser_pixels(source)
    if options.intrinsics_file is None:
        raise CalibrationFailed(
            "holds pairs, which need the camera's intrinsics.",
            file=source,
            advice=_INTRINSICS_ADVICE,
        )
    intrinsics, notes = _pair_intrinsics(options.intrinsics_file, pixels)
    found = calibrate_laser_pixels(
        points_m, pixels, intrinsics, settings.laser_pixels, T_guess=T_guess
    )
    more = {
        "method": "pairs",
        "pairs": len(pixels),
        "guess_rms_px": None if found.guess_px is None else reprojection_rms(found.guess_px),
        "result_held_out_rms_px": reprojection_rms(found.held_out_px),
        "pixel_sd_px": found.noise.pixel_px,
        "laser_sd_m": found.noise.laser_m,
        "input_notes": notes,
    }
    return PlanarOutcome(estimate=found.estimate, intrinsics=intrinsics, more=more)


def _pair_intrinsics(file: Path, pixels: FloatArray) -> tuple[CameraIntrinsics, list[str]]:
    """The intrinsics in a file; where it does not state the images' size, they are taken to be
    twice as large as its centre and to hold the pixels."""
    document = read_document(file, _INTRINSICS_ADVICE)
    try:
        camera = stated_camera(document)
    except (ValueError, OverflowError):
        # The reader says what is wrong.
        return read_intrinsics(file), []
    if camera.size is not None:
        return read_intrinsics(file), []
    size = (round(2.0 * camera.pinhole[2] + 1.0), round(2.0 * camera.pinhole[3] + 1.0))
    note = (
        f"{file.name} states no size of the images, so that the pixels are not checked against it"
    )
    held = np.maximum(size, np.ceil(pixels.max(axis=0)).astype(int) + 1)
    intrinsics = read_intrinsics(file, size)
    return replace(intrinsics, width=int(held[0]), height=int(held[1])), [note]


def _from_board(
    source: Path,
    options: PlanarOptions,
    settings: PlanarSettings,
    T_guess: FloatArray | None,
    progress: Progress,
) -> PlanarOutcome:
    if options.board is None or options.square_m is None:
        raise SettingsError(
            "a board needs its size and the side of its squares.",
            advice="Give --board 7x5 --square 0.105.",
        )
    board = parse_board(options.board, options.square_m)
    given = None
    if options.intrinsics_file is not None:
        given = read_intrinsics(options.intrinsics_file)
    with open_source(source, None) as recording:
        recorded = read_board_views(
            recording, board, settings.board_views, intrinsics=given, progress=progress
        )
        warnings = list(recording.warnings)
    progress(0, 1, "estimating")
    found = calibrate_laser_board(
        recorded.views,
        recorded.board,
        settings.laser_board,
        settings.segments,
        T_guess=T_guess,
    )
    progress(1, 1, "estimating")
    more = {
        "method": "board",
        "board": {
            "columns": recorded.board.columns,
            "rows": recorded.board.rows,
            "square_m": recorded.board.square_m,
            "size_counts": recorded.board.counted,
        },
        "views": len(recorded.views),
        "views_used": found.views_used,
        "distance_rms_m": found.distance_rms_m,
        "distance_rms_used_m": found.distance_rms_used_m,
        "guess_distance_rms_m": found.guess_rms_m,
        "input_notes": [*recorded.notes, *warnings],
    }
    return PlanarOutcome(
        estimate=found.estimate,
        intrinsics=recorded.intrinsics,
        camera_frame=recorded.camera_frame,
        lidar_frame=recorded.lidar_frame,
        more=more,
    )


def _from_natural_scene(
    source: Path,
    options: PlanarOptions,
    settings: PlanarSettings,
    T_guess: FloatArray | None,
    progress: Progress,
) -> PlanarOutcome:
    if options.intrinsics_file is not None:
        raise SettingsError(
            "without a board a recording's own CameraInfo is used, not another file.",
            file=options.intrinsics_file,
            advice="Leave --intrinsics out, or give --board and --square.",
        )
    with open_source(source, None) as recording:
        estimate = calibrate_without_board(
            recording,
            settings.natural,
            T_guess=T_guess,
            ignore_transforms=options.ignore_transforms,
            progress=progress,
        )
        streams = choose_streams(recording)
        frames = [
            "" if topic is None else getattr(first_value(recording, topic), "frame_id", "")
            for topic in (streams.depth[0], streams.lidar)
        ]
        warnings = list(recording.warnings)
    more = {"method": "natural scene", "input_notes": warnings}
    return PlanarOutcome(
        estimate=estimate,
        intrinsics=None,
        camera_frame=frames[0] or "camera",
        lidar_frame=frames[1] or "lidar",
        more=more,
    )


def planar_lines(result: Mapping[str, Any]) -> list[str]:
    """Verdict, pose with deviations, errors, notes and files."""
    T = np.array(result["T_camera_lidar"])
    lines = [result["verdict"], "", "T_camera_lidar"]
    lines += ["  " + " ".join(f"{value:10.6f}" for value in row) for row in T]
    lines.append("")
    for name in POSE_PARAMETERS:
        sd, is_angle = result["sd"][name], name.endswith("_rad")
        if sd is None:
            lines.append(f"{name:<16}not observable")
        elif is_angle:
            lines.append(f"{name:<16}± {np.degrees(sd):.3f} deg")
        else:
            lines.append(f"{name:<16}± {1000.0 * sd:.1f} mm")
    lines.append("")
    if result["reprojection_rms_px"] is not None:
        lines.append(
            f"error     {result['reprojection_rms_px']:.3f} px on pairs left out,"
            f" {result['reprojection_rms_used_px']:.3f} px on those used"
        )
    if result["basin"] is not None:
        lines.append(f"basin     {result['basin']:.0%} of disturbed starts come back")
    lines += [f"note: {note}" for note in (*result["notes"], *result["input_notes"])]
    return [*lines, *(f"written   {file}" for file in result["files"])]
