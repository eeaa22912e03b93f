"""The settings of ``scanloom calibrate camera``, and its two presets.

``published`` is Song 2022 §2.2 as far as its text specifies it: raw intensities, the median point
of each pixel, SIFT, RANSAC of the two images, pairs with a pixel fraction in 0.3 to 0.7 dropped,
DLT, and reprojection filtering. The pixel size is searched (it was chosen by eye), and the virtual
focal length is the real one.
"""

from pathlib import Path
from typing import Literal

from fusion_core.calibration.coloring import ColoringSettings
from fusion_core.calibration.features import camera_calibration
from fusion_core.calibration.features.camera_calibration import FeatureCalibrationSettings
from fusion_core.calibration.refinement.guess_refinement import GuessRefinementSettings
from fusion_core.settings import StageSettings, setting
from fusion_core.workflows.calibrate.lidar_settings import PRESETS as LIDAR_PRESETS
from fusion_core.workflows.calibrate.lidar_settings import LidarSettings
from fusion_core.workflows.fuse.settings import PresetName, preset_with_file, with_seed


class MethodSettings(StageSettings):
    """Which method finds the pose."""

    method: Literal["auto", "features", "information"] = setting(
        "auto",
        "Features of the intensity image; or, from an initial guess, the information that cloud "
        "and image share; auto: features, and information where there is a guess and they do not "
        "suffice",
    )


class CameraSettings(FeatureCalibrationSettings, LidarSettings):
    """Every stage's settings; those of ``calibrate lidar`` are for the recording of a turn."""

    calibration: MethodSettings = MethodSettings()
    guess: GuessRefinementSettings = GuessRefinementSettings()
    coloring: ColoringSettings = ColoringSettings()


PRESETS: dict[PresetName, CameraSettings] = {
    "default": CameraSettings(),
    "published": CameraSettings(
        **{**dict(LIDAR_PRESETS["published"]), **dict(camera_calibration.PUBLISHED)},
        calibration=MethodSettings(method="features"),
    ),
}


def camera_settings(
    preset: PresetName, settings_file: Path | None, seed: int | None
) -> tuple[PresetName, CameraSettings]:
    """The preset with a file's values over it and, where given, the seed over both.

    Raises SettingsError for what the file has wrong.
    """
    preset, settings = preset_with_file(preset, PRESETS, settings_file)
    if seed is None:
        return preset, settings
    seeded = {
        name: with_seed(getattr(settings, name), seed)
        for name in ("features", "pose", "self_calibration", "guess")
    }
    return preset, settings.model_copy(update=seeded)
