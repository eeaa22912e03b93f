"""Cut, damaged and hostile ROS 2 databases: what can be read, and what the warning says."""

import random
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import apsw
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.rosbag2 import sqlite_database
from fusion_core.recordings.rosbag2.sqlite_file import SqliteFile
from fusion_core.recordings.rosbag2.sqlite_pages import DatabasePages

T0 = 1_700_000_000_000_000_000
SCHEMA = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,
  encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL, type_description_hash TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,
  timestamp INTEGER NOT NULL, data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/String', 'cdr', ''),
  (7, '/b', 'std_msgs/msg/String', 'cdr', '');
INSERT INTO message_definitions VALUES (1, 'std_msgs/msg/String', 'ros2msg', 'string data', '');
"""
Row = tuple[int, int, int, bytes]
FRACTIONS = (0.01, 0.1, 0.5, 0.9, 0.99)


def rows_of(count: int, size: int, seed: int = 1) -> list[Row]:
    rng = random.Random(seed)
    return [(i, (1, 7)[i % 2], T0 + i * 10**7, rng.randbytes(size)) for i in range(1, count + 1)]


def write(path: Path, rows: list[Row], page_bytes: int = 4096, more: str = "") -> Path:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(f"PRAGMA page_size = {page_bytes}")
        connection.executescript(SCHEMA)
        connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        connection.commit()
        connection.executescript(more)
        connection.commit()
    return path


def read(path: Path) -> tuple[list[Row], list[str]]:
    """Every message with its data, and the warnings."""
    with closing(SqliteFile(path)) as file:
        entries = file.index()
        topic_of_channel = {i: {"/a": 1, "/b": 7}[c.topic] for i, c in enumerate(file.channels)}
        rows = [
            (row_id, topic_of_channel[channel], stamp, bytes(file.payload(block, row_id)))
            for stamp, channel, block, row_id in entries.tolist()
        ]
        return rows, file.warnings


def readable_rows(path: Path) -> list[Row]:
    """The rows whose data can be read; topics are left as channels."""
    rows = []
    with closing(SqliteFile(path)) as file:
        for stamp, channel, block, row_id in file.index().tolist():
            try:
                rows.append((row_id, channel, stamp, bytes(file.payload(block, row_id))))
            except RecordingError as error:
                require_one_line(error)
    return rows


def require_one_line(error: RecordingError) -> None:
    assert "\n" not in str(error)
    assert error.advice


def seconds(row: Row) -> str:
    return f"{row[2] / 1e9:.3f} s"


@pytest.mark.parametrize(
    ("fraction", "size"),
    [
        *((fraction, 1000) for fraction in FRACTIONS),
        *((0.5, size) for size in (60, 9000)),
        *(
            pytest.param(fraction, size, marks=pytest.mark.slow)
            for fraction in FRACTIONS
            for size in (60, 9000)
            if fraction != 0.5
        ),
    ],
)
def test_a_truncated_file_gives_its_fraction_of_the_rows(
    tmp_path: Path, size: int, fraction: float
) -> None:
    # Large enough for interior pages, which come after the first of their leaves.
    written = rows_of(min(3_000_000 // size, 25_000), size)
    path = write(tmp_path / "a.db3", written)
    content = path.read_bytes()
    kept = int(fraction * len(content))
    path.write_bytes(content[:kept])
    with closing(sqlite3.connect(path)) as connection, pytest.raises(sqlite3.DatabaseError):
        connection.execute("SELECT count(*) FROM messages").fetchone()

    found, warnings = read(path)
    assert set(found) <= set(written)
    assert [row[0] for row in found] == sorted({row[0] for row in found})
    # What is not a row: the empty pages of the schema, the index, the row at the cut.
    assert len(found) / len(written) >= fraction - 0.015
    assert len(warnings) == 1
    assert f"{len(content) - kept} of {len(content)} bytes are lost" in warnings[0]
    assert f"messages found: {len(found)}" in warnings[0]
    if found:
        assert "any after id" in warnings[0]
        after = int(warnings[0].split("any after id ")[1].split(",")[0])
        assert seconds(written[after - 1]) in warnings[0]
        assert found[-1][0] <= after
        assert f"messages missing: {after - len(found)} (" in warnings[0] or after == len(found)


def test_a_lost_page_loses_only_its_own_rows(tmp_path: Path) -> None:
    written = rows_of(160, 300) + [(i, *row[1:]) for i, row in enumerate(rows_of(6, 9000), 161)]
    path = write(tmp_path / "a.db3", written, page_bytes=1024)
    with closing(apsw.Connection(str(path), flags=apsw.SQLITE_OPEN_READONLY)) as connection:
        pages = connection.execute("SELECT pageno, name, pagetype, ncell FROM dbstat").fetchall()
    content = path.read_bytes()
    costs = []
    for number, name, kind, cells in pages:
        start = (number - 1) * 1024
        # The last page of a row's data holds only data: its loss cannot be noticed.
        ends = kind == "overflow" and content[start : start + 4] == bytes(4)
        if name not in ("messages", "timestamp_idx") or ends:
            continue
        path.write_bytes(content[:start] + bytes(1024) + content[start + 1024 :])
        cost = {"leaf": cells, "internal": 0, "overflow": 1}[kind] if name == "messages" else 0
        costs.append(cost)
        found = {(row[0], row[3]) for row in readable_rows(path)}
        assert len(found) == len(written) - cost, (number, kind)
        assert found <= {(row[0], row[3]) for row in written}
    assert {0, 1, 3} <= set(costs)


def test_a_lost_leaf_is_named_by_ids_and_times(tmp_path: Path) -> None:
    written = rows_of(400, 500)
    path = write(tmp_path / "a.db3", written)
    content = bytearray(path.read_bytes())
    at = content.index(written[199][3]) // 4096 * 4096
    content[at : at + 4096] = bytes(4096)
    path.write_bytes(content)
    found, (warning,) = read(path)
    lost = sorted({row[0] for row in written} - {row[0] for row in found})
    assert 200 in lost
    before, behind = written[lost[0] - 2], written[lost[-1]]
    assert f"messages missing: {len(lost)} (ids {lost[0]} to {lost[-1]})" in warning
    assert f"between {seconds(before)} and {seconds(behind)}" in warning


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    page_bytes=st.sampled_from([512, 1024, 4096, 65536]),
    sizes=st.lists(st.integers(0, 9000), min_size=1, max_size=30),
    stamps=st.lists(st.integers(-(2**63), 2**63 - 1), min_size=30, max_size=30),
    topic_ids=st.lists(st.integers(-300, 300) | st.just(2**40), min_size=30, max_size=30),
    deleted=st.sets(st.integers(1, 30)),
)
def test_pages_hold_what_sqlite_wrote(
    tmp_path: Path,
    page_bytes: int,
    sizes: list[int],
    stamps: list[int],
    topic_ids: list[int],
    deleted: set[int],
) -> None:
    path = tmp_path / "a.db3"
    path.unlink(missing_ok=True)
    rows = [
        (i, topic, stamp, bytes([i]) * size)
        for i, (size, stamp, topic) in enumerate(zip(sizes, stamps, topic_ids, strict=False), 1)
    ]
    # Rows that take the pages of others, so that they are on pages out of sequence.
    later = [(100 + i, 1, i, bytes([200 + i]) * 7000) for i in range(4)]
    write(path, rows, page_bytes)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA secure_delete = ON")
        connection.executemany("DELETE FROM messages WHERE id = ?", [(i,) for i in deleted])
        connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", later)
        connection.commit()
        expected = connection.execute("SELECT * FROM messages ORDER BY id").fetchall()
    with closing(DatabasePages(path)) as pages:
        assert len(pages.cut_rows) == 0
        found = [
            (row["id"], row["topic_id"], row["timestamp"], pages.data(int(row["cell"])))
            for row in pages.rows
        ]
        texts = dict(pages.texts)
    assert found == expected
    assert texts[7][:3] == ("/b", "std_msgs/msg/String", "cdr")


@pytest.mark.parametrize("page_bytes", [512, 4096])
def test_rows_split_among_pages_in_every_way(tmp_path: Path, page_bytes: int) -> None:
    lengths = range(page_bytes - 60, 3 * page_bytes, 1 if page_bytes == 512 else 7)
    # Ids of up to nine bytes.
    ids = [i if i < 50 else i << 56 for i in range(1, 101)] + [2**62 + i for i in lengths]
    rows = [(i, 1, T0, bytes([i % 256]) * n) for i, n in zip(ids, lengths, strict=False)]
    path = write(tmp_path / "a.db3", rows, page_bytes)
    with closing(DatabasePages(path)) as pages:
        found = {int(row["id"]): pages.data(int(row["cell"])) for row in pages.rows}
    assert found == {row[0]: row[3] for row in rows}


def test_a_schema_that_is_no_text(tmp_path: Path) -> None:
    written = rows_of(20, 300)
    path = write(tmp_path / "a.db3", written)
    content = path.read_bytes()
    there = b"timestamp_idx ON messages"
    assert there in content
    # SQLite's own message quotes the name, which Python cannot decode then.
    path.write_bytes(content.replace(there, b"timestamp_idx ON mess\xcbges"))
    rows, warnings = read(path)
    assert rows == written
    assert warnings == ["a.db3: it is damaged (its schema is no text); messages found: 20."]


def test_data_on_a_cycle_of_pages_is_lost(tmp_path: Path) -> None:
    written = rows_of(5, 20_000)
    path = write(tmp_path / "a.db3", written)
    content = bytearray(path.read_bytes())
    # The second page of the third row's data: it names itself as the next one.
    at = content.index(written[2][3][9000:9100]) // 4096 * 4096
    content[at : at + 4] = (at // 4096 + 1).to_bytes(4, "big")
    # By SQLite alone the row would fail only when it is read.
    content[28:32] = (1).to_bytes(4, "big")
    path.write_bytes(content)
    found, (warning,) = read(path)
    assert [row[0] for row in found] == [1, 2, 4, 5]
    assert "messages missing: 1 (id 3)" in warning


def test_rows_after_the_end_that_the_header_states(tmp_path: Path) -> None:
    written = rows_of(300, 500)
    path = write(tmp_path / "a.db3", written)
    content = bytearray(path.read_bytes())
    content[28:32] = (20).to_bytes(4, "big")
    path.write_bytes(content)
    found, warnings = read(path)
    assert found == written
    assert "its size is not the one that its header says" in warnings[0]


def test_a_tree_that_repeats_itself_ends(tmp_path: Path) -> None:
    written = rows_of(3000, 500)
    path = write(tmp_path / "a.db3", written)
    with closing(apsw.Connection(str(path), flags=apsw.SQLITE_OPEN_READONLY)) as connection:
        (inner,) = connection.execute(
            "SELECT min(pageno) FROM dbstat WHERE name = 'messages' AND pagetype = 'internal'"
        ).fetchone()
    content = bytearray(path.read_bytes())
    start = (inner - 1) * 4096
    cells = [
        start + int.from_bytes(content[start + at : start + at + 2], "big")
        for at in range(12, 12 + 2 * int.from_bytes(content[start + 3 : start + 5], "big"), 2)
    ]
    for cell in cells:
        content[cell : cell + 4] = content[cells[0] : cells[0] + 4]
    path.write_bytes(content)
    found, warnings = read(path)
    assert found == written
    assert warnings


def test_mutated_files_are_read_or_refused(tmp_path: Path) -> None:
    written = rows_of(120, 300)
    path = write(tmp_path / "a.db3", written)
    content = path.read_bytes()
    rng = random.Random(5)
    opened = 0
    for _ in range(200):
        data = bytearray(content)
        for _ in range(rng.choice([1, 1, 5, 50])):
            at = rng.randrange(len(data) - 300)
            match rng.randrange(4):
                case 0:
                    data[at] ^= 1 << rng.randrange(8)
                case 1:
                    data[at : at + 4] = rng.choice([b"\xff\xff\xff\xff", bytes(4), b"\x7f\xff"])
                case 2:
                    data[at : at + 100] = data[at + 100 : at + 200]
                case 3:
                    # The positions of page headers.
                    data[at // 4096 * 4096 + rng.randrange(12)] = rng.randrange(256)
        path.write_bytes(data)
        try:
            readable_rows(path)
            opened += 1
        except RecordingError as error:
            require_one_line(error)
    assert opened > 100


def test_no_file_is_changed_or_added(tmp_path: Path) -> None:
    path = write(tmp_path / "a.db3", rows_of(100, 500))
    content = path.read_bytes()[:-5000]
    path.write_bytes(content)
    read(path)
    assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("ending", ["-wal", "-journal"])
def test_rows_in_a_wal_file_are_reported(tmp_path: Path, ending: str) -> None:
    path = write(tmp_path / "a.db3", rows_of(3, 10))
    (tmp_path / f"a.db3{ending}").write_bytes(b"")
    assert read(path)[1] == []
    (tmp_path / f"a.db3{ending}").write_bytes(bytes(100))
    found, (warning,) = read(path)
    assert len(found) == 3
    assert f"a.db3{ending} holds 100 bytes that are not read" in warning


def test_missing_rows_are_reported(tmp_path: Path) -> None:
    written = rows_of(20, 10)
    path = write(tmp_path / "a.db3", written, more="DELETE FROM messages WHERE id IN (1, 2, 8, 9)")
    found, (warning,) = read(path)
    assert len(found) == 16
    assert f"messages missing: 4 (ids 1 to 9), before {seconds(written[9])}" in warning


def test_rows_without_time_or_topic_are_left_out(tmp_path: Path) -> None:
    odd = """
    INSERT INTO messages VALUES (50, 1, 'noon', x'00'), (51, 1, 1.5, x'00');
    INSERT INTO messages VALUES (52, 3, 5, x'00'), (53, 1, 6, x'01');
    """
    path = write(tmp_path / "a.db3", rows_of(3, 10), more=odd)
    found, (warning,) = read(path)
    assert [row[0] for row in found] == [1, 2, 3, 53]
    assert "rows without a time or a topic: 2" in warning
    assert "messages of topics that it does not name: 1" in warning


HOSTILE = {
    "a view": "DROP TABLE messages; CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1"
    " UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 1 AS topic_id, i AS timestamp, x'00' AS data"
    " FROM n",
    "a view of topics": "DROP TABLE topics; CREATE VIEW topics AS WITH RECURSIVE n(i) AS (SELECT 1"
    " UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 'a' AS name, 'b' AS type,"
    " 'cdr' AS serialization_format FROM n",
    "a virtual table": "DROP TABLE messages;"
    " CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)",
    "a computed column": "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY,"
    " topic_id INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(1000000000)))",
    "no key": "DROP TABLE messages;"
    " CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)",
    "lost columns": "ALTER TABLE messages DROP COLUMN data",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_tables_that_are_not_those_of_a_recording(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / "a.db3", [], more=HOSTILE[name])
    with pytest.raises(RecordingError, match="without the tables of a ROS 2 recording"):
        SqliteFile(path)


def test_too_many_topics(tmp_path: Path) -> None:
    numbers = ",".join(f"({n}, '/t{n}', 'a/msg/B', 'cdr', '')" for n in range(8, 10_020))
    more = f"INSERT INTO topics VALUES {numbers}"
    path = write(tmp_path / "a.db3", [], more=more)
    with pytest.raises(RecordingError, match="more than 10000 topics"):
        SqliteFile(path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(RecordingError, match="more than 10000 topics"):
        SqliteFile(path)


@pytest.mark.parametrize("cut", [0, 1])
def test_too_long_names_lose_only_their_topic(tmp_path: Path, cut: int) -> None:
    more = f"""INSERT INTO topics VALUES (8, '{"x" * 2000}', 'a/msg/B', 'cdr', ''),
    (9, 'two\nlines', 'a/msg/B', 'cdr', '');
    INSERT INTO messages VALUES (4, 8, 5, x'00'), (5, 9, 6, x'00')"""
    path = write(tmp_path / "a.db3", rows_of(3, 10), more=more)
    path.write_bytes(path.read_bytes()[: -cut or None])
    found, warnings = read(path)
    assert len(found) == 3
    assert "messages of topics that it does not name: 2" in warnings[0]


@pytest.mark.parametrize("cut", [0, 1])
def test_too_large_data_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut: int
) -> None:
    written = [*rows_of(3, 10), (4, 1, T0, bytes(50_000)), (5, 1, T0, b"end")]
    path = write(tmp_path / "a.db3", written)
    path.write_bytes(path.read_bytes()[: -cut or None])
    monkeypatch.setattr(sqlite_database, "MAX_CHUNK_BYTES", 40_000)
    monkeypatch.setattr("fusion_core.recordings.rosbag2.sqlite_pages.MAX_CHUNK_BYTES", 40_000)
    with closing(SqliteFile(path)) as file:
        entries = file.index()
        assert file.payload(int(entries["block"][-1]), 5) == b"end"
        if cut:
            assert 4 not in entries["offset"]
            assert "(id 4)" in file.warnings[0]
        else:
            with pytest.raises(RecordingError, match="row 4"):
                file.payload(0, 4)


def test_endless_queries_are_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = rows_of(3000, 20)
    path = write(tmp_path / "a.db3", written)
    monkeypatch.setattr(sqlite_database, "_STEPS_AT_A_TIME", 100)
    monkeypatch.setattr(sqlite_database, "_LEAST_STEPS", 1000)
    monkeypatch.setattr(sqlite_database, "_STEPS_PER_BYTE", 0)
    # Where SQLite exceeds the limit, the pages are read.
    found, warnings = read(path)
    assert found == written
    assert "interrupted" in warnings[0]


def test_a_cut_database_of_something_else(tmp_path: Path) -> None:
    path = tmp_path / "other.db3"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE people (name TEXT, town TEXT, street TEXT)")
        connection.executemany("INSERT INTO people VALUES ('a', 'b', ?)", [("c" * 500,)] * 100)
        connection.commit()
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(RecordingError, match=r"cut short or damaged.*its topics are lost"):
        SqliteFile(path)


def test_a_cut_recording_opens_and_decodes(
    build: Callable[[str], Any], same_value: Callable[[Any, Any], bool]
) -> None:
    sample = build("db3")
    content = sample.path.read_bytes()
    sample.path.write_bytes(content[: int(0.8 * len(content))])
    with open_recording(sample.path) as recording:
        found = list(recording.messages())
        assert 0 < len(found) < len(sample.written)
        assert any("bytes are lost" in warning for warning in recording.warnings)
        for message in found:
            expected = [m.value for m in sample.expected if m.topic == message.topic]
            assert any(same_value(message.value, value) for value in expected)
            assert same_value(recording.read(message.topic, message.index), message)


def test_reserved_bytes_at_the_end_of_pages(tmp_path: Path) -> None:
    path = tmp_path / "a.db3"
    with closing(apsw.Connection(str(path))) as connection:
        connection.reserve_bytes(reserve=24)
        connection.execute(SCHEMA)
        connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows_of(20, 9000))
    assert path.read_bytes()[20] == 24
    with closing(DatabasePages(path)) as pages:
        found = [pages.data(int(cell)) for cell in pages.rows["cell"]]
    assert found == [row[3] for row in rows_of(20, 9000)]
