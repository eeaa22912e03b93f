"""``scanloom calibrate planar``: where a 2D LiDAR is in a camera's frame."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from fusion_core.model.seeds import SEED_MAX
from scanloom.commands.options import Flag, JsonFlag, SettingsOption, WrongUsage, require_integer
from scanloom.commands.reports import Report


@dataclass(frozen=True, kw_only=True)
class CalibratePlanar:
    """Pose of a 2D LiDAR in a camera's frame: from a recording, with a board (--board, --square)
    or without one, or from pairs of laser points and pixels."""

    source: Annotated[conf.Positional[Path], conf.arg(metavar="RECORDING|PAIRS.txt")]
    """A recording with a 2D LiDAR and a camera, or lines of: x y u v (m, m, px, px)."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="FILE")]
    """The result to write (.json or .toml); YAML, URDF and a static TF are written beside it."""
    intrinsics: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """The camera's intrinsics (default: the recording's CameraInfo)."""
    guess: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """A file with T_camera_lidar, kept where the result is not better."""
    board: Annotated[str | None, conf.arg(metavar="COLUMNSxROWS", help_behavior_hint="")] = None
    """Inner corners of a checkerboard that both sensors see, as 7x5."""
    square: Annotated[float | None, conf.arg(metavar="M", help_behavior_hint="")] = None
    """Side of a square (m)."""
    ignore_transforms: Flag = False
    """Without a board: do not start from the transforms in the recording."""
    preset: Literal["default", "published"] = "default"
    """The project's own settings, or those of Fu 2024."""
    settings: SettingsOption = None
    """A TOML file whose values override the preset's."""
    seed: Annotated[int | None, conf.arg(help_behavior_hint="")] = None
    """Seed of the random draws, overriding the settings'."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.calibrate.planar import (
            PlanarOptions,
            calibrate_planar,
            planar_lines,
        )

        require_integer("--seed", self.seed, SEED_MAX)
        if (self.board is None) != (self.square is None):
            raise WrongUsage("--board and --square go together; see calibrate planar --help")
        options = PlanarOptions(
            intrinsics_file=self.intrinsics,
            guess_file=self.guess,
            board=self.board,
            square_m=self.square,
            preset=self.preset,
            settings_file=self.settings,
            seed=self.seed,
            ignore_transforms=self.ignore_transforms,
        )
        result = calibrate_planar(self.source, self.output, options, progress)
        return Report(result=result, lines=planar_lines(result))
