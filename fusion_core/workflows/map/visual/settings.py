"""The settings of ``scanloom map --slam visual``."""

from pathlib import Path

from fusion_core.exporting.settings_file import dump_toml
from fusion_core.mapping.grid import GridSettings
from fusion_core.mapping.grid_misalignment import GridFusionSettings
from fusion_core.slam.visual.visual_slam import VisualSlamSettings
from fusion_core.workflows.fuse.settings import PresetName, preset_with_file
from fusion_core.workflows.map.volumes import VolumeSettings


class VisualMapSettings(VisualSlamSettings, VolumeSettings):
    """Every stage's settings: of the SLAM, of the maps in space, of the LiDAR's own map along the
    same path, and of the fusion with it."""

    grid: GridSettings = GridSettings()
    grid_fusion: GridFusionSettings = GridFusionSettings()


# Fu 2024 prints no settings of its visual SLAM: there is no published preset.
_PRESETS: dict[PresetName, VisualMapSettings] = {"default": VisualMapSettings()}


def visual_map_settings(settings_file: Path | None) -> VisualMapSettings:
    """The defaults with a file's values over them. Raises SettingsError for what it has wrong."""
    return preset_with_file("default", _PRESETS, settings_file)[1]


def visual_map_settings_toml(settings: VisualMapSettings) -> str:
    """The settings file that repeats a run."""
    return dump_toml(settings.stages(), "default")
