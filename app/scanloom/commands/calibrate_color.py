"""``scanloom calibrate color``: a cloud in the colours of an image."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro import conf

from fusion_core.model.progress import Progress
from scanloom.commands.options import Flag, JsonFlag, SettingsOption
from scanloom.commands.reports import Report


@dataclass(frozen=True, kw_only=True)
class CalibrateColor:
    """Colour a cloud by an image and any calibration, without what nearer surfaces hide."""

    cloud: Annotated[conf.Positional[Path], conf.arg(metavar="CLOUD")]
    """A PCD, PLY or KITTI .bin file."""
    image: Annotated[conf.Positional[Path], conf.arg(metavar="IMAGE")]
    """The image that was taken at the same time."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="FILE")]
    """The cloud to write: .ply or .pcd, with colour and intensity."""
    extrinsics: Annotated[Path, conf.arg(metavar="FILE")]
    """A calibration's result, or a file of KITTI or OpenCalib."""
    intrinsics: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """The camera's intrinsics, if the extrinsics' file lacks them."""
    settings: SettingsOption = None
    """A TOML file with a table [coloring]: what counts as hidden."""
    all: Flag = False
    """Keep the points without a colour, in black."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.calibrate.color_cloud import color_cloud, color_lines

        result = color_cloud(
            self.cloud,
            self.image,
            self.output,
            extrinsics_file=self.extrinsics,
            intrinsics_file=self.intrinsics,
            settings_file=self.settings,
            keep_all=self.all,
            progress=progress,
        )
        return Report(result=result.to_json(), lines=color_lines(result))
