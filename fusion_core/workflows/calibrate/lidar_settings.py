"""The settings of ``scanloom calibrate lidar``, and its two presets.

``published`` is Song 2022, (2) to (7), between the two views of 24 frames half a turn apart;
``default`` refines that with planes and mounting as unknowns together.
"""

from pathlib import Path

from fusion_core.calibration.turning.half_turn_planes import FrameSettings
from fusion_core.calibration.turning.planes import PlaneSettings
from fusion_core.calibration.turning.self_calibration import SelfCalibrationSettings
from fusion_core.settings import SettingsGroup
from fusion_core.workflows.fuse.settings import PresetName, preset_with_file, with_seed


class LidarSettings(SettingsGroup):
    """Every stage's settings."""

    frames: FrameSettings = FrameSettings()
    planes: PlaneSettings = PlaneSettings()
    self_calibration: SelfCalibrationSettings = SelfCalibrationSettings()


PRESETS: dict[PresetName, LidarSettings] = {
    "default": LidarSettings(),
    "published": LidarSettings(self_calibration=SelfCalibrationSettings(method="half_turns")),
}


def lidar_settings(
    preset: PresetName, settings_file: Path | None, seed: int | None
) -> tuple[PresetName, LidarSettings]:
    """The preset with a file's values over it and, where given, the seed over both.

    Raises SettingsError for what the file has wrong.
    """
    preset, settings = preset_with_file(preset, PRESETS, settings_file)
    if seed is None:
        return preset, settings
    seeded = with_seed(settings.self_calibration, seed)
    return preset, settings.model_copy(update={"self_calibration": seeded})
