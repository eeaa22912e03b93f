"""What a command works on: a recording of its own, or a room of a Robot@Home data set."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording
from fusion_core.recordings.formats import is_packed as is_packed
from fusion_core.recordings.formats import is_recording as is_recording
from fusion_core.recordings.formats import may_hold_recordings as may_hold_recordings
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.robot_at_home.room import RoomSummary
from fusion_core.recordings.robot_at_home.rooms import is_robot_at_home, list_rooms, open_room


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomChoice:
    """A room of a data set: session "alma-s1", room "bedroom1"; subsessions count from 1."""

    session: str
    room: str
    subsession: int = 1

    def __str__(self) -> str:
        part = f"_{self.subsession}" if self.subsession != 1 else ""
        return f"{self.session}_{self.room}{part}"


def open_source(path: Path, room: RoomChoice | None) -> Recording:
    """The recording at ``path``, or one room of the data set there. Raises RecordingError."""
    if room is None:
        return open_recording(path)
    if not path.exists():
        raise RecordingError("does not exist.", file=path, advice="Check the path.")
    if not is_robot_at_home(path):
        raise RecordingError(
            "is no root of Robot@Home.",
            file=path,
            advice="Name the unpacked data set, or leave --home and --room out.",
        )
    return open_room(path, room.session, room.room, room.subsession)


def input_files(recording: Recording) -> list[Path]:
    """The files and folders that a recording is read from."""
    return paths_of(recording.path)


def paths_of(path: Path) -> list[Path]:
    """The files and folders of the recording at ``path``: the path itself and, for a sequence of
    Robot@Home, the folder of images beside it."""
    images = path.with_suffix("")
    beside = path.suffix == ".txt" and images.is_dir()
    return [path, images] if beside else [path]


def rooms_of(path: Path, session: str | None) -> tuple[RoomSummary, ...]:
    """The rooms of a data set, or of one session. Raises RecordingError where there are none."""
    rooms = list_rooms(path)
    chosen = tuple(room for room in rooms if session in (None, room.session))
    if not chosen:
        there = ", ".join(sorted({room.session for room in rooms}))
        raise RecordingError(f"has no session {session!r}.", file=path, advice=f"There is {there}.")
    return chosen


def room_choices(rooms: tuple[RoomSummary, ...]) -> Iterator[RoomChoice]:
    """The choice that opens each listed room."""
    for room in rooms:
        yield RoomChoice(session=room.session, room=room.room, subsession=room.subsession)
