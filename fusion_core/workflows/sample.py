"""Synthetic recordings with truth."""

from pathlib import Path
from typing import Any, TypeVar

from fusion_core.exporting.settings_file import load_toml
from fusion_core.files.inputs import require_apart
from fusion_core.model.errors import ExportError
from fusion_core.model.progress import Progress
from fusion_core.recordings.world_file import world_path
from fusion_core.settings import StageSettings
from fusion_core.simulation.board_recording import (
    BOARD_SCENE,
    BoardSceneSettings,
    write_board_recording,
)
from fusion_core.simulation.board_recording import DESCRIPTION as BOARD_DESCRIPTION
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.rig_recorder import record_turning_rig
from fusion_core.simulation.scenes import (
    SceneSettings,
    SimulatedScene,
    find_scene,
    list_scenes,
    write_scene,
)
from fusion_core.simulation.truth import truth_path
from fusion_core.simulation.turning_rig import TurningRigSettings

_Settings = TypeVar("_Settings", bound=StageSettings)

SONG_RIG = "song_rig"
_SONG_RIG_DESCRIPTION = (
    "Song 2022: a VLP-16 on a turning axis and a camera in a textured room; mounting error unknown"
)
_SONG_RIG_SEED = 1


def scenes() -> list[dict[str, Any]]:
    """Name, description and settings of each scene, ready for JSON."""
    listed: list[tuple[str, str, StageSettings]] = [
        (scene.name, scene.description, scene.settings) for scene in list_scenes()
    ]
    listed.append((SONG_RIG, _SONG_RIG_DESCRIPTION, TurningRigSettings()))
    listed.append((BOARD_SCENE, BOARD_DESCRIPTION, BoardSceneSettings()))
    return [
        {
            "name": name,
            "description": description,
            "settings": settings.model_dump(mode="json"),
        }
        for name, description, settings in listed
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
    ``seed``; the table ``[faults]`` says what goes wrong. The scenes for calibrations have neither
    faults nor a world. The result says what was written. Raises SettingsError for an unknown scene
    or setting, ExportError where a file stands in the way (unless ``overwrite``) or cannot be
    written; ``seed`` is 0 or more.
    """
    if name == SONG_RIG:
        return _write_rig(output, settings_file, seed, overwrite=overwrite, progress=progress)
    if name == BOARD_SCENE:
        return _write_board(output, settings_file, seed, overwrite=overwrite, progress=progress)
    settings, faults = _settings(find_scene(name), settings_file, seed)
    truth, world = truth_path(output), world_path(output)
    _require_free((output, truth, world), settings_file, overwrite=overwrite)
    write_scene(name, output, settings=settings, faults=faults, progress=progress)
    return {
        "scene": name,
        "recording": str(output),
        "truth": str(truth),
        "world": str(world),
        "settings": settings.model_dump(mode="json"),
        "faults": faults.model_dump(mode="json"),
    }


def _write_rig(
    output: Path,
    settings_file: Path | None,
    seed: int | None,
    *,
    overwrite: bool,
    progress: Progress,
) -> dict[str, Any]:
    settings = _with_file(TurningRigSettings(), settings_file)
    truth = truth_path(output)
    _require_free((output, truth), settings_file, overwrite=overwrite)
    used_seed = _SONG_RIG_SEED if seed is None else seed
    record_turning_rig(settings, used_seed, output, progress)
    return {
        "scene": SONG_RIG,
        "recording": str(output),
        "truth": str(truth),
        "settings": {"seed": used_seed, **settings.model_dump(mode="json")},
    }


def _write_board(
    output: Path,
    settings_file: Path | None,
    seed: int | None,
    *,
    overwrite: bool,
    progress: Progress,
) -> dict[str, Any]:
    settings = _with_file(BoardSceneSettings(), settings_file)
    if seed is not None:
        settings = BoardSceneSettings.model_validate({**settings.model_dump(), "seed": seed})
    truth = truth_path(output)
    _require_free((output, truth), settings_file, overwrite=overwrite)
    write_board_recording(output, settings, progress)
    return {
        "scene": BOARD_SCENE,
        "recording": str(output),
        "truth": str(truth),
        "settings": settings.model_dump(mode="json"),
    }


def _with_file(settings: _Settings, settings_file: Path | None) -> _Settings:
    """A scene's settings, changed by the table ``[scene]`` of a file."""
    if settings_file is None:
        return settings
    kind = type(settings)
    loaded = load_toml(settings_file, {"scene": kind}, {"scene": settings})
    return kind.model_validate(loaded["scene"])


def _require_free(paths: tuple[Path, ...], settings_file: Path | None, *, overwrite: bool) -> None:
    """Raise ExportError where the first path is no recording's, or a file stands in the way."""
    if paths[0].suffix != ".mcap":
        raise ExportError("is no name for a recording.", file=paths[0], advice="End it in .mcap.")
    for path in paths:
        require_apart(path, [] if settings_file is None else [settings_file])
        if path.exists() and not overwrite:
            raise ExportError("exists.", file=path, advice="Choose another name, or --overwrite.")


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
