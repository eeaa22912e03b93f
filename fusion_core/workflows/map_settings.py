"""The settings of ``scanloom map``."""

from pathlib import Path

from fusion_core.exporting.settings_file import dump_toml, load_toml, read_preset
from fusion_core.mapping.grid import GridSettings
from fusion_core.model.errors import SettingsError
from fusion_core.slam.pose_graph_slam import SlamSettings

_PRESET = "default"


class MapSettings(SlamSettings):
    """Every stage's settings, in the order of the work."""

    grid: GridSettings = GridSettings()


def map_settings(settings_file: Path | None) -> MapSettings:
    """The defaults, or a file's values over them. Raises SettingsError for a wrong file."""
    base = MapSettings()
    if settings_file is None:
        return base
    preset = read_preset(settings_file)
    if preset not in (None, _PRESET):
        raise SettingsError(
            f"unknown preset {preset!r}.", file=settings_file, advice=f"There is {_PRESET}."
        )
    stages = base.stages()
    classes = {name: type(value) for name, value in stages.items()}
    return base.model_copy(update=dict(load_toml(settings_file, classes, stages)))


def map_settings_toml(settings: MapSettings) -> str:
    """The settings file that repeats a run."""
    return dump_toml(settings.stages(), _PRESET)
