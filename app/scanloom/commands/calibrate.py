"""``scanloom calibrate``: where the sensors are, and how a camera maps rays to pixels."""

from dataclasses import dataclass
from typing import Annotated

from tyro import conf

from scanloom.commands.calibrate_camera import CalibrateCamera
from scanloom.commands.calibrate_color import CalibrateColor
from scanloom.commands.calibrate_intrinsics import CalibrateIntrinsics
from scanloom.commands.calibrate_lidar import CalibrateLidar
from scanloom.commands.calibrate_planar import CalibratePlanar


@dataclass(frozen=True, kw_only=True)
class Calibrate:
    """Find intrinsics and extrinsics, with how far they can be trusted."""

    target: conf.OmitSubcommandPrefixes[
        Annotated[CalibrateLidar, conf.subcommand("lidar")]
        | Annotated[CalibrateCamera, conf.subcommand("camera")]
        | Annotated[CalibratePlanar, conf.subcommand("planar")]
        | Annotated[CalibrateIntrinsics, conf.subcommand("intrinsics")]
        | Annotated[CalibrateColor, conf.subcommand("color")]
    ]
