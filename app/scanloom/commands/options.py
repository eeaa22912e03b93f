"""Options that several commands have, and what is wrong usage of them."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro import conf

if TYPE_CHECKING:
    from fusion_core.workflows.source import RoomChoice


class WrongUsage(Exception):
    """Options that do not go together."""


# An empty hint: "(default: False)" and "(default: None)" tell nobody anything.
Flag = Annotated[bool, conf.arg(help_behavior_hint="")]
RecordingArgument = Annotated[conf.Positional[Path], conf.arg(metavar="RECORDING")]
SettingsOption = Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")]
TopicOption = Annotated[str | None, conf.arg(metavar="TOPIC", help_behavior_hint="")]
HomeOption = Annotated[str | None, conf.arg(metavar="SESSION", help_behavior_hint="")]
RoomOption = Annotated[str | None, conf.arg(metavar="ROOM", help_behavior_hint="")]


# No image has more rows, and no data set more passages through a room.
ROW_MAX = 65_535
SUBSESSION_MAX = 99
# A day, and thirty years.
OFFSET_MAX_MS = 86_400_000.0
TIME_MAX_S = 1e9


def require_natural(option: str, number: int | None, most: int, least: int = 0) -> None:
    """Raises WrongUsage for a number that is not from ``least`` to ``most``."""
    if number is None or least <= number <= most:
        return
    # Python writes out no number of thousands of digits.
    got = f", got {number}" if abs(number) < 10**40 else ""
    must = f"{least} or more" if number < least else f"at most {most}"
    raise WrongUsage(f"{option} must be {must}{got}")


def require_between(option: str, least: float, most: float, *numbers: float | None) -> None:
    """Raises WrongUsage for a number that is not from ``least`` to ``most``, and for NaN."""
    for number in numbers:
        # NaN compares false.
        if number is not None and not least <= number <= most:
            raise WrongUsage(f"{option} must be from {least:g} to {most:g}, got {number:g}")


def room_of(home: str | None, room: str | None, subsession: int) -> "RoomChoice | None":
    """The room that the options name, None for none. Raises WrongUsage without its session."""
    require_natural("--subsession", subsession, SUBSESSION_MAX, least=1)
    if room is None:
        return None
    if home is None:
        raise WrongUsage("--room needs --home, the session that the room is in")
    from fusion_core.workflows.source import RoomChoice

    return RoomChoice(session=home, room=room, subsession=subsession)
