"""What is no sound store of this recording is refused with one line, and stays as it was."""

import os
import shutil
import sqlite3
import sys
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import psycopg
import pytest

from fusion_core.annotation import schema, sqlite_database
from fusion_core.annotation.identity import RecordingIdentity
from fusion_core.annotation.store import LabelStore
from fusion_core.model.errors import ExportError, LabelStoreError, ScanLoomError, SettingsError
from fusion_core.model.labels import Capture, CaptureLabels
from tests.annotation.conftest import NewAddress
from tests.annotation.postgresql_server import PASSWORD, Server
from tests.annotation.samples import ANNA, RECORDING, SCAN, labels, state_of

OTHER = RecordingIdentity("hall.mcap", "cd" * 32)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A store of some pages, closed."""
    path = tmp_path / "room.labels.sqlite"
    many = CaptureLabels.of_image(Capture("depth", "/depth", 1, 0, 20, 30), np.full((20, 30), 2))
    with LabelStore.open(path, RECORDING, create=True) as store:
        store.label("anna", [many], ANNA)
        store.undo("anna", "anna")
    return path


def snapshot(folder: Path) -> dict[str, tuple[bytes, int]]:
    """Content and time of each file; the index of a log, which only speeds up reading, aside."""
    return {
        file.name: (file.read_bytes() if file.is_file() else b"", file.lstat().st_mtime_ns)
        for file in folder.iterdir()
        if not file.name.endswith("-shm")
    }


def refusal(path: Path, recording: RecordingIdentity = RECORDING) -> str:
    """The line with which a store is refused, for reading and for writing, without a trace."""
    before = snapshot(path.parent)
    lines = set()
    for create in (False, True):
        with pytest.raises(ScanLoomError) as refused:
            LabelStore.open(path, recording, create=create)
        assert snapshot(path.parent) == before
        lines.add(str(refused.value))
    (line,) = lines
    assert "\n" not in line
    assert str(path) in line
    return line


def test_a_missing_store_is_not_made_for_reading(tmp_path: Path) -> None:
    with pytest.raises(LabelStoreError, match="does not exist"):
        LabelStore.open(tmp_path / "none.sqlite", RECORDING, create=False)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ExportError, match="cannot be written: No such file or directory"):
        LabelStore.open(tmp_path / "none" / "none.sqlite", RECORDING, create=True)


def test_files_of_other_kinds_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "labels.sqlite"
    for content in (b"", b"a text\n", b"SQLite format 3\0", os.urandom(5000)):
        path.write_bytes(content)
        assert "is not a label store of ScanLoom" in refusal(path)
    path.unlink()
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE store (id)")
    connection.close()
    assert "is not a label store of ScanLoom" in refusal(path)


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    assert "Is a directory" in refusal(folder) or "not a regular file" in refusal(folder)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert "not a regular file" in refusal(pipe)
    lost = tmp_path / "link"
    lost.symlink_to(tmp_path / "nowhere")
    assert "does not exist" in refusal(lost)


def test_another_recording_is_refused(path: Path) -> None:
    line = refusal(path, OTHER)
    assert "holds the labels of room.mcap with SHA-256 abababababab…, not of hall.mcap" in line


def test_a_newer_schema_is_refused(path: Path) -> None:
    edit(path, "UPDATE store SET schema_version = 2")
    assert "was written by a newer ScanLoom: schema 2, this one knows 1." in refusal(path)
    # Whatever else is new in it.
    edit(path, "DROP TABLE change")
    assert "was written by a newer ScanLoom" in refusal(path)


@pytest.mark.parametrize(
    ("statement", "problem"),
    [
        ("DROP TABLE change", "its table change is not as ScanLoom makes it"),
        ("ALTER TABLE layer ADD COLUMN colour", "its table layer is not as"),
        ("DROP TABLE store", "it has no table store"),
        ("DELETE FROM store", "it does not say of which recording it is"),
    ],
)
def test_other_tables_are_refused(path: Path, statement: str, problem: str) -> None:
    edit(path, statement)
    assert problem in refusal(path)


@pytest.mark.parametrize("fraction", [0.01, 0.3, 0.6, 0.9, 0.999])
def test_a_truncated_store_is_refused(path: Path, fraction: float) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * fraction)])
    assert "is damaged" in refusal(path)


def test_a_damaged_page_is_refused(path: Path) -> None:
    content = bytearray(path.read_bytes())
    for page in range(1, len(content) // 4096):
        # The kind of the page: https://sqlite.org/fileformat2.html, §1.6.
        damaged = content.copy()
        damaged[4096 * page] = 99
        path.write_bytes(damaged)
        assert "is damaged" in refusal(path)


def edit(path: Path, statement: str) -> None:
    """Change a store as no program of ours does."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute(statement)
    connection.close()


def test_what_a_killed_program_left_is_read_and_not_lost_by_a_refusal(tmp_path: Path) -> None:
    path = tmp_path / "open" / "room.labels.sqlite"
    path.parent.mkdir()
    killed = tmp_path / "killed"
    with LabelStore.open(path, RECORDING, create=True) as store:
        store.label("anna", [labels(SCAN, {(0, 1): 2})], ANNA)
        shutil.copytree(path.parent, killed)
    (killed / (path.name + "-shm")).unlink()
    left = killed / path.name
    assert left.with_name(left.name + "-wal").stat().st_size
    refusal(left, OTHER)
    with LabelStore.open(left, RECORDING, create=False) as store:
        assert state_of(store, "anna") == {SCAN: {(0, 1): 2}}


