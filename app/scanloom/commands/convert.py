"""``scanloom convert``: a recording of any format as MCAP."""

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Annotated

from tyro import conf

from fusion_core.model.progress import Progress
from scanloom.commands.options import (
    TIME_MAX_S,
    Flag,
    HomeOption,
    JsonFlag,
    RecordingArgument,
    RoomOption,
    SubsessionOption,
    WrongUsage,
    require_in_range,
    room_choice,
)
from scanloom.commands.reports import Report, conversion_lines


@dataclass(frozen=True, kw_only=True)
class Convert:
    """Convert a recording of any readable format to one ROS 2 MCAP file."""

    recording: RecordingArgument
    """A recording of any format that info reads."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="FILE")]
    """The .mcap file to write."""
    topic: Annotated[conf.UseAppendAction[tuple[str, ...]], conf.arg(metavar="TOPIC")] = ()
    """A topic to write (default: all)."""
    home: HomeOption = None
    """A session of a Robot@Home data set, such as alma-s1, with --room."""
    room: RoomOption = None
    subsession: SubsessionOption = 1
    start: Annotated[float | None, conf.arg(metavar="S", help_behavior_hint="")] = None
    """Skip messages logged less than S seconds after the first one."""
    end: Annotated[float | None, conf.arg(metavar="S", help_behavior_hint="")] = None
    """Skip messages logged S seconds after the first one, or later."""
    overwrite: Flag = False
    """Replace an existing file."""
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        start_s = 0.0 if self.start is None else self.start
        end_s = inf if self.end is None else self.end
        if not 0.0 <= start_s < end_s:
            raise WrongUsage("--start must be 0 or more, and --end later")
        require_in_range("--start", 0.0, TIME_MAX_S, self.start)
        require_in_range("--end", 0.0, TIME_MAX_S, self.end)
        if self.home is not None and self.room is None:
            raise WrongUsage("--home needs --room, the one to convert")
        from fusion_core.workflows.convert import ConvertOptions, convert

        options = ConvertOptions(
            room=room_choice(self.home, self.room, self.subsession),
            topics=self.topic,
            start_s=self.start,
            end_s=self.end,
            overwrite=self.overwrite,
        )
        result = convert(self.recording, self.output, options, progress)
        return Report(result=result, lines=conversion_lines(result))
