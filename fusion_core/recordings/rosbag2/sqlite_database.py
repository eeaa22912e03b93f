"""The tables of a ROS 2 database: read by SQLite, or from its pages where it is damaged."""

import sqlite3
from array import array
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.model.conventions import NS_PER_MS, IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.containers import (
    ENTRY,
    MAX_CHUNK_BYTES,
    Entries,
    damaged_file_error,
    make_entries,
)
from fusion_core.recordings.rosbag2.sqlite_pages import (
    HEADER_BYTES,
    DatabasePages,
    Rows,
    read_header,
)

_ROWS_AT_A_TIME = 65536
# Recordings have some hundreds of topics, and ROS limits names to 255 bytes.
_MAX_TOPICS = 10_000
_MAX_NAME_CHARS = 1024
_MAX_DEFINITION_CHARS = 1 << 20
_COLUMNS: Mapping[str, frozenset[str]] = {
    "topics": frozenset({"id", "name", "type", "serialization_format"}),
    "messages": frozenset({"id", "topic_id", "timestamp", "data"}),
    "message_definitions": frozenset({"topic_type", "encoding", "encoded_message_definition"}),
}
# Steps of SQLite's virtual machine that opening may take, in proportion to the file's size.
_STEPS_AT_A_TIME = 1_000_000
_LEAST_STEPS = 50_000_000
_STEPS_PER_BYTE = 10
_MAX_LISTED = 5
# The second where SQLite's own message quotes bytes of the file that are no UTF-8.
_DAMAGE = (sqlite3.Error, UnicodeDecodeError)
Topics = dict[int, tuple[str, str, str]]


@dataclass(frozen=True, slots=True)
class DatabaseContent:
    """Contents of a database.

    ``topics``: (name, type, serialization) by id. ``definitions``: (encoding, text) by type. The
    channel of an entry is the rank of its topic's id, or -1 for a topic that is missing.
    ``losses``: what is lost, as parts of a sentence.
    """

    topics: Topics
    definitions: dict[str, tuple[str, str]]
    entries: Entries
    losses: list[str]


