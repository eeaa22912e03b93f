"""ROS 2 databases (.db3) as containers of messages, intact or damaged."""

import sqlite3
from pathlib import Path

import numpy as np

from fusion_core.recordings.containers import (
    Channel,
    ChecksumReport,
    Entries,
    Payload,
    ros2_type_name,
)
from fusion_core.recordings.rosbag2.sqlite_database import (
    DamagedDatabase,
    Database,
    DatabaseContent,
)

MAGIC = b"SQLite format 3\0"


class SqliteFile:
    """A ROS 2 database. ``offset`` of an entry is the row's id.

    Raises RecordingError for any other database, and for one without readable topics.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings = _warnings_of_files_beside(path)
        self._rows: Database | DamagedDatabase
        try:
            self._rows = Database(path)
        except sqlite3.Error as error:
            self._rows = DamagedDatabase(path, str(error))
        except UnicodeDecodeError:
            self._rows = DamagedDatabase(path, "its schema is no text")
        content = self._rows.content
        self.channels = [_channel(content, topic_id) for topic_id in sorted(content.topics)]
        losses, entries = list(content.losses), content.entries
        nameless = np.count_nonzero(entries["channel"] < 0)
        if nameless:
            entries = entries[entries["channel"] >= 0]
            losses.append(f"messages of topics that it does not name: {nameless}")
        self._entries: Entries | None = entries
        if losses:
            self.warnings.append(f"{path.name}: {'; '.join(losses)}.")

    def index(self) -> Entries:
        """The entries, once: a second copy would be as large as the recording's index."""
        entries, self._entries = self._entries, None
        if entries is None:
            raise ValueError("a file is indexed once")
        return entries

    def payload(self, block: int, offset: int) -> Payload:
        return self._rows.data(block, offset)

    def published_ns(self, block: int, offset: int) -> None:
        """The tables have no such time."""

    def verify(self, entries: Entries) -> ChecksumReport:
        """SQLite has no checksums, but checks its own structure."""
        damage = [f"{self.path.name}: Damaged: {line}." for line in self._rows.problems()]
        return ChecksumReport(unguarded=1, damage=damage)

    def close(self) -> None:
        self._rows.close()


def _channel(content: DatabaseContent, topic_id: int) -> Channel:
    name, message_type, serialization = content.topics[topic_id]
    encoding, text = content.definitions.get(message_type, ("", ""))
    return Channel(
        topic=name,
        message_type=ros2_type_name(message_type),
        serialization=serialization,
        definition=text,
        definition_format="idl" if encoding == "ros2idl" else "msg",
    )


def _warnings_of_files_beside(path: Path) -> list[str]:
    """SQLite keeps the last rows of a recorder that was killed in separate files."""
    warnings = []
    for ending in ("-wal", "-journal"):
        beside = path.with_name(path.name + ending)
        if beside.is_file() and beside.stat().st_size:
            warnings.append(
                f"{beside.name} holds {beside.stat().st_size} bytes that are not read: the "
                f"recorder did not finish. Copy it with {path.name} and open the copy once with "
                "`sqlite3` to join them."
            )
    return warnings
