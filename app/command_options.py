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


def require_natural(option: str, number: int | None) -> None:
    """Raises WrongUsage for a number below 0."""
    if number is not None and number < 0:
        raise WrongUsage(f"{option} must be 0 or more, got {number}")


def room_of(home: str | None, room: str | None, subsession: int) -> "RoomChoice | None":
    """The room that the options name, None for none. Raises WrongUsage without its session."""
    if room is None:
        return None
    if home is None:
        raise WrongUsage("--room needs --home, the session that the room is in")
    from fusion_core.workflows.source import RoomChoice

    return RoomChoice(session=home, room=room, subsession=subsession)
