"""The commands, each one call of a function in ``fusion_core.workflows`` or of the server.

The workflows are imported inside the commands, so that ``--help`` is quick.
"""

import json
import os
import sys
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Annotated, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from fusion_core.model.seeds import SEED_MAX
from scanloom.commands.evaluate import Evaluate
from scanloom.commands.map import Map
from scanloom.commands.options import (
    ROW_MAX,
    TIME_MAX_S,
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
from scanloom.commands.reports import Report, conversion_lines, info_lines, scene_lines
from scanloom.commands.terminal import silence_disconnect_warnings
from scanloom.resources import sample_path
from scanloom.server.listening import LAST_PORT
from scanloom.server.malloc_arenas import limit_arenas


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Serve the workbench: see, question and fuse recordings in the browser."""

    recordings: Annotated[conf.Positional[tuple[Path, ...]], conf.arg(metavar="RECORDING")] = ()
    """What may be opened; the built-in recording when none is named."""
    root: Annotated[conf.UseAppendAction[tuple[Path, ...]], conf.arg(metavar="DIR")] = ()
    """A folder whose recordings may be opened too."""
    host: str = "127.0.0.1"
    """The address to listen on. Any but a loopback one asks for the token that is printed."""
    port: int = 8080
    """The port; the next free one where it is taken, any with 0."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="DIR")] = Path("out")
    """The folder that exports are written to."""
    virtual_lidar: Annotated[int | None, conf.arg(metavar="ROW", help_behavior_hint="")] = None
    """Cut a virtual LiDAR curve from this row of the depth images of the first recording."""
    json: Flag = False
    """Print the address as a JSON object."""

    def run(self, progress: Progress) -> None:
        require_natural("--virtual-lidar", self.virtual_lidar, ROW_MAX)
        require_natural("--port", self.port, LAST_PORT)
        # The fields' products are small: more threads take more time of more cores. numpy reads
        # this when it is first imported.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        limit_arenas()
        from scanloom.commands.interruption import interruption
        from scanloom.server.workbench import ServeOptions, Workbench

        options = ServeOptions(
            recordings=self.recordings,
            roots=self.root,
            host=self.host,
            port=self.port,
            output_root=self.output,
            virtual_row=self.virtual_lidar,
        )
        workbench = Workbench(options)
        silence_disconnect_warnings()
        # From here on it serves, and Ctrl-C is how it ends.
        with interruption() as interrupted, workbench:
            said = json.dumps({"address": workbench.address}) if self.json else workbench.address
            # Now, not at the end: somebody waits for it.
            sys.stdout.write(f"{said}\n")
            sys.stdout.flush()
            interrupted.wait()


@dataclass(frozen=True, kw_only=True)
class Info:
    """What is inside a recording, and what can be done with it."""

    recording: RecordingArgument
    """A recording of any readable format, or the root of a Robot@Home data set."""
    home: HomeOption = None
    """A session of the data set, such as alma-s1."""
    room: RoomOption = None
    """A room of that session, such as bedroom1."""
    subsession: int = 1
    """The passage through that room, where there are several."""
    check: Flag = False
    """Read every message and verify every checksum, not the index alone. Exit code 1 if anything
    is damaged or cannot be read."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.info import info

        room = room_of(self.home, self.room, self.subsession)
        result = info(self.recording, room, self.home, check=self.check, progress=progress)
        damaged = self.check and result["check"]["damaged"]
        return Report(result=result, lines=info_lines(result), failed=damaged)


@dataclass(frozen=True, kw_only=True)
class Convert:
    """Write a recording of any format as one ROS 2 MCAP, so that other tools can open it."""

    recording: RecordingArgument
    """A recording of any format that info reads."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="FILE")]
    """The .mcap file to write."""
    topic: Annotated[conf.UseAppendAction[tuple[str, ...]], conf.arg(metavar="TOPIC")] = ()
    """A topic to write, where it should not be all of them."""
    home: HomeOption = None
    """A session of a Robot@Home data set, such as alma-s1, with --room."""
    room: RoomOption = None
    """A room of that session, such as bedroom1."""
    subsession: int = 1
    """The passage through that room, where there are several."""
    start: Annotated[float | None, conf.arg(metavar="S", help_behavior_hint="")] = None
    """Leave out what was logged less than S seconds after the first message."""
    end: Annotated[float | None, conf.arg(metavar="S", help_behavior_hint="")] = None
    """Leave out what was logged S seconds after the first message, and later."""
    overwrite: Flag = False
    """Replace a file that is already there."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        start_s = 0.0 if self.start is None else self.start
        end_s = inf if self.end is None else self.end
        if not 0.0 <= start_s < end_s:
            raise WrongUsage("--start must be 0 or more, and --end later")
        require_between("--start", 0.0, TIME_MAX_S, self.start)
        require_between("--end", 0.0, TIME_MAX_S, self.end)
        if self.home is not None and self.room is None:
            raise WrongUsage("--home needs --room, the one to convert")
        from fusion_core.workflows.convert import ConvertOptions, convert

        options = ConvertOptions(
            room=room_of(self.home, self.room, self.subsession),
            topics=self.topic,
            start_s=self.start,
            end_s=self.end,
            overwrite=self.overwrite,
        )
        result = convert(self.recording, self.output, options, progress)
        return Report(result=result, lines=conversion_lines(result))


@dataclass(frozen=True, kw_only=True)
class Fuse:
    """Align LiDAR and depth, find the noise, repair both, and build the maps of a recording."""

    recording: RecordingArgument
    """A recording with a 2D LiDAR and a depth camera, depth alone with --virtual-lidar, or the
    root of a Robot@Home data set with --home."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="DIR")]
    """The folder for the results."""
    preset: Literal["default", "published"] = "default"
    """The project's own settings, or those of Xu 2024."""
    settings: SettingsOption = None
    """A TOML file whose values go over the preset's."""
    home: HomeOption = None
    """A session of the data set, such as alma-s1: all its rooms, and Table 1, unless --room."""
    room: RoomOption = None
    """A room of that session, such as bedroom1."""
    subsession: int = 1
    """The passage through that room, where there are several."""
    lidar: TopicOption = None
    """The LaserScan topic, where it should not be found by type."""
    depth: Annotated[conf.UseAppendAction[tuple[str, ...]], conf.arg(metavar="TOPIC")] = ()
    """A depth image topic, where it should not be found by type."""
    pose: TopicOption = None
    """The topic that gives the poses of the maps (TF, else odometry, unless named)."""
    virtual_lidar: Annotated[int | None, conf.arg(metavar="ROW", help_behavior_hint="")] = None
    """Cut a virtual LiDAR curve from this row (0-based) of the depth images."""
    apply_clock_offset: Flag = False
    """Shift the camera's stamps by the clock offset found."""
    no_maps: Flag = False
    """Leave the maps out."""
    no_figures: Flag = False
    """Leave the figures out."""
    truth: Annotated[Path | None, conf.arg(metavar="TRUTH.npz", help_behavior_hint="")] = None
    """The truth of a simulated recording, for the figure of noise recall."""
    seed: Annotated[int | None, conf.arg(help_behavior_hint="")] = None
    """Another seed of the random draws than the settings'."""
    force: Flag = False
    """Work again where the folder already holds this very result."""
    overwrite: Flag = False
    """Write beside files of other origin, and in place of the results of another command."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        require_natural("--seed", self.seed, SEED_MAX)
        require_natural("--virtual-lidar", self.virtual_lidar, ROW_MAX)
        from fusion_core.workflows.fuse.fuse import FuseSummary, fuse
        from fusion_core.workflows.fuse.rooms import RoomsSummary, fuse_rooms
        from fusion_core.workflows.fuse.session import FuseOptions

        options = FuseOptions(
            preset=self.preset,
            settings_file=self.settings,
            room=room_of(self.home, self.room, self.subsession),
            virtual_lidar_row=self.virtual_lidar,
            lidar_topic=self.lidar,
            depth_topics=self.depth,
            pose_topic=self.pose,
            apply_clock_offset=self.apply_clock_offset,
            maps=not self.no_maps,
            figures=not self.no_figures,
            truth=self.truth,
            seed=self.seed,
            force=self.force,
            overwrite=self.overwrite,
        )
        summary: FuseSummary | RoomsSummary
        if self.home is not None and self.room is None:
            summary = fuse_rooms(self.recording, self.home, self.output, options, progress)
        else:
            summary = fuse(self.recording, self.output, options, progress)
        return Report(result=summary.to_json(), lines=summary.lines())


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Write a synthetic recording with its truth and the outline of its world."""

    scene: Annotated[
        conf.Positional[str | None], conf.arg(metavar="SCENE", help_behavior_hint="")
    ] = None
    """The name of a scene."""
    output: Annotated[
        Path | None, conf.arg(aliases=["-o"], metavar="FILE", help_behavior_hint="")
    ] = None
    """The recording to write (.mcap); truth and world go beside it."""
    settings: SettingsOption = None
    """A TOML file whose values go over the scene's: tables scene and faults."""
    seed: Annotated[int | None, conf.arg(help_behavior_hint="")] = None
    """Another seed than the scene's own."""
    overwrite: Flag = False
    """Replace files that are already there."""
    list: Flag = False
    """Name the scenes and the built-in recording."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows import sample

        if self.list:
            known = sample.scenes()
            result = {"scenes": known, "built_in": str(sample_path())}
            return Report(result=result, lines=scene_lines(result))
        if self.scene is None or self.output is None:
            raise WrongUsage("sample needs SCENE and -o FILE, or --list; see sample --help")
        require_natural("--seed", self.seed, SEED_MAX)
        written = sample.write(
            self.scene,
            self.output,
            settings_file=self.settings,
            seed=self.seed,
            overwrite=self.overwrite,
            progress=progress,
        )
        lines = [f"{name:<11}{written[name]}" for name in ("recording", "truth", "world")]
        return Report(result=written, lines=lines)


@dataclass(frozen=True, kw_only=True)
class Scanloom:
    """Lay a 2D LiDAR curve over the rows of a depth image, judge the noise, repair each sensor
    from the other, export the fused map. `scanloom --version` prints the version.
    """

    command: conf.OmitSubcommandPrefixes[
        Annotated[Serve, conf.subcommand("view")]
        | Annotated[Info, conf.subcommand("info")]
        | Annotated[Convert, conf.subcommand("convert")]
        | Annotated[Fuse, conf.subcommand("fuse")]
        | Annotated[Map, conf.subcommand("map")]
        | Annotated[Evaluate, conf.subcommand("evaluate")]
        | Annotated[Sample, conf.subcommand("sample")]
    ]
