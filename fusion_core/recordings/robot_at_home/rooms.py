"""Robot@Home of either version: which rooms a root holds, and one of them as a recording."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording
from fusion_core.recordings.robot_at_home.database import Database
from fusion_core.recordings.robot_at_home.database_file import (
    DATABASE_ERRORS,
    damaged_database_error,
    find_database,
)
from fusion_core.recordings.robot_at_home.plain_text import find_plain_text
from fusion_core.recordings.robot_at_home.rig import BeamSpacing
from fusion_core.recordings.robot_at_home.room import Room, RoomKey, RoomSummary
from fusion_core.recordings.robot_at_home.room_recording import make_recording, summarize_room

_MAX_LISTED = 8


class _DataSet(Protocol):
    def room_keys(self) -> tuple[RoomKey, ...]: ...

    def room(self, key: RoomKey) -> Room: ...

    def close(self) -> None: ...


def is_robot_at_home(path: Path) -> bool:
    """Whether a path is a root of the data set, rh.db, or a part of the plain text."""
    return find_database(path) is not None or find_plain_text(path) is not None


def list_rooms(root: Path) -> tuple[RoomSummary, ...]:
    """Every room of a root, or of the session or room that the path is, sorted by name.

    Raises RecordingError where there is none.
    """
    data = _open(root)
    try:
        return tuple(summarize_room(data.room(key)) for key in data.room_keys())
    finally:
        data.close()


def open_room(
    root: Path,
    session: str,
    room: str,
    subsession: int = 1,
    *,
    beam_spacing: BeamSpacing = "aperture/N",
) -> Recording:
    """One room of a root as a recording.

    Raises RecordingError, naming what there is, for a session, room or subsession that is not.
    """

    def choose(keys: tuple[RoomKey, ...]) -> RoomKey:
        sessions = sorted({key.session for key in keys})
        if session not in sessions:
            raise _unknown_name_error(root, f"session {session!r}", sessions)
        rooms = sorted({key.room for key in keys if key.session == session})
        if room not in rooms:
            raise _unknown_name_error(root, f"room {room!r} in session {session}", rooms)
        wanted = RoomKey(session=session, room=room, subsession=subsession)
        if wanted not in keys:
            there = [str(k.subsession) for k in keys if (k.session, k.room) == (session, room)]
            raise _unknown_name_error(root, f"subsession {subsession} of {session} {room}", there)
        return wanted

    return _open_chosen(root, choose, beam_spacing)


def open_only_room(path: Path) -> Recording:
    """The one room that a path is or holds. Raises RecordingError, naming rooms, for several."""

    def choose(keys: tuple[RoomKey, ...]) -> RoomKey:
        if len(keys) == 1:
            return keys[0]
        shown = ", ".join(map(str, keys[:_MAX_LISTED]))
        more = f" and {len(keys) - _MAX_LISTED} more" if len(keys) > _MAX_LISTED else ""
        raise RecordingError(
            f"holds {len(keys)} rooms of Robot@Home: {shown}{more}.",
            file=path,
            advice="Choose one with --home SESSION --room ROOM.",
        )

    return _open_chosen(path, choose, "aperture/N")


def _open_chosen(
    path: Path, choose: Callable[[tuple[RoomKey, ...]], RoomKey], spacing: BeamSpacing
) -> Recording:
    data = _open(path)
    try:
        return make_recording(data.room(choose(data.room_keys())), spacing)
    except BaseException:
        data.close()
        raise


def _open(path: Path) -> _DataSet:
    """The data set that a path belongs to, which has a room at least."""
    try:
        database = find_database(path)
        data = Database(database) if database is not None else find_plain_text(path)
    except OSError as error:
        raise RecordingError(
            f"cannot be opened: {error.strerror or error}.",
            file=path,
            advice="Check the path and its permissions.",
        ) from error
    except DATABASE_ERRORS as error:
        raise damaged_database_error(path, error) from error
    if data is None or not data.room_keys():
        if data is not None:
            data.close()
        raise RecordingError(
            "holds no room of Robot@Home.",
            file=path,
            advice="Name the folder that holds rh.db, or the one with the unpacked "
            "Robot@Home-dataset_*-all folders.",
        )
    return data


def _unknown_name_error(root: Path, what: str, there: list[str]) -> RecordingError:
    return RecordingError(f"has no {what}.", file=root, advice=f"There is {', '.join(there)}.")
