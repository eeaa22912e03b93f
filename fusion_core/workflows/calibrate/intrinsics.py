"""``calibrate intrinsics``: images of a checkerboard to a camera file with its coverage."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pydantic import ConfigDict

from fusion_core.calibration.board.board import BoardImages, find_boards, parse_board
from fusion_core.calibration.board.intrinsics import (
    COVERAGE_CELLS,
    IntrinsicsEstimate,
    IntrinsicsSettings,
    estimate_intrinsics,
)
from fusion_core.calibration.board.lens_fit import CameraModel
from fusion_core.exporting.camera_info import require_suffix, write_camera_info
from fusion_core.exporting.figures_intrinsics import Coverage, joined, write_coverage
from fusion_core.files.atomic import require_folder_of
from fusion_core.files.inputs import require_apart
from fusion_core.model.conventions import ByteArray
from fusion_core.model.errors import CalibrationFailed, RecordingError
from fusion_core.model.progress import Progress, silent
from fusion_core.recordings.images.frame_files import read_image
from fusion_core.settings import SettingsGroup
from fusion_core.workflows.fuse.settings import PresetName, preset_with_file

_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm")


class IntrinsicsCalibrationSettings(SettingsGroup):
    """The settings of ``calibrate intrinsics``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    intrinsics: IntrinsicsSettings = IntrinsicsSettings()


# No paper of the project decides how intrinsics are found.
PRESETS: dict[PresetName, IntrinsicsCalibrationSettings] = {
    "default": IntrinsicsCalibrationSettings()
}


def calibrate_intrinsics(
    images: Sequence[Path],
    output: Path,
    *,
    board: str,
    square_m: float,
    model: CameraModel | None = None,
    settings_file: Path | None = None,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Write the intrinsics to ``output`` and the coverage beside it; the result is ready for JSON.

    ``images``: files, or folders of them, all of one size. ``board``: its size as "7x5". Raises
    ScanLoomError with the file for an image that cannot be read or is of another size, for a size
    that no image shows, and where the images do not determine the intrinsics.
    """
    _, group = preset_with_file("default", PRESETS, settings_file)
    settings = group.intrinsics
    if model is not None:
        settings = settings.model_copy(update={"model": model})
    asked = parse_board(board, square_m)
    require_suffix(output)
    picture = output.with_name(f"{output.stem}_coverage.png")
    require_folder_of(output)
    for written in (output, picture):
        require_apart(written, images)
    files = _image_files(images)
    grey: list[ByteArray] = []
    for index, file in enumerate(files):
        progress(index, len(files), "reading images")
        grey.append(_read_grey(file, grey[0].shape if grey else None, files[0]))
    progress(len(files), len(files), "reading images")
    boards = find_boards(grey, asked)
    progress(len(files), len(files), "corners found")
    shape = (grey[0].shape[0], grey[0].shape[1])
    estimate = estimate_intrinsics(boards.board, boards.corners_px, shape, settings)
    result = _report(files, boards, estimate, settings)
    write_camera_info(output, estimate.intrinsics, result, name=output.stem)
    _write_picture(picture, boards, estimate)
    return {"file": str(output), "coverage_picture": str(picture), **result}


def _image_files(images: Sequence[Path]) -> list[Path]:
    files: list[Path] = []
    for path in images:
        if path.is_dir():
            inside = [file for file in path.iterdir() if file.suffix.lower() in _IMAGE_SUFFIXES]
            if not inside:
                raise RecordingError("holds no images.", file=path, advice="Name images.")
            files += sorted(inside)
        else:
            files.append(path)
    return files


def _read_grey(file: Path, shape: tuple[int, ...] | None, first: Path) -> ByteArray:
    # Stored rows: an orientation tag would turn the image that the driver sends.
    image = read_image(file, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if shape is not None and image.shape != shape:
        raise CalibrationFailed(
            f"has {image.shape[1]} x {image.shape[0]} pixels, {first.name} has"
            f" {shape[1]} x {shape[0]}.",
            file=file,
            advice="Give images of one camera in one mode.",
        )
    return np.asarray(image, np.uint8)


def _report(
    files: list[Path],
    boards: BoardImages,
    estimate: IntrinsicsEstimate,
    settings: IntrinsicsSettings,
) -> dict[str, Any]:
    board = boards.board
    found = [corners is not None for corners in boards.corners_px]
    return {
        "model": settings.model,
        "board": {
            "columns": board.columns,
            "rows": board.rows,
            "square_m": board.square_m,
            "size_counts": board.counted,
        },
        "values": dict(zip(estimate.names, map(float, estimate.values), strict=True)),
        "sd": dict(zip(estimate.names, map(float, estimate.sd), strict=True)),
        "reprojection_rms_px": estimate.rms_held_out_px,
        "reprojection_rms_used_px": estimate.rms_used_px,
        "covered_fraction": estimate.coverage,
        "images": [
            {
                "name": file.name,
                "board_found": seen,
                "rms_held_out_px": float(rms_px) if seen else None,
                "left_out": bool(outlier),
            }
            for file, seen, rms_px, outlier in zip(
                files, found, estimate.image_rms_px, estimate.outliers, strict=True
            )
        ],
        "notes": list(estimate.notes),
    }


def _write_picture(path: Path, boards: BoardImages, estimate: IntrinsicsEstimate) -> None:
    used = [residuals is not None for residuals in estimate.residuals_px]
    corners = boards.corners_px
    intrinsics = estimate.intrinsics
    heading = (
        f"{sum(used)} images, {estimate.rms_held_out_px:.2f} px on images left out; corners in "
        f"{estimate.coverage:.0%} of the image's cells"
    )
    write_coverage(
        path,
        heading,
        Coverage(
            shape=(intrinsics.height, intrinsics.width),
            corners_px=joined(
                [c for c, use in zip(corners, used, strict=True) if use and c is not None]
            ),
            residuals_px=joined([r for r in estimate.residuals_px if r is not None]),
            outliers_px=joined(
                [
                    c
                    for c, out in zip(corners, estimate.outliers, strict=True)
                    if out and c is not None
                ]
            ),
            cells=COVERAGE_CELLS,
        ),
    )


def intrinsics_lines(result: dict[str, Any]) -> list[str]:
    """The board, each parameter with its deviation, errors, and what to know about it."""
    board = result["board"]
    seen = sum(image["board_found"] for image in result["images"])
    lines = [
        f"written    {result['file']}",
        f"coverage   {result['coverage_picture']}, corners in {result['covered_fraction']:.0%} of"
        " the image's cells",
        f"board      {board['columns']}x{board['rows']} inner corners, squares of"
        f" {board['square_m']:g} m; the given size counts {board['size_counts']}",
        f"images     {seen} of {len(result['images'])} show it",
        f"model      {result['model']}",
        *(
            f"{name:<11}{value:.6g} ± {result['sd'][name]:.2g}"
            for name, value in result["values"].items()
        ),
        f"error      {result['reprojection_rms_px']:.3f} px on images left out,"
        f" {result['reprojection_rms_used_px']:.3f} px on those used",
    ]
    return lines + [f"note: {note}" for note in result["notes"]]
