"""``scanloom map``: one call of its workflow, which is imported inside so that --help is quick."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro import conf

from app.command_options import (
    Flag,
    HomeOption,
    RecordingArgument,
    RoomOption,
    SettingsOption,
    TopicOption,
    WrongUsage,
    room_of,
)
from app.reports import Report
from fusion_core.model.progress import Progress


@dataclass(frozen=True, kw_only=True)
class Map:
    """Where the LiDAR was, and the map of what it saw, with loops closed."""

    recording: RecordingArgument
    """A recording with a 2D LiDAR, or the root of a Robot@Home data set."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="DIR")]
    """The folder for the results."""
    slam: Literal["none", "pose-graph"] = "pose-graph"
    """Match scans and close loops, or take the motion as it is."""
    motion: Literal["recorded", "wheel", "none"] = "recorded"
    """What is known beforehand: poses from TF, else odometry; odometry alone; or nothing."""
    settings: SettingsOption = None
    """A TOML file whose values go over the defaults."""
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
    """Write into a folder that holds files of other origin."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        if self.slam == "none" and self.motion == "none":
            raise WrongUsage("--slam none needs a --motion")
        if self.pose is not None and self.motion != "recorded":
            raise WrongUsage("--pose goes with --motion recorded")
        if self.home is not None and self.room is None:
            raise WrongUsage("--home needs --room, the one to map")
        from fusion_core.workflows.build_map import MapOptions, build_map

        options = MapOptions(
            slam=self.slam,
            motion=self.motion,
            settings_file=self.settings,
            room=room_of(self.home, self.room, self.subsession),
            lidar_topic=self.lidar,
            pose_topic=self.pose,
            force=self.force,
            overwrite=self.overwrite,
        )
        summary = build_map(self.recording, self.output, options, progress)
        return Report(result=summary.to_json(), lines=summary.lines())
