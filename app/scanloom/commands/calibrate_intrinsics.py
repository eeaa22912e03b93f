"""``scanloom calibrate intrinsics``: a camera's matrix and distortion from images of a board."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from scanloom.commands.options import JsonFlag, SettingsOption, WrongUsage
from scanloom.commands.reports import Report


@dataclass(frozen=True, kw_only=True)
class CalibrateIntrinsics:
    """Intrinsics of a camera from images of a checkerboard, with deviations and coverage."""

    images: Annotated[conf.Positional[tuple[Path, ...]], conf.arg(metavar="IMAGES")]
    """Images of the board, or folders of them: ten or more, with the board tilted and in every
    part of the image."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="FILE")]
    """The camera file to write: .yaml (ROS camera_info) or .json."""
    board: Annotated[str, conf.arg(metavar="COLUMNSxROWS")]
    """Inner corners of the board, as 7x5 (its squares are taken too, where those fit)."""
    square: Annotated[float, conf.arg(metavar="M")]
    """Side of a square (m)."""
    model: Annotated[Literal["pinhole", "fisheye"] | None, conf.arg(help_behavior_hint="")] = None
    """Pinhole with radial and tangential distortion (plumb_bob), or fisheye (equidistant)."""
    settings: SettingsOption = None
    """A TOML file whose values override the defaults (table intrinsics)."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.calibrate.intrinsics import (
            calibrate_intrinsics,
            intrinsics_lines,
        )

        if not self.images:
            raise WrongUsage("calibrate intrinsics needs IMAGES; see calibrate intrinsics --help")
        result = calibrate_intrinsics(
            self.images,
            self.output,
            board=self.board,
            square_m=self.square,
            model=self.model,
            settings_file=self.settings,
            progress=progress,
        )
        return Report(result=result, lines=intrinsics_lines(result))