def test_of_many_that_open_a_recording_first_one_makes_the_store(address: str) -> None:
    stores: list[LabelStore] = []

    def open_and_label(beam: int) -> None:
        store = LabelStore.open(address, RECORDING, create=True)
        store.label("anna", [labels(SCAN, {(0, beam): 1})], ANNA)
        stores.append(store)

    threads = [threading.Thread(target=open_and_label, args=(beam,)) for beam in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for store in stores:
        assert state_of(store, "anna") == {SCAN: {(0, beam): 1 for beam in range(6)}}
        store.close()


def test_what_is_interrupted_while_it_is_made_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "room.labels.sqlite"

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sqlite_database, "make_store", stop)
    with pytest.raises(KeyboardInterrupt):
        LabelStore.open(path, RECORDING, create=True)
    assert list(tmp_path.iterdir()) == []


def test_the_file_is_sqlites_with_a_log(path: Path) -> None:
    """What patches the header must do as ``PRAGMA journal_mode = WAL`` does."""
    connection = sqlite3.connect(path)
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()


@pytest.mark.parametrize(
    "name", ["room?x=1.sqlite", "room#1 %41.sqlite", "räum.sqlite", "a\udcff.sqlite"]
)
def test_files_of_any_name_are_stores(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    for create in (True, False):
        with LabelStore.open(path, RECORDING, create=create) as store:
            store.label("anna", [labels(SCAN, {(0, 1): int(create)})], ANNA)
    assert [file.name for file in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("address", ["mysql://host/labels", "http://host/labels.sqlite"])
def test_databases_of_other_kinds_are_refused(address: str) -> None:
    with pytest.raises(SettingsError, match="labels cannot be kept in"):
        LabelStore.open(address, RECORDING, create=True)


def test_an_address_that_cannot_be_read_is_refused() -> None:
    with pytest.raises(SettingsError, match="address cannot be read"):
        LabelStore.open("postgresql://host:port/labels", RECORDING, create=True)


def test_without_its_driver_postgresql_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "psycopg", None)
    with pytest.raises(SettingsError, match=r"psycopg\. Install it: pip install 'scanloom\["):
        LabelStore.open("postgresql://host/labels", RECORDING, create=True)


def test_a_database_that_is_no_store_is_refused(
    postgresql: Server, new_database: NewAddress
) -> None:
    address = new_database()

    def refused(recording: RecordingIdentity = RECORDING, address: str = address) -> str:
        lines = set()
        for create in (False, True):
            with pytest.raises(ScanLoomError) as error:
                LabelStore.open(address, recording, create=create)
            lines.add(str(error.value))
        (line,) = lines
        assert "\n" not in line
        assert PASSWORD not in line
        return line

    with pytest.raises(LabelStoreError, match="holds no label store"):
        LabelStore.open(address, RECORDING, create=False)
    with psycopg.connect(address) as connection:
        connection.execute("CREATE TABLE other (id int)")
    assert "holds other tables (other)" in refused()
    with psycopg.connect(address) as connection:
        connection.execute("DROP TABLE other")
    LabelStore.open(address, RECORDING, create=True).close()
    assert "not of hall.mcap" in refused(OTHER)
    with psycopg.connect(address) as connection:
        connection.execute("ALTER TABLE input_file DROP COLUMN size")
    assert "its table input_file is not as" in refused()
    with psycopg.connect(address) as connection:
        connection.execute("UPDATE store SET schema_version = 7")
    assert "newer ScanLoom: schema 7" in refused()
    assert "cannot be reached" in refused(address=address.replace("/postgres?", "/missing?"))
    assert "cannot be reached" in refused(address=address.replace(PASSWORD, "wrong"))


JOURNAL = [table.name for table in (schema.layer, schema.capture, schema.action, schema.change)]


@pytest.mark.parametrize("table", JOURNAL)
def test_the_database_itself_refuses_to_alter_the_journal(address: str, table: str) -> None:
    statements = [f"UPDATE {table} SET layer_id = layer_id", f"DELETE FROM {table}"]
    if table in ("layer", "capture"):
        statements[0] = f"UPDATE {table} SET id = id"
    connect: Callable[[str], Any]
    if address.startswith("postgresql"):
        statements.append(f"TRUNCATE {table} CASCADE")
        connect, refused = psycopg.connect, psycopg.errors.RaiseException
    else:
        statements.append(f"INSERT OR REPLACE INTO {table} SELECT * FROM {table}")
        connect, refused = sqlite3.connect, sqlite3.IntegrityError
    with LabelStore.open(address, RECORDING, create=True) as store:
        for beam in (1, 2):
            store.label("anna", [labels(SCAN, {(0, beam): 2})], ANNA)
        for statement in statements:
            with (
                closing(connect(address)) as connection,
                pytest.raises(refused, match="the journal is append-only"),
            ):
                connection.execute(statement)
        assert state_of(store, "anna") == {SCAN: {(0, 1): 2, (0, 2): 2}}