class Database:
    """Read through SQLite. Raises _DAMAGE where the file is damaged."""

    def __init__(self, path: Path) -> None:
        self._path = path
        # Immutable: SQLite then makes no lock and no journal beside the recording.
        self._connection = sqlite3.connect(
            f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True, check_same_thread=False
        )
        self._forward: sqlite3.Cursor | None = None
        self._next_id: int | None = None
        try:
            self._guard()
            self.content = self._read()
            self._connection.set_progress_handler(None, 0)
        except BaseException:
            self._connection.close()
            raise

    def data(self, block: int, row_id: int) -> bytes:
        """The data of the message with this id. Raises RecordingError."""
        row = self._next_row(row_id)
        self._next_id = row_id + 1
        if row is None:
            try:
                row = self._connection.execute(
                    "SELECT id, data FROM messages WHERE id = ?", (row_id,)
                ).fetchone()
            except _DAMAGE as error:
                raise damaged_file_error(self._path, f"row {row_id} ({error})") from error
        if row is None or not isinstance(row[1], bytes):
            raise damaged_file_error(self._path, f"row {row_id} holds no message")
        return bytes(row[1])

    def problems(self) -> list[str]:
        """The first problems that SQLite's integrity check finds."""
        try:
            rows = self._connection.execute(f"PRAGMA integrity_check({_MAX_LISTED})").fetchall()
        except _DAMAGE as error:
            return [str(error)]
        lines = [line for (text,) in rows for line in str(text).splitlines()]
        return [] if lines == ["ok"] else lines

    def _next_row(self, row_id: int) -> tuple[int, object] | None:
        """The row with this id if it follows the row that was read last, else None.

        Iteration reads row after row with one query. That query reads one row ahead, so it is not
        used for single rows, and an error of it may be about another row: None then, too.
        """
        forward, self._forward = self._forward, None
        if row_id != self._next_id:
            return None
        try:
            if forward is None:
                forward = self._connection.execute(
                    "SELECT id, data FROM messages NOT INDEXED WHERE id >= ? ORDER BY id", (row_id,)
                )
            row: tuple[int, object] | None = forward.fetchone()
        except _DAMAGE:
            return None
        if row is None or row[0] != row_id:
            return None
        self._forward = forward
        return row

    def close(self) -> None:
        self._forward = None
        self._connection.close()

    def _guard(self) -> None:
        """Settings that SQLite advises for untrusted files (sqlite.org/security.html)."""
        connection = self._connection
        connection.execute("PRAGMA trusted_schema = OFF")
        connection.execute("PRAGMA cell_size_check = ON")
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
        connection.text_factory = _text
        steps = max(_LEAST_STEPS, _STEPS_PER_BYTE * self._path.stat().st_size)
        calls = iter(range(steps // _STEPS_AT_A_TIME))
        connection.set_progress_handler(lambda: next(calls, None) is None, _STEPS_AT_A_TIME)

    def _read(self) -> DatabaseContent:
        with self._path.open("rb") as file:
            claimed = read_header(file.read(HEADER_BYTES)).claimed_bytes
        if claimed not in (0, self._path.stat().st_size):
            # A recorder that was killed leaves rows after the end that the header states.
            raise sqlite3.DatabaseError("its size is not the one that its header says")
        if not (self._has_table("topics") and self._has_table("messages")):
            raise RecordingError(
                "is a SQLite database without the tables of a ROS 2 recording.",
                file=self._path,
                advice="Name the .db3 file that `ros2 bag record` wrote.",
            )
        definitions = self._definitions() if self._has_table("message_definitions") else {}
        topics = self._topics()
        entries, invalid_rows = self._messages(topics)
        if invalid_rows:
            losses = [f"rows without a time or a topic: {invalid_rows}"]
        else:
            losses = _missing_ids(entries["offset"], entries["received_ns"])
        return DatabaseContent(topics, definitions, entries, losses)

    def _has_table(self, name: str) -> bool:
        """Whether there is this table of rosbag2, with stored columns: no view or virtual table."""
        there = self._connection.execute(
            "SELECT 1 FROM sqlite_master WHERE type = 'table' AND rootpage > 0 AND name = ?",
            (name,),
        ).fetchone()
        columns = self._connection.execute(f"PRAGMA table_xinfo({name})").fetchall()
        stored = {column for _, column, _, _, _, _, hidden in columns if not hidden}
        keys = [column for _, column, _, _, _, key, _ in columns if key]
        return there is not None and stored >= _COLUMNS[name] and keys == ["id"]

    def _topics(self) -> Topics:
        rows = self._connection.execute(
            "SELECT id, substr(name, 1, ?1), substr(type, 1, ?1),"
            " substr(serialization_format, 1, ?1) FROM topics ORDER BY id LIMIT ?2",
            (_MAX_NAME_CHARS + 1, _MAX_TOPICS + 1),
        )
        return _named_topics(self._path, ((row[0], row[1:]) for row in rows))

    def _definitions(self) -> dict[str, tuple[str, str]]:
        rows = self._connection.execute(
            "SELECT substr(topic_type, 1, ?1), substr(encoding, 1, ?1),"
            " substr(encoded_message_definition, 1, ?2) FROM message_definitions LIMIT ?3",
            (_MAX_NAME_CHARS, _MAX_DEFINITION_CHARS + 1, _MAX_TOPICS),
        )
        return _readable_definitions(rows)

    def _messages(self, topics: Topics) -> tuple[Entries, int]:
        """The entries of all messages, and how many rows have no time or no topic."""
        cursor = self._connection.execute(
            # Not by an index, which could lack rows or have another order.
            "SELECT id, topic_id, timestamp FROM messages NOT INDEXED ORDER BY id"
        )
        parts = [np.empty(0, dtype=ENTRY)]
        invalid_rows, last = 0, -(1 << 63)
        while rows := cursor.fetchmany(_ROWS_AT_A_TIME):
            try:
                part = _columns(rows)
            except TypeError:
                right = [row for row in rows if all(isinstance(value, int) for value in row)]
                invalid_rows += len(rows) - len(right)
                part = _columns(right)
            ids, topic_ids, stamps_ns = part
            # A damaged tree with a cycle would give rows for ever.
            if len(ids) and (ids[0] <= last or np.any(np.diff(ids) <= 0)):
                raise sqlite3.DatabaseError("its rows are not in order")
            last = int(ids[-1]) if len(ids) else last
            parts.append(make_entries(stamps_ns, _channels(topics, topic_ids), 0, ids))
        return np.concatenate(parts), invalid_rows


class DamagedDatabase:
    """Read page by page. Raises RecordingError where no topic is left."""

    def __init__(self, path: Path, problem: str) -> None:
        self._pages = DatabasePages(path)
        try:
            self.content = self._read(path, problem)
        except BaseException:
            self._pages.close()
            raise

    def data(self, cell: int, row_id: int) -> bytes:
        """The data of the message at a cell, the block of its entry. Raises RecordingError."""
        return self._pages.data(cell)

    def problems(self) -> list[str]:
        """None besides the losses in ``content``."""
        return []

    def close(self) -> None:
        self._pages.close()

    def _read(self, path: Path, problem: str) -> DatabaseContent:
        pages = self._pages
        # The second text of a topic is its type, that of a definition its encoding.
        topics = [(row_id, texts) for row_id, texts in pages.texts if "/" in texts[1]]
        named = _named_topics(path, topics)
        if not named:
            raise damaged_file_error(path, f"{problem}, and its topics are lost")
        definitions = (texts for _, texts in pages.texts if "/" not in texts[1])
        rows, cut = pages.rows, pages.cut_rows
        lost_bytes = pages.header.claimed_bytes - pages.size
        if lost_bytes > 0:
            losses = [f"it is cut short: {lost_bytes} of {lost_bytes + pages.size} bytes are lost"]
        else:
            losses = [f"it is damaged ({problem})"]
        losses.append(f"messages found: {len(rows)}")
        losses += _missing_ids(rows["id"], rows["timestamp"], cut)
        if lost_bytes > 0:
            losses.append(_lost_at_the_end(rows, cut))
        channels = _channels(named, rows["topic_id"])
        entries = make_entries(rows["timestamp"], channels, rows["cell"], rows["id"])
        pages.rows = pages.cut_rows = rows[:0].copy()
        return DatabaseContent(named, _readable_definitions(definitions), entries, losses)


def _channels(topics: Topics, topic_ids: IntArray) -> IntArray:
    """The place of each topic among all by rising id; -1 for one that is not there."""
    known = np.array(sorted(topics) or [0], dtype=np.int64)
    places = np.minimum(np.searchsorted(known, topic_ids), len(known) - 1)
    return np.where((known[places] == topic_ids) & (len(topics) > 0), places, -1)


def _named_topics(path: Path, rows: Iterable[tuple[int, tuple[object, ...]]]) -> Topics:
    """Topics by id. One with invalid names is left out; its messages are reported as lost."""
    topics: Topics = {}
    for number, (row_id, names) in enumerate(rows):
        if number >= _MAX_TOPICS:
            raise RecordingError(
                f"has more than {_MAX_TOPICS} topics.",
                file=path,
                advice="No recorder writes that many; check where the file comes from.",
            )
        name, message_type, serialization = names[:3]
        if (
            isinstance(name, str)
            and isinstance(message_type, str)
            and isinstance(serialization, str)
            and max(len(name), len(message_type), len(serialization)) <= _MAX_NAME_CHARS
            and (name + message_type + serialization).isprintable()
        ):
            topics.setdefault(row_id, (name, message_type, serialization))
    return topics


def _readable_definitions(rows: Iterable[tuple[object, ...]]) -> dict[str, tuple[str, str]]:
    """Encoding and text by type."""
    definitions = {}
    for message_type, encoding, text, *_ in rows:
        if (
            isinstance(message_type, str)
            and isinstance(encoding, str)
            and isinstance(text, str)
            and len(text) <= _MAX_DEFINITION_CHARS
        ):
            definitions[message_type] = (encoding, text)
    return definitions


def _missing_ids(ids: IntArray, stamps_ns: IntArray, cut: Rows | None = None) -> list[str]:
    """A text on the ids missing between 1, a recorder's first, and the last known one; or none.

    ``cut``: rows whose id is known and whose data is lost.
    """
    known, times = ids, stamps_ns
    lost_ids = np.empty(0, dtype=np.int64)
    if cut is not None and len(cut):
        lost_ids = cut["id"]
        known = np.concatenate([ids, lost_ids])
        order = np.argsort(known)
        known, times = known[order], np.concatenate([stamps_ns, cut["timestamp"]])[order]
    before = np.concatenate([[0], known[:-1]])
    gaps = np.flatnonzero(known - before > 1)
    count = int(np.sum(known[gaps] - before[gaps] - 1)) + len(lost_ids)
    if not count:
        return []
    first = int(min([*lost_ids[:1], *(before[gaps[:1]] + 1)]))
    last = int(max([*lost_ids[-1:], *(known[gaps[-1:]] - 1)]))
    # The nearest known rows, and the lost ones themselves where their time is known.
    since, until = np.searchsorted(known, first, side="right") - 1, np.searchsorted(known, last)
    begin = f"between {_seconds(times[since])} and" if since >= 0 else "before"
    span = f"ids {first} to {last}" if last > first else f"id {first}"
    return [f"messages missing: {count} ({span}), {begin} {_seconds(times[until])}"]


def _lost_at_the_end(rows: Rows, cut: Rows) -> str:
    ends = np.concatenate([rows[-1:], cut[-1:]])
    if not len(ends):
        return "all messages are lost"
    last = ends[np.argmax(ends["id"])]
    return f"any after id {last['id']}, that is after {_seconds(last['timestamp'])}, are lost"


def _seconds(time_ns: np.int64) -> str:
    return f"{int(time_ns) // NS_PER_MS / 1000:.3f} s"


def _columns(rows: list[tuple[int, int, int]]) -> IntArray:
    """(3, N) of rows of integers. Raises TypeError for any other value."""
    # An array accepts integers only; numpy would round floats and parse texts.
    columns: Iterator[tuple[int, ...]] = zip(*rows, strict=True) if rows else iter([(), (), ()])
    return np.array([np.frombuffer(array("q", column), dtype=np.int64) for column in columns])


def _text(content: bytes) -> str:
    return content.decode(errors="replace")
