"""``scanloom sample``: a synthetic recording with its ground truth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro import conf

from fusion_core.model.progress import Progress
from fusion_core.model.seeds import SEED_MAX
from scanloom.commands.options import (
    Flag,
    JsonFlag,
    SettingsOption,
    WrongUsage,
    require_integer,
)
from scanloom.commands.reports import Report, scene_lines
from scanloom.resources import sample_path


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Write a synthetic recording with its ground truth and the outline of its world."""

    scene: Annotated[
        conf.Positional[str | None], conf.arg(metavar="SCENE", help_behavior_hint="")
    ] = None
    """The name of a scene."""
    output: Annotated[
        Path | None, conf.arg(aliases=["-o"], metavar="FILE", help_behavior_hint="")
    ] = None
    """The recording to write (.mcap); truth and world are written beside it."""
    settings: SettingsOption = None
    """A TOML file whose values override the scene's (tables scene and faults)."""
    seed: Annotated[int | None, conf.arg(help_behavior_hint="")] = None
    """Seed, overriding the scene's."""
    overwrite: Flag = False
    """Replace existing files."""
    list: Flag = False
    """List the scenes and the built-in recording."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows import sample

        if self.list:
            known = sample.scenes()
            result = {"scenes": known, "built_in": str(sample_path())}
            return Report(result=result, lines=scene_lines(result))
        if self.scene is None or self.output is None:
            raise WrongUsage("sample needs SCENE and -o FILE, or --list; see sample --help")
        require_integer("--seed", self.seed, SEED_MAX)
        written = sample.write(
            self.scene,
            self.output,
            settings_file=self.settings,
            seed=self.seed,
            overwrite=self.overwrite,
            progress=progress,
        )
        files = ("recording", "truth", "world")
        lines = [f"{name:<11}{written[name]}" for name in files if name in written]
        return Report(result=written, lines=lines)
