"""rh.db of Robot@Home2 as a SQLite file: found by its tables, and queried within bounds.

The file may be damaged or hostile: queries are limited in steps, and values in length.
"""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from fusion_core.model.errors import RecordingError

DATABASE: Final = "rh.db"
_MAGIC: Final = b"SQLite format 3\0"
_NAMES: Final = frozenset({"rh_home_sessions", "rh_rooms", "rh_sensors"})
_ROWS_AT_A_TIME: Final = 4096
# No text of this database is longer than a path.
_MAX_VALUE_BYTES: Final = 1 << 16
# SQLite's own messages are cut after so many characters.
_MAX_PROBLEM: Final = 255
# The pages of a damaged table may form a cycle. The largest query on the published data takes some
# million steps of SQLite's virtual machine; this many take seconds.
_STEPS_AT_A_TIME: Final = 1_000_000
_MAX_STEPS: Final = 200 * _STEPS_AT_A_TIME
# A damaged name in the schema is no text, and SQLite's own message quotes it.
DATABASE_ERRORS: Final = (sqlite3.Error, UnicodeDecodeError)


def find_database(path: Path) -> Path | None:
    """rh.db, for itself or the folder that holds it: a database with the tables of this data set.

    Raises OSError where it cannot be read.
    """
    database = path / DATABASE if path.is_dir() else path
    if not database.is_file():
        return None
    with database.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            return None
    try:
        connection = _connect(database)
        try:
            return database if _list_tables(connection) >= _NAMES else None
        finally:
            connection.close()
    except DATABASE_ERRORS:
        return database if database.name == DATABASE else None


class DatabaseFile:
    """rh.db, opened read-only; ``close`` frees it. ``tables``: the names of its tables.

    Raises one of DATABASE_ERRORS where it cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._connection = _connect(path)
        self._steps = 0
        self._connection.set_progress_handler(self._exceeds_step_limit, _STEPS_AT_A_TIME)
        try:
            self.tables = _list_tables(self._connection)
        except BaseException:
            self._connection.close()
            raise

    def close(self) -> None:
        """Refuse further queries."""
        self._connection.close()

    def query_rows(self, query: str, values: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
        """The rows of a query, a few at a time. Raises RecordingError."""
        self._steps = 0
        try:
            cursor = self._connection.execute(query, values)
            while rows := cursor.fetchmany(_ROWS_AT_A_TIME):
                yield from rows
        except DATABASE_ERRORS as error:
            raise damaged_database_error(self.path, error) from error

    def until_damage(
        self, rows: Iterator[tuple[Any, ...]], table: str, warnings: list[str]
    ) -> Iterator[tuple[Any, ...]]:
        """The rows before the first that cannot be read, of which ``warnings`` then gets a line."""
        count = 0
        try:
            for row in rows:
                count += 1
                yield row
        except RecordingError as error:
            warnings.append(f"{table}: only {count} rows can be read: {error}")

    def _exceeds_step_limit(self) -> bool:
        self._steps += _STEPS_AT_A_TIME
        return self._steps > _MAX_STEPS


def damaged_database_error(database: Path, error: Exception) -> RecordingError:
    """The error for a database that SQLite cannot read."""
    problem = " ".join(str(error).split())[:_MAX_PROBLEM]
    return RecordingError(
        f"is damaged: {problem}.", file=database, advice="Unpack it again from the archive."
    )


def _connect(database: Path) -> sqlite3.Connection:
    # Immutable: SQLite then makes no lock and no journal beside the data.
    connection = sqlite3.connect(
        f"{database.resolve().as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False
    )
    try:
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _MAX_VALUE_BYTES)
        # Without it SQLite refuses a file that is cut short, whatever is still there.
        connection.execute("PRAGMA writable_schema = ON")
    except BaseException:
        connection.close()
        raise
    return connection


def _list_tables(connection: sqlite3.Connection) -> frozenset[str]:
    rows = connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
    return frozenset(name for (name,) in rows)
