"""What is inside a recording, or inside a data set of many."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from fusion_core.recordings.info import describe as describe
from fusion_core.recordings.robot_at_home.rooms import is_robot_at_home
from fusion_core.workflows.source import RoomChoice, open_source, rooms_of


def info(path: Path, room: RoomChoice | None = None, session: str | None = None) -> dict[str, Any]:
    """Format, times, topics and warnings of a recording, ready for JSON.

    A data set of rooms has no times and no topics of its own, but ``rooms``: home, session,
    subsession, room, counts of scans and images, and the bits of a depth. ``room`` looks into one
    of them, ``session`` lists those of one session.

    Raises RecordingError where the path cannot be read.
    """
    rooms = rooms_of(path, session) if room is None and _may_hold_rooms(path, session) else ()
    if room is not None or (session is None and len(rooms) <= 1):
        with open_source(path, room) as recording:
            return describe(recording)
    return {
        "format": "Robot@Home",
        "start_ns": None,
        "end_ns": None,
        "duration_s": None,
        "topics": [],
        "rooms": [asdict(listing) for listing in rooms],
        "can": ["One room is chosen by --home SESSION --room ROOM."],
        "warnings": [],
    }


def _may_hold_rooms(path: Path, session: str | None) -> bool:
    """A session is asked of a data set alone; what cannot be looked into is no data set."""
    try:
        return session is not None or is_robot_at_home(path)
    except OSError:
        return False
