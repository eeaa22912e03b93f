"""The settings of the whole chain, and its two presets.

``default`` works best; ``published`` is Xu 2024 as far as its text specifies it. Where it does not,
the choice is ours: pairs by nearest stamp, samples by index, raw values with holes as zeros, rows
of the lower half, Pearson, each frame's own peak, an affine A from 84 draws of 6, epsilon 1.2 E
(the middle of [E, sqrt 2 E]), the rougher side at fault, repairs by (7) and (8). The images of
cameras side by side are pasted beside each other; (u, v) of a frame are whole numbers.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal, TypeVar

from pydantic import ConfigDict, ValidationError

from fusion_core.alignment.curves import SamplingSettings
from fusion_core.alignment.mount_settings import MountSettings
from fusion_core.alignment.search import SearchSettings
from fusion_core.alignment.time import TimeSettings
from fusion_core.denoising.noise_settings import NoiseSettings
from fusion_core.denoising.repair import RepairSettings
from fusion_core.exporting.settings_file import dump_toml, first_problem, load_toml, read_preset
from fusion_core.mapping.grid import GridSettings
from fusion_core.model.errors import SettingsError
from fusion_core.model.seeds import SEED_MAX
from fusion_core.registration.ransac import PUBLISHED, RegistrationSettings
from fusion_core.settings import SettingsGroup, StageSettings, setting

PresetName = Literal["default", "published"]
ChainStage = Literal["alignment", "match", "repair", "maps"]
_Settings = TypeVar("_Settings", bound=SettingsGroup)
_Stage = TypeVar("_Stage", bound=StageSettings)


_ALIGNMENT = ("time", "sampling", "search", "mount", "pairing")
_MATCH = (*_ALIGNMENT, "registration")
_REPAIR = (*_MATCH, "noise", "repair")
_READ_BY: dict[ChainStage, tuple[str, ...]] = {
    "alignment": _ALIGNMENT,
    "match": _MATCH,
    "repair": _REPAIR,
    "maps": (*_REPAIR, "grid"),
}
"""The fields of ChainSettings that the result of a stage depends on, with those of the stages
before it. It decides what is computed again after a change."""


class ChainSettings(SettingsGroup):
    """Every stage's settings, in the order of the chain."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    time: TimeSettings = TimeSettings()
    sampling: SamplingSettings = SamplingSettings()
    search: SearchSettings = SearchSettings()
    mount: MountSettings = MountSettings()
    registration: RegistrationSettings = RegistrationSettings(model="rigid")
    noise: NoiseSettings = NoiseSettings()
    repair: RepairSettings = RepairSettings()
    grid: GridSettings = GridSettings()
    pairing: Literal["mount", "frame"] = setting(
        "mount", "Pair beams and pixels by the recording's mount, or each frame by its own (u, v)"
    )

    def read_by(self, stage: ChainStage) -> tuple[object, ...]:
        """The settings on which the result of a stage depends: a key for caches."""
        return tuple(getattr(self, name) for name in _READ_BY[stage])


PRESETS: dict[PresetName, ChainSettings] = {
    "default": ChainSettings(),
    "published": ChainSettings(
        time=TimeSettings(compensate_motion=False),
        sampling=SamplingSettings(by="index", row_band=0.5),
        search=SearchSettings(metric="pearson", mask_holes=False, use_prior=False, sub_samples=1),
        registration=PUBLISHED,
        noise=NoiseSettings(epsilon=1.2, epsilon_unit="E", burr_criterion="rougher"),
        repair=RepairSettings(
            prefer="other_sensor",
            farther_confidence=0.0,
            lidar_burr_confidence=0.0,
            depth_burr_confidence=0.0,
            lidar_confidence=0.0,
            check_nearby=False,
            # The paper sets no limit to a gap, and a straight line spans less than half a turn.
            max_gap_deg=180.0,
            max_gap_pixels=100,
            edge_m=100.0,
        ),
        pairing="frame",
    ),
}


def settings_toml(preset: PresetName, settings: ChainSettings) -> str:
    """The settings file that repeats a run. How frames are paired comes with the preset alone."""
    return dump_toml(settings.stages(), preset)


def chain_settings(
    preset: PresetName, settings_file: Path | None, seed: int | None
) -> tuple[PresetName, ChainSettings]:
    """The preset with a settings file's values over it and, where given, the seed over both.

    A file that names a preset decides on it. Raises SettingsError for what the file has wrong.
    """
    preset, settings = preset_with_file(preset, PRESETS, settings_file)
    if seed is None:
        return preset, settings
    seeded = with_seed(settings.registration, seed)
    return preset, settings.model_copy(update={"registration": seeded})


def with_seed(settings: _Stage, seed: int) -> _Stage:
    """A stage's settings with another seed. Raises SettingsError for one that is out of range."""
    if not 0 <= seed <= SEED_MAX:
        raise SettingsError(f"the seed must be from 0 to {SEED_MAX}.")
    return settings.model_copy(update={"seed": seed})


def preset_with_file(
    preset: PresetName, presets: Mapping[PresetName, _Settings], settings_file: Path | None
) -> tuple[PresetName, _Settings]:
    """A preset, or the one that the file names, with the file's values over it.

    Raises SettingsError for what the file has wrong.
    """
    if settings_file is None:
        return preset, presets[preset]
    named = read_preset(settings_file)
    if named is not None:
        if named not in presets:
            raise SettingsError(
                f"unknown preset {named!r}.",
                file=settings_file,
                advice=f"Presets: {', '.join(presets)}.",
            )
        preset = "published" if named == "published" else "default"
    base = presets[preset]
    stages = base.stages()
    classes = {name: type(value) for name, value in stages.items()}
    stages = load_toml(settings_file, classes, stages)
    try:
        return preset, type(base)(**{**dict(base), **stages})
    except ValidationError as error:
        # Each stage is right by itself.
        raise SettingsError(f"{first_problem(error)}.", file=settings_file) from error
