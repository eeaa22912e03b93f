"""``scanloom info``: the contents of a recording."""

from dataclasses import dataclass

from fusion_core.model.progress import Progress
from scanloom.commands.options import (
    Flag,
    HomeOption,
    JsonFlag,
    RecordingArgument,
    RoomOption,
    SubsessionOption,
    room_choice,
)
from scanloom.commands.reports import Report, info_lines


@dataclass(frozen=True, kw_only=True)
class Info:
    """What is inside a recording, and what can be done with it."""

    recording: RecordingArgument
    """A recording of any readable format, or the root of a Robot@Home data set."""
    home: HomeOption = None
    """A session of the data set, such as alma-s1."""
    room: RoomOption = None
    subsession: SubsessionOption = 1
    check: Flag = False
    """Read every message and verify every checksum, not just the index. Exit code 1 if anything
    is damaged or unreadable."""
    json: JsonFlag = False

    def require_usage(self) -> None:
        """Raises WrongUsage for options that cannot be, whatever the recording."""
        room_choice(self.home, self.room, self.subsession)

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.info import info

        room = room_choice(self.home, self.room, self.subsession)
        result = info(self.recording, room, self.home, check=self.check, progress=progress)
        damaged = self.check and result["check"]["damaged"]
        return Report(result=result, lines=info_lines(result), failed=damaged)
