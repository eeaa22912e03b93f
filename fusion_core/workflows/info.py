"""What is inside a recording, or inside a data set of many."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from fusion_core.model.errors import RecordingError
from fusion_core.model.progress import Progress, silent
from fusion_core.recordings.check import IntegrityReport
from fusion_core.recordings.check import check_integrity as check_all
from fusion_core.recordings.info import describe_recording as describe_recording
from fusion_core.recordings.robot_at_home.rooms import is_robot_at_home
from fusion_core.workflows.source import RoomChoice, open_source, rooms_of


def info(
    path: Path,
    room: RoomChoice | None = None,
    session: str | None = None,
    *,
    check: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Format, times, topics and warnings of a recording, ready for JSON.

    A data set of rooms has no times and no topics of its own, but ``rooms``: home, session,
    subsession, room, counts of scans and images, and the bits of a depth. ``room`` looks into one
    of them, ``session`` lists those of one session.

    This reads no more than an index. With ``check`` every message is read: "check" then has what
    could be read of each topic, the number of checksums that are right, and what is damaged; it is
    None without.

    Raises RecordingError where the path cannot be read, and for a check of many rooms at once.
    """
    rooms = rooms_of(path, session) if room is None and _may_hold_rooms(path, session) else ()
    if room is not None or (session is None and len(rooms) <= 1):
        with open_source(path, room) as recording:
            checked = check_all(recording, progress) if check else None
            described = describe_recording(recording)
        if checked is not None:
            warnings = described["warnings"]
            warnings += [line for line in checked.damage if line not in warnings]
        return {**described, "check": None if checked is None else _check_values(checked)}
    if check:
        raise RecordingError(
            f"holds {len(rooms)} rooms, which are checked one by one.",
            file=path,
            advice="Choose one by --home SESSION --room ROOM.",
        )
    return {
        "format": "Robot@Home",
        "start_ns": None,
        "end_ns": None,
        "duration_s": None,
        "topics": [],
        "rooms": [asdict(listing) for listing in rooms],
        "can": ["One room is chosen by --home SESSION --room ROOM."],
        "warnings": [],
        "check": None,
    }


def _check_values(checked: IntegrityReport) -> dict[str, Any]:
    return {
        "damaged": checked.is_damaged,
        "read": sum(topic.read for topic in checked.topics),
        "unreadable": sum(topic.unreadable for topic in checked.topics),
        "checksums": checked.checksums,
        "unguarded": checked.unguarded,
        "topics": [asdict(topic) for topic in checked.topics],
        "damage": list(checked.damage),
    }


def _may_hold_rooms(path: Path, session: str | None) -> bool:
    """Only a data set has sessions; a path that cannot be read is none."""
    try:
        return session is not None or is_robot_at_home(path)
    except OSError:
        return False
