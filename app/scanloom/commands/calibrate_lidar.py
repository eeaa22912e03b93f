"""``scanloom calibrate lidar``: how a LiDAR is mounted on the axis that turns it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro import conf

from fusion_core.model.progress import Progress
from fusion_core.model.seeds import SEED_MAX
from scanloom.commands.options import (
    JointOption,
    JsonFlag,
    PointsOption,
    PresetSettingsOption,
    RecordingArgument,
    SeedOption,
    SongPresetOption,
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
    points: PointsOption = None
    joint: JointOption = None
    preset: SongPresetOption = "default"
    settings: PresetSettingsOption = None
    seed: SeedOption = None
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
