"""Synthetic recordings with truth."""

from pathlib import Path
from typing import Any

from fusion_core.exporting.settings_file import load_toml
from fusion_core.model.errors import ExportError
from fusion_core.model.progress import Progress
from fusion_core.simulation.scenes import Scene, SceneSettings, find_scene, list_scenes, write_scene
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
    """Write the scene ``name`` to ``output`` (.mcap) and its truth beside it; say what was written.

    The scene's own settings are changed by the table ``[scene]`` of ``settings_file``, and its
    seed by ``seed``. Raises SettingsError for an unknown scene or setting, ExportError where a
    file stands in the way (unless ``overwrite``) or cannot be written; ``seed`` is 0 or more.
    """
    settings = _settings(find_scene(name), settings_file, seed)
    if output.suffix != ".mcap":
        raise ExportError("is no name for a recording.", file=output, advice="End it in .mcap.")
    truth = truth_path(output)
    for path in (output, truth):
        if path.exists() and not overwrite:
            raise ExportError("exists.", file=path, advice="Choose another name, or --overwrite.")
    write_scene(name, output, settings=settings, progress=progress)
    return {
        "scene": name,
        "recording": str(output),
        "truth": str(truth),
        "settings": settings.model_dump(mode="json"),
    }


def _settings(scene: Scene, settings_file: Path | None, seed: int | None) -> SceneSettings:
    settings = scene.settings
    if settings_file is not None:
        loaded = load_toml(settings_file, {"scene": SceneSettings}, {"scene": settings})
        settings = SceneSettings.model_validate(loaded["scene"])
    if seed is None:
        return settings
    return SceneSettings.model_validate({**settings.model_dump(), "seed": seed})
