"""``scanloom map``: one call of its workflow, which is imported inside so that --help is quick."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from fusion_core.model.seeds import SEED_MAX
from scanloom.commands.options import (
    OFFSET_MAX_MS,
    Flag,
    HomeOption,
    RecordingArgument,
    RoomOption,
    SettingsOption,
    TopicOption,
    WrongUsage,
    require_between,
    require_natural,
    room_of,
)
from scanloom.commands.reports import Report


@dataclass(frozen=True, kw_only=True)
class Map:
    """Where the LiDAR was, and the map of what it saw, with loops closed."""

    recording: RecordingArgument
    """A recording with a 2D LiDAR, or the root of a Robot@Home data set."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="DIR")]
    """The folder for the results."""
    scan: Literal["lidar", "camera", "repaired", "merged"] = "lidar"
    """What goes in: the LiDAR's scans, virtual ones of the depth camera, the LiDAR's as fuse
    repairs them, or the LiDAR's merged with what the camera sees below the robot's height."""
    motion: Literal["recorded", "wheel", "laser", "visual", "fused", "none"] = "recorded"
    """What is known beforehand: poses from TF, else odometry; odometry alone; scan matching; the
    camera; all of them fused; or nothing."""
    slam: Literal["none", "particle-filter", "pose-graph"] = "pose-graph"
    """The estimator; none takes the motion as it is."""
    preset: Literal["default", "published"] = "default"
    """What is right, or Li 2022 as printed."""
    settings: SettingsOption = None
    """A TOML file whose values go over the defaults."""
    seed: Annotated[int | None, conf.arg(metavar="N", help_behavior_hint="")] = None
    """Seed of the particle filter, over that of the settings."""
    extrinsics: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Where the camera stands on the LiDAR, where the recording's transforms should not say it: a
    TOML or JSON file with T_camera_lidar."""
    clock_offset_ms: Annotated[float, conf.arg(metavar="MS")] = 0.0
    """Camera stamp less LiDAR stamp of one instant, taken out."""
    home: HomeOption = None
    """A session of a Robot@Home data set, such as alma-s1, with --room."""
    room: RoomOption = None
    """A room of that session, such as bedroom1."""
    subsession: int = 1
    """The passage through that room, where there are several."""
    lidar: TopicOption = None
    """The LaserScan topic, where it should not be found by type."""
    pose: TopicOption = None
    """The topic of recorded poses (TF, else odometry, unless named)."""
    force: Flag = False
    """Work again where the folder already holds this very result."""
    overwrite: Flag = False
    """Write beside files of other origin, and in place of the results of another command."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        if self.slam == "none" and self.motion == "none":
            raise WrongUsage("--slam none needs a --motion")
        if self.pose is not None and self.motion != "recorded":
            raise WrongUsage("--pose goes with --motion recorded")
        if self.home is not None and self.room is None:
            raise WrongUsage("--home needs --room, the one to map")
        require_natural("--seed", self.seed, SEED_MAX)
        require_between("--clock-offset-ms", -OFFSET_MAX_MS, OFFSET_MAX_MS, self.clock_offset_ms)
        from fusion_core.workflows.map.build_map import MapOptions, build_map

        options = MapOptions(
            scan=self.scan,
            motion=self.motion,
            slam=self.slam,
            preset=self.preset,
            settings_file=self.settings,
            seed=self.seed,
            extrinsics_file=self.extrinsics,
            clock_offset_ms=self.clock_offset_ms,
            room=room_of(self.home, self.room, self.subsession),
            lidar_topic=self.lidar,
            pose_topic=self.pose,
            force=self.force,
            overwrite=self.overwrite,
        )
        summary = build_map(self.recording, self.output, options, progress)
        return Report(result=summary.to_json(), lines=summary.lines())
