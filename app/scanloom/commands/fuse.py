"""``scanloom fuse``: align, classify, repair and map a whole recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from fusion_core.model.seeds import SEED_MAX
from scanloom.commands.label_layer import LabelStoreOption, LayerOption, label_layer, require_layer
from scanloom.commands.options import (
    ROW_MAX,
    WORKERS_MAX,
    Flag,
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
    require_integer,
    room_choice,
)
from scanloom.commands.reports import Report


@dataclass(frozen=True, kw_only=True)
class Fuse:
    """Align LiDAR and depth camera, classify noise, repair both, and build maps."""

    recording: RecordingArgument
    """A recording with a 2D LiDAR and a depth camera, depth alone with --virtual-lidar, or the
    root of a Robot@Home data set with --home."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="DIR")]
    """The folder for the results."""
    preset: Literal["default", "published"] = "default"
    """The project's own settings, or those of Xu 2024."""
    settings: SettingsOption = None
    """A TOML file whose values override the preset's."""
    home: HomeOption = None
    """A session of the data set, such as alma-s1: all its rooms, and Table 1, unless --room."""
    room: RoomOption = None
    subsession: SubsessionOption = 1
    lidar: TopicOption = None
    """The LaserScan topic (default: found by type)."""
    depth: Annotated[conf.UseAppendAction[tuple[str, ...]], conf.arg(metavar="TOPIC")] = ()
    """A depth image topic (default: found by type)."""
    pose: TopicOption = None
    """The topic of the poses for the maps, or a frame of TF such as map (default: the odom frame of
    TF, else odometry)."""
    extrinsics: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """A TOML or JSON file with T_camera_lidar, used instead of the recording's transforms and of a
    mount estimated from scans and images."""
    virtual_lidar: Annotated[int | None, conf.arg(metavar="ROW", help_behavior_hint="")] = None
    """Use this row (0-based) of the depth images as a virtual LiDAR."""
    apply_clock_offset: Flag = False
    """Correct the camera's stamps by the estimated clock offset."""
    no_maps: Flag = False
    """Write no maps."""
    no_figures: Flag = False
    """Write no figures."""
    truth: Annotated[Path | None, conf.arg(metavar="TRUTH.npz", help_behavior_hint="")] = None
    """The ground truth of a simulated recording, for the figure of noise recall."""
    labels: LayerOption = None
    label_store: LabelStoreOption = None
    seed: Annotated[int | None, conf.arg(help_behavior_hint="")] = None
    """Seed of the random draws, overriding the settings'."""
    workers: WorkersOption = None
    force: ForceFlag = False
    overwrite: OverwriteFolderFlag = False
    json: JsonFlag = False

    def require_usage(self) -> None:
        """Raises WrongUsage for options that cannot be, whatever the recording."""
        require_integer("--seed", self.seed, SEED_MAX)
        require_integer("--workers", self.workers, WORKERS_MAX, least=1)
        require_integer("--virtual-lidar", self.virtual_lidar, ROW_MAX)
        require_layer(self.labels, self.label_store)
        room_choice(self.home, self.room, self.subsession)
        if self.extrinsics is not None and self.virtual_lidar is not None:
            raise WrongUsage("--extrinsics has no LiDAR to place with --virtual-lidar")
        if self.labels is not None and self.home is not None:
            raise WrongUsage("--labels are of one recording, not of a data set (--home)")

    def run(self, progress: Progress) -> Report:
        self.require_usage()
        from fusion_core.workflows.fuse.fuse import FuseSummary, fuse
        from fusion_core.workflows.fuse.rooms import RoomsSummary, fuse_rooms
        from fusion_core.workflows.fuse.session import FuseOptions

        summary: FuseSummary | RoomsSummary
        with label_layer(self.recording, self.labels, self.label_store, progress) as layer:
            options = FuseOptions(
                preset=self.preset,
                settings_file=self.settings,
                room=room_choice(self.home, self.room, self.subsession),
                virtual_lidar_row=self.virtual_lidar,
                lidar_topic=self.lidar,
                depth_topics=self.depth,
                pose_topic=self.pose,
                extrinsics_file=self.extrinsics,
                apply_clock_offset=self.apply_clock_offset,
                maps=not self.no_maps,
                figures=not self.no_figures,
                truth=self.truth,
                labels=layer,
                seed=self.seed,
                workers=self.workers,
                force=self.force,
                overwrite=self.overwrite,
            )
            if self.home is not None and self.room is None:
                summary = fuse_rooms(self.recording, self.home, self.output, options, progress)
            else:
                summary = fuse(self.recording, self.output, options, progress)
        return Report(result=summary.to_json(), lines=summary.lines())
