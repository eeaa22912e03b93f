"""``calibrate color``: a cloud in the colours of an image, by any calibration (Song, Fig. 12)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.calibration.coloring import ColoringSettings, color_points
from fusion_core.exporting.clouds import require_cloud_suffix, write_cloud
from fusion_core.exporting.settings_file import load_toml
from fusion_core.files.atomic import require_folder_of
from fusion_core.files.inputs import require_apart
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.progress import Progress, silent
from fusion_core.recordings.calibration_files.extrinsics import read_guess
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics
from fusion_core.recordings.clouds.formats import read_cloud
from fusion_core.recordings.images.frame_files import read_rgb


@dataclass(frozen=True, slots=True, kw_only=True)
class ColoredCloud:
    """What was written: ``points`` of the cloud's ``measured`` ones, ``colored`` of them with a
    colour; ``notes`` for people."""

    output: Path
    measured: int
    points: int
    colored: int
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "output": str(self.output),
            "measured": self.measured,
            "points": self.points,
            "colored": self.colored,
            "notes": list(self.notes),
        }


def color_cloud(
    cloud_file: Path,
    image_file: Path,
    output: Path,
    *,
    extrinsics_file: Path,
    intrinsics_file: Path | None = None,
    settings_file: Path | None = None,
    keep_all: bool = False,
    progress: Progress = silent,
) -> ColoredCloud:
    """Write the points that the camera sees with their colours, and their intensity if the cloud
    has it, in the cloud's own frame; ``output`` ends in .ply or .pcd.

    ``intrinsics_file``: None where the extrinsics' file states the camera too, as results of a
    calibration do. ``keep_all``: points that are not seen stay, in black.

    Raises CalibrationFailed where no point is in the image, RecordingError, SettingsError and
    ExportError for the files.
    """
    given = {cloud_file, image_file, extrinsics_file, intrinsics_file, settings_file}
    require_cloud_suffix(output)
    require_folder_of(output)
    require_apart(output, [path for path in given if path is not None])
    settings = ColoringSettings()
    if settings_file is not None:
        loaded = load_toml(settings_file, {"coloring": ColoringSettings})["coloring"]
        assert isinstance(loaded, ColoringSettings)
        settings = loaded
    notes: list[str] = []
    T_camera_lidar = read_guess(extrinsics_file)
    image = read_rgb(image_file)
    size = image.shape[1], image.shape[0]
    intrinsics = read_intrinsics(intrinsics_file or extrinsics_file, size, notes)
    progress(0, 3, "reading the cloud")
    cloud = read_cloud(cloud_file, notes)
    progress(1, 3, "colouring")
    rgb, seen = color_points(cloud.xyz_m, image, intrinsics, T_camera_lidar, settings)
    colored = int(seen.sum())
    if colored == 0:
        raise CalibrationFailed(
            f"no point of {cloud_file.name} is in the image.",
            file=extrinsics_file,
            advice="Check that it belongs to this cloud and this image.",
        )
    measured = np.isfinite(cloud.xyz_m).all(axis=1)
    kept = measured if keep_all else seen
    progress(2, 3, f"writing {output.name}")
    write_cloud(
        output,
        cloud.xyz_m[kept].astype(np.float64),
        rgb[kept],
        None if cloud.intensity is None else cloud.intensity[kept],
    )
    return ColoredCloud(
        output=output,
        measured=int(measured.sum()),
        points=int(kept.sum()),
        colored=colored,
        notes=tuple(notes),
    )


def color_lines(result: ColoredCloud) -> list[str]:
    """The result for people."""
    return [
        f"{result.output}: {result.points} points, {result.colored} of them in colour, "
        f"of {result.measured} in the cloud",
        *(f"note: {note}" for note in result.notes),
    ]
