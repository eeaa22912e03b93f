"""Synthetic recordings with truth."""

from pathlib import Path
from typing import Any

from fusion_core.exporting.settings_file import load_toml
from fusion_core.files.inputs import require_apart
from fusion_core.model.errors import ExportError
from fusion_core.model.progress import Progress
from fusion_core.recordings.world_file import world_path
from fusion_core.settings import StageSettings
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.scenes import (
    SceneSettings,
    SimulatedScene,
    find_scene,
    list_scenes,
    write_scene,
)
from fusion_core.simulation.truth import truth_path


def scenes() -> list[dict[str, Any]]:
    """Name, description and settings of each scene, ready for JSON."""
    return [
        {
            "name": scene.name,
            "description": scene.description,
            "settings": scene.settings.model_dump(mode="json"),
        }
        for scene in list_scenes()
    ]


def write(
    name: str,
    output: Path,
    *,
    settings_file: Path | None,
    seed: int | None,
    overwrite: bool,
    progress: Progress,
) -> dict[str, Any]:
    """Write the scene ``name`` to ``output`` (.mcap), its truth and its world beside it.

    The scene's own settings are changed by the table ``[scene]`` of ``settings_file``, its seed by
    ``seed``; the table ``[faults]`` says what goes wrong. The result says what was written. Raises
    SettingsError for an unknown scene or setting, ExportError where a file stands in the way
    (unless ``overwrite``) or cannot be written; ``seed`` is 0 or more.
    """
    settings, faults = _settings(find_scene(name), settings_file, seed)
    if output.suffix != ".mcap":
        raise ExportError("is no name for a recording.", file=output, advice="End it in .mcap.")
    truth, world = truth_path(output), world_path(output)
    for path in (output, truth, world):
        require_apart(path, [] if settings_file is None else [settings_file])
        if path.exists() and not overwrite:
            raise ExportError("exists.", file=path, advice="Choose another name, or --overwrite.")
    write_scene(name, output, settings=settings, faults=faults, progress=progress)
    return {
        "scene": name,
        "recording": str(output),
        "truth": str(truth),
        "world": str(world),
        "settings": settings.model_dump(mode="json"),
        "faults": faults.model_dump(mode="json"),
    }


def _settings(
    scene: SimulatedScene, settings_file: Path | None, seed: int | None
) -> tuple[SceneSettings, FaultSettings]:
    settings, faults = scene.settings, FaultSettings()
    if settings_file is not None:
        classes: dict[str, type[StageSettings]] = {"scene": SceneSettings, "faults": FaultSettings}
        loaded = load_toml(settings_file, classes, {"scene": settings, "faults": faults})
        settings = SceneSettings.model_validate(loaded["scene"])
        faults = FaultSettings.model_validate(loaded["faults"])
    if seed is not None:
        settings = SceneSettings.model_validate({**settings.model_dump(), "seed": seed})
    return settings, faults
