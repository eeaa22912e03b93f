"""``scanloom calibrate camera``: where a 3D LiDAR is in a camera's frame."""

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
    SeedOption,
    SongPresetOption,
    require_integer,
)
from scanloom.commands.reports import Report


@dataclass(frozen=True, kw_only=True)
class CalibrateCamera:
    """Pose of a 3D LiDAR in a camera's frame from what both see, without a target (Song 2022)."""

    source: Annotated[conf.Positional[Path], conf.arg(metavar="CLOUD|RECORDING")]
    """A dense cloud with intensity (PCD, PLY, KITTI .bin), or the recording of a LiDAR that turns
    on an axis; a sparse cloud needs --guess."""
    image: Annotated[conf.Positional[Path], conf.arg(metavar="IMAGE")]
    """The camera's image of the same scene, or the recording's topic of it."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="FILE")]
    """The result to write (.json or .toml); YAML, URDF, a static TF and figures are written beside
    it."""
    intrinsics: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """The camera's intrinsics (default: the recording's CameraInfo)."""
    guess: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """A file with T_camera_lidar, kept where the result is not better."""
    cloud: Annotated[Path | None, conf.arg(metavar="CLOUD", help_behavior_hint="")] = None
    """Write the points that the camera sees in its colours: .ply or .pcd."""
    points: PointsOption = None
    joint: JointOption = None
    preset: SongPresetOption = "default"
    settings: PresetSettingsOption = None
    seed: SeedOption = None
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.calibrate.camera import (
            CameraOptions,
            calibrate_camera,
            camera_lines,
        )

        require_integer("--seed", self.seed, SEED_MAX)
        options = CameraOptions(
            preset=self.preset,
            settings_file=self.settings,
            seed=self.seed,
            intrinsics_file=self.intrinsics,
            guess_file=self.guess,
            cloud=self.cloud,
            points=self.points,
            joint=self.joint,
        )
        result = calibrate_camera(self.source, self.image, self.output, options, progress)
        return Report(result=result, lines=camera_lines(result))
