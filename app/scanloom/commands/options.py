"""Options that several commands share, and the checks of their values."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro import conf

if TYPE_CHECKING:
    from fusion_core.workflows.source import RoomChoice


class WrongUsage(Exception):
    """Invalid or contradictory options (exit code 2)."""


PARSER_CONFIG = (conf.OmitArgPrefixes, conf.FlagCreatePairsOff, conf.DisallowNone)
"""How every command line is parsed."""

# Without a hint tyro would print "(default: False)" or "(default: None)".
Flag = Annotated[bool, conf.arg(help_behavior_hint="")]
RecordingArgument = Annotated[conf.Positional[Path], conf.arg(metavar="RECORDING")]
SettingsOption = Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")]
TopicOption = Annotated[str | None, conf.arg(metavar="TOPIC", help_behavior_hint="")]
PointsOption = Annotated[
    str | None,
    conf.arg(
        metavar="TOPIC",
        help="The recording's PointCloud2 topic (default: the one with most messages).",
        help_behavior_hint="",
    ),
]
JointOption = Annotated[
    str | None,
    conf.arg(
        metavar="NAME",
        help="The joint of the axis (default: the one that turns most).",
        help_behavior_hint="",
    ),
]
SongPresetOption = Annotated[
    Literal["default", "published"],
    conf.arg(help="The project's own method, or that of Song 2022."),
]
PresetSettingsOption = Annotated[
    Path | None,
    conf.arg(
        metavar="FILE",
        help="A TOML file whose values override the preset's.",
        help_behavior_hint="",
    ),
]
SeedOption = Annotated[
    int | None,
    conf.arg(
        metavar="N",
        help="Seed of the random draws, overriding the settings'.",
        help_behavior_hint="",
    ),
]
HomeOption = Annotated[str | None, conf.arg(metavar="SESSION", help_behavior_hint="")]
RoomOption = Annotated[
    str | None,
    conf.arg(
        metavar="ROOM",
        help="A room of that session, such as bedroom1.",
        help_behavior_hint="",
    ),
]
SubsessionOption = Annotated[int, conf.arg(help="Which of several passes through that room.")]
ForceFlag = Annotated[
    bool,
    conf.arg(help="Recompute even if the folder already holds this result.", help_behavior_hint=""),
]
OverwriteFolderFlag = Annotated[
    bool,
    conf.arg(
        help="Write into a folder that holds other files or results of another command.",
        help_behavior_hint="",
    ),
]
WorkersOption = Annotated[
    int | None,
    conf.arg(
        metavar="N",
        help="Processes that share in the work (default: one a core); the results are the same.",
        help_behavior_hint="",
    ),
]
JsonFlag = Annotated[bool, conf.arg(help="Print one JSON object on stdout.", help_behavior_hint="")]

# The largest side of an image in the formats that are read.
ROW_MAX = 65_535
# Robot@Home numbers subsessions with one or two digits.
SUBSESSION_MAX = 99
# More than any machine has cores.
WORKERS_MAX = 1024
# One day: clocks farther apart are not those of one recording.
OFFSET_MAX_MS = 86_400_000.0
# 30 years, beyond the length of any recording.
TIME_MAX_S = 1e9


def require_integer(option: str, number: int | None, most: int, least: int = 0) -> None:
    """Raises WrongUsage unless ``least <= number <= most``; None passes."""
    if number is None or least <= number <= most:
        return
    # Python refuses to print integers of thousands of digits.
    got = f", got {number}" if abs(number) < 10**40 else ""
    must = f"{least} or more" if number < least else f"at most {most}"
    raise WrongUsage(f"{option} must be {must}{got}")


def require_in_range(option: str, least: float, most: float, *numbers: float | None) -> None:
    """Raises WrongUsage unless all numbers lie in ``[least, most]``, and for NaN; None passes."""
    for number in numbers:
        # NaN compares false.
        if number is not None and not least <= number <= most:
            raise WrongUsage(f"{option} must be from {least:g} to {most:g}, got {number:g}")


def room_choice(home: str | None, room: str | None, subsession: int) -> "RoomChoice | None":
    """The room that the options name, None for none. Raises WrongUsage if --home is missing."""
    require_integer("--subsession", subsession, SUBSESSION_MAX, least=1)
    if room is None:
        return None
    if home is None:
        raise WrongUsage("--room needs --home, the session that the room is in")
    from fusion_core.workflows.source import RoomChoice

    return RoomChoice(session=home, room=room, subsession=subsession)
