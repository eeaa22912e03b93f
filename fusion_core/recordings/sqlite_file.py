"""ROS 2 databases (.db3): rows of a SQLite file."""

import sqlite3
from pathlib import Path

import numpy as np

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.containers import (
    ENTRY,
    Channel,
    Entries,
    Payload,
    damaged,
    entries_from,
    ros2_type_name,
)

MAGIC = b"SQLite format 3\0"
_ROWS_AT_A_TIME = 65536


class SqliteFile:
    """A ROS 2 database. ``offset`` of an entry is the row's id."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: list[Channel] = []
        self.warnings: list[str] = []
        self._numbers: dict[int, int] = {}
        # Immutable: SQLite then makes no lock and no journal beside the recording.
        self._connection = sqlite3.connect(
            f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False
        )
        try:
            self._read_channels()
        except sqlite3.Error as error:
            self._connection.close()
            raise damaged(path, str(error)) from error
        except BaseException:
            self._connection.close()
            raise

    def index(self) -> Entries:
        try:
            cursor = self._connection.execute(
                "SELECT timestamp, topic_id, id FROM messages ORDER BY id"
            )
            parts = [np.empty(0, dtype=ENTRY)]
            while rows := cursor.fetchmany(_ROWS_AT_A_TIME):
                stamps, topics, ids = zip(*rows, strict=True)
                parts.append(entries_from(stamps, [self._numbers[t] for t in topics], 0, ids))
        except (sqlite3.Error, KeyError, OverflowError, ValueError, TypeError) as error:
            raise damaged(self.path, f"its messages ({error})") from error
        return np.concatenate(parts)

    def payload(self, block: int, offset: int) -> Payload:
        try:
            row = self._connection.execute(
                "SELECT data FROM messages WHERE id = ?", (offset,)
            ).fetchone()
        except sqlite3.Error as error:
            raise damaged(self.path, f"row {offset} ({error})") from error
        if row is None or not isinstance(row[0], bytes):
            raise damaged(self.path, f"row {offset} holds no message")
        return row[0]

    def close(self) -> None:
        self._connection.close()

    def _read_channels(self) -> None:
        tables = {
            name
            for (name,) in self._connection.execute(
                "SELECT name FROM sqlite_master WHERE type = 'table'"
            )
        }
        if not {"topics", "messages"} <= tables:
            raise RecordingError(
                "is a SQLite database without the tables of a ROS 2 recording.",
                file=self.path,
                advice="Name the .db3 file that `ros2 bag record` wrote.",
            )
        definitions: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            rows = self._connection.execute(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            )
            definitions = {name: (encoding, text) for name, encoding, text in rows}
        topics = self._connection.execute(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        )
        for number, (topic_id, name, message_type, serialization) in enumerate(topics):
            encoding, text = definitions.get(message_type, ("", ""))
            self._numbers[topic_id] = number
            self.channels.append(
                Channel(
                    topic=name,
                    message_type=ros2_type_name(message_type),
                    serialization=serialization,
                    definition=text,
                    definition_format="idl" if encoding == "ros2idl" else "msg",
                )
            )
