"""``scanloom calibrate lidar``: how a LiDAR is mounted on the axis that turns it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from fusion_core.model.seeds import SEED_MAX
from scanloom.commands.options import (
    JsonFlag,
    RecordingArgument,
    SettingsOption,
    TopicOption,
    require_integer,
)
from scanloom.commands.reports import Report


@dataclass(frozen=True, kw_only=True)
class CalibrateLidar:
    """Mounting error of a 3D LiDAR on a turning axis, from the planes that both half turns see
    (Song 2022)."""

    recording: RecordingArgument
    """A recording with PointCloud2 and the axis' angle (JointState or TF) over a whole turn."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="FILE")]
    """The result to write: .json or .toml."""
    cloud: Annotated[Path | None, conf.arg(metavar="CLOUD", help_behavior_hint="")] = None
    """Write the dense cloud of the turn too, calibrated: .ply or .pcd."""
    points: TopicOption = None
    """The PointCloud2 topic (default: the one with most messages)."""
    joint: Annotated[str | None, conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """The joint of the axis (default: the one that turns most)."""
    preset: Literal["default", "published"] = "default"
    """The project's own method, or that of Song 2022."""
    settings: SettingsOption = None
    """A TOML file whose values override the preset's."""
    seed: Annotated[int | None, conf.arg(metavar="N", help_behavior_hint="")] = None
    """Seed of the choice of points, overriding the settings'."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.calibrate.lidar import (
            LidarOptions,
            calibrate_lidar,
            lidar_lines,
        )

        require_integer("--seed", self.seed, SEED_MAX)
        options = LidarOptions(
            preset=self.preset,
            settings_file=self.settings,
            seed=self.seed,
            points=self.points,
            joint=self.joint,
            cloud=self.cloud,
        )
        result = calibrate_lidar(self.recording, self.output, options, progress)
        return Report(result=result, lines=lidar_lines(result))
