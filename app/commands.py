"""The commands, each one call of a function in ``fusion_core.workflows`` or of the server.

The workflows are imported inside the commands, so that ``--help`` is quick.
"""

import json
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro import conf

from app.reports import conversion_lines, info_lines, measure_lines, scene_lines
from app.resources import sample_path
from fusion_core.model.progress import Progress

if TYPE_CHECKING:
    from fusion_core.workflows.source import RoomChoice


@dataclass(frozen=True, kw_only=True)
class Report:
    """What a command has to say: ``result`` for ``--json``, ``lines`` for people."""

    result: dict[str, Any]
    lines: Sequence[str]


class WrongUsage(Exception):
    """Options that do not go together."""


# An empty hint: "(default: False)" and "(default: None)" tell nobody anything.
Flag = Annotated[bool, conf.arg(help_behavior_hint="")]
RecordingArgument = Annotated[conf.Positional[Path], conf.arg(metavar="RECORDING")]
SettingsOption = Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")]
TopicOption = Annotated[str | None, conf.arg(metavar="TOPIC", help_behavior_hint="")]
HomeOption = Annotated[str | None, conf.arg(metavar="SESSION", help_behavior_hint="")]
RoomOption = Annotated[str | None, conf.arg(metavar="ROOM", help_behavior_hint="")]


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
        _require_natural("--virtual-lidar", self.virtual_lidar)
        _require_natural("--port", self.port)
        # The fields' products are small: more threads take more time of more cores. numpy reads
        # this when it is first imported.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        from app.server import ServeOptions, Workbench

        options = ServeOptions(
            recordings=self.recordings,
            roots=self.root,
            host=self.host,
            port=self.port,
            output_root=self.output,
            virtual_row=self.virtual_lidar,
        )
        with Workbench(options) as workbench:
            said = json.dumps({"address": workbench.address}) if self.json else workbench.address
            # Now, not at the end: somebody waits for it.
            sys.stdout.write(f"{said}\n")
            sys.stdout.flush()
            with suppress(KeyboardInterrupt):
                workbench.run()


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
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.inspect import info

        room = _room_of(self.home, self.room, self.subsession)
        result = info(self.recording, room, self.home)
        return Report(result=result, lines=info_lines(result))


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
        if self.home is not None and self.room is None:
            raise WrongUsage("--home needs --room, the one to convert")
        from fusion_core.workflows.convert import ConvertOptions, convert

        options = ConvertOptions(
            room=_room_of(self.home, self.room, self.subsession),
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
    """Write into a folder that holds files of other origin."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def run(self, progress: Progress) -> Report:
        _require_natural("--seed", self.seed)
        _require_natural("--virtual-lidar", self.virtual_lidar)
        from fusion_core.workflows.fuse import FuseSummary, fuse
        from fusion_core.workflows.rooms import RoomsSummary, fuse_rooms
        from fusion_core.workflows.session import FuseOptions

        options = FuseOptions(
            preset=self.preset,
            settings_file=self.settings,
            room=_room_of(self.home, self.room, self.subsession),
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
class _Evaluation:
    fuse_dir: Annotated[conf.Positional[Path], conf.arg(metavar="FUSE_DIR")]
    """A folder that fuse has written."""
    truth: Annotated[conf.Positional[Path], conf.arg(metavar="TRUTH.npz")]
    """The truth of the same recording."""
    lever_arm: Annotated[
        tuple[float, float, float] | None,
        conf.arg(metavar="FORWARD LEFT UP", help_behavior_hint=""),
    ] = None
    """The camera's place seen from the LiDAR (m), for a truth that does not know it."""
    pitch: Annotated[float, conf.arg(metavar="RAD")] = 0.0
    """How far the camera looks down, with --lever-arm."""
    clock_offset_ms: Annotated[float | None, conf.arg(metavar="MS", help_behavior_hint="")] = None
    """Camera stamp less LiDAR stamp of one instant, for a truth that does not know it."""
    json: Flag = False
    """Print one JSON object on stdout."""

    def _report(self, measure: Callable[..., dict[str, Any]], **more: Any) -> Report:
        result = measure(
            self.fuse_dir,
            self.truth,
            lever_arm_m=self.lever_arm,
            pitch_rad=self.pitch,
            clock_offset_ms=self.clock_offset_ms,
            **more,
        )
        return Report(result=result, lines=measure_lines(result))


@dataclass(frozen=True, kw_only=True)
class EvaluateAlignment(_Evaluation):
    """Offset of each frame and yaw of the mount against the truth."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows import evaluate

        return self._report(evaluate.alignment)


@dataclass(frozen=True, kw_only=True)
class EvaluateNoise(_Evaluation):
    """Recall of good pairs and of noise pairs, attribution, and what became of conflicts."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows import evaluate

        return self._report(evaluate.noise)


@dataclass(frozen=True, kw_only=True)
class EvaluateRepair(_Evaluation):
    """Error of the repaired values against the truth, beside plain interpolation."""

    recording: Annotated[Path | None, conf.arg(metavar="RECORDING", help_behavior_hint="")] = None
    """What was fused, for the rivals that fill whole depth images."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows import evaluate

        return self._report(evaluate.repair, recording=self.recording)


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Measure a result against the truth."""

    measure: conf.OmitSubcommandPrefixes[
        Annotated[EvaluateAlignment, conf.subcommand("alignment")]
        | Annotated[EvaluateNoise, conf.subcommand("noise")]
        | Annotated[EvaluateRepair, conf.subcommand("repair")]
    ]


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Write a synthetic recording with its truth."""

    scene: Annotated[
        conf.Positional[str | None], conf.arg(metavar="SCENE", help_behavior_hint="")
    ] = None
    """The name of a scene."""
    output: Annotated[
        Path | None, conf.arg(aliases=["-o"], metavar="FILE", help_behavior_hint="")
    ] = None
    """The recording to write; the truth goes beside it."""
    settings: SettingsOption = None
    """A TOML file whose values go over the scene's."""
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
        _require_natural("--seed", self.seed)
        written = sample.write(
            self.scene,
            self.output,
            settings_file=self.settings,
            seed=self.seed,
            overwrite=self.overwrite,
            progress=progress,
        )
        lines = [f"recording  {written['recording']}", f"truth      {written['truth']}"]
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
        | Annotated[Evaluate, conf.subcommand("evaluate")]
        | Annotated[Sample, conf.subcommand("sample")]
    ]


def _require_natural(option: str, number: int | None) -> None:
    if number is not None and number < 0:
        raise WrongUsage(f"{option} must be 0 or more, got {number}")


def _room_of(home: str | None, room: str | None, subsession: int) -> "RoomChoice | None":
    if room is None:
        return None
    if home is None:
        raise WrongUsage("--room needs --home, the session that the room is in")
    from fusion_core.workflows.source import RoomChoice

    return RoomChoice(session=home, room=room, subsession=subsession)
