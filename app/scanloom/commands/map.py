"""``scanloom map``: the trajectory of the LiDAR and a map, by odometry or SLAM."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from fusion_core.model.seeds import SEED_MAX
from scanloom.commands.label_layer import LabelStoreOption, LayerOption, label_layer, require_layer
from scanloom.commands.options import (
    OFFSET_MAX_MS,
    WORKERS_MAX,
    ForceFlag,
    HomeOption,
    JsonFlag,
    OverwriteFolderFlag,
    RecordingArgument,
    RoomOption,
    SettingsOption,
    SubsessionOption,
    TopicOption,
    WorkersOption,
    WrongUsage,
    require_in_range,
    require_integer,
    room_choice,
)
from scanloom.commands.reports import Report


@dataclass(frozen=True, kw_only=True)
class Map:
    """Estimate the trajectory of the LiDAR and build a map, with loop closure."""

    recording: RecordingArgument
    """A recording with a 2D LiDAR or a depth camera, or the root of a Robot@Home data set."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="DIR")]
    """The folder for the results."""
    scan: Literal["lidar", "camera", "repaired", "merged"] = "lidar"
    """The input scans: the LiDAR's, virtual scans of the depth camera, the LiDAR's as repaired by
    fuse, or the LiDAR's merged with what the camera sees below the robot's height."""
    motion: Literal["recorded", "wheel", "laser", "visual", "visual-slam", "fused", "none"] = (
        "recorded"
    )
    """The motion prior: recorded poses (TF, else odometry), wheel odometry, laser odometry (scan
    matching), visual odometry, visual SLAM, all odometries fused, or none."""
    slam: Literal["none", "particle-filter", "pose-graph", "visual"] = "pose-graph"
    """The estimator; none uses the motion prior as the trajectory, visual maps a depth camera's
    images, with or without a LiDAR."""
    fusion: Literal["none", "table", "bayes"] = "none"
    """Fuse the LiDAR's own grid and the camera's own cell by cell (Fu 2024): table, an obstacle of
    either wins (Table 3); bayes, their probabilities are joined (10)."""
    preset: Literal["default", "published"] = "default"
    """The project's own settings, or those of Li 2022."""
    settings: SettingsOption = None
    """A TOML file whose values override the preset's."""
    seed: Annotated[int | None, conf.arg(metavar="N", help_behavior_hint="")] = None
    """Seed of the particle filter, overriding the settings'."""
    extrinsics: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """A TOML or JSON file with T_camera_lidar, used instead of the recording's transforms and of
    a mount estimated from scans and images."""
    clock_offset_ms: Annotated[float, conf.arg(metavar="MS")] = 0.0
    """Camera stamp minus LiDAR stamp of the same instant; subtracted from the camera's stamps."""
    labels: LayerOption = None
    label_store: LabelStoreOption = None
    home: HomeOption = None
    """A session of a Robot@Home data set, such as alma-s1, with --room."""
    room: RoomOption = None
    subsession: SubsessionOption = 1
    lidar: TopicOption = None
    """The LaserScan topic (default: found by type)."""
    pose: TopicOption = None
    """The topic of recorded poses, or a frame of TF such as map (default: the odom frame of TF,
    else odometry)."""
    workers: WorkersOption = None
    force: ForceFlag = False
    overwrite: OverwriteFolderFlag = False
    json: JsonFlag = False

    def require_usage(self) -> None:
        """Raises WrongUsage for options that cannot be, whatever the recording."""
        require_layer(self.labels, self.label_store)
        room_choice(self.home, self.room, self.subsession)
        if self.slam == "none" and self.motion == "none":
            raise WrongUsage("--slam none needs a --motion")
        if self.pose is not None and self.motion != "recorded":
            raise WrongUsage("--pose goes with --motion recorded")
        if self.home is not None and self.room is None:
            raise WrongUsage("--home needs --room, the one to map")
        if self.labels is not None and self.scan != "repaired":
            raise WrongUsage("--labels goes with --scan repaired: they overrule its classes")
        if self.labels is not None and self.home is not None:
            raise WrongUsage("--labels are of one recording, not of a data set (--home)")
        if self.fusion != "none" and self.scan == "repaired":
            raise WrongUsage(
                "--fusion goes with --scan lidar, camera or merged: repaired scans hold the "
                "camera's ranges, which would count twice"
            )
        require_integer("--seed", self.seed, SEED_MAX)
        require_integer("--workers", self.workers, WORKERS_MAX, least=1)
        require_in_range("--clock-offset-ms", -OFFSET_MAX_MS, OFFSET_MAX_MS, self.clock_offset_ms)

    def run(self, progress: Progress) -> Report:
        self.require_usage()
        from fusion_core.workflows.map.build_map import build_map
        from fusion_core.workflows.map.options import MapOptions

        with label_layer(self.recording, self.labels, self.label_store, progress) as layer:
            options = MapOptions(
                scan=self.scan,
                motion=self.motion,
                slam=self.slam,
                fusion=self.fusion,
                preset=self.preset,
                settings_file=self.settings,
                labels=layer,
                seed=self.seed,
                workers=self.workers,
                extrinsics_file=self.extrinsics,
                clock_offset_ms=self.clock_offset_ms,
                room=room_choice(self.home, self.room, self.subsession),
                lidar_topic=self.lidar,
                pose_topic=self.pose,
                force=self.force,
                overwrite=self.overwrite,
            )
            summary = build_map(self.recording, self.output, options, progress)
        return Report(result=summary.to_json(), lines=summary.lines())
