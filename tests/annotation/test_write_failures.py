"""Full disks, read-only folders, locks that stay: one clear line, and nothing half written."""

import os
import resource
import shutil
import signal
import sqlite3
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import numpy as np
import psycopg
import pytest

from fusion_core.annotation import postgresql_database, sqlite_database
from fusion_core.annotation.store import LabelStore
from fusion_core.files.file_state import FileState
from fusion_core.model.errors import ExportError
from fusion_core.model.labels import Capture, CaptureLabels
from tests.annotation.conftest import NewAddress
from tests.annotation.postgresql_server import Server
from tests.annotation.replay import replay
from tests.annotation.samples import ANNA, RECORDING, SCAN, labels, state_of

LARGE = Capture("depth", "/depth", 1, 0, 60, 100)


def many(code: int) -> list[CaptureLabels]:
    """Labels that need some 200 kB."""
    return [CaptureLabels.of_image(LARGE, np.full((60, 100), code))]


def fill(store: LabelStore) -> ExportError:
    """Label until that fails, and then again."""

    def label_on() -> None:
        for number in range(100):
            store.label("anna", many(number % 2), ANNA)

    with pytest.raises(ExportError) as first:
        label_on()
    with pytest.raises(ExportError):
        store.undo("anna", "anna")
    return first.value


def require_usable(store: LabelStore, address: str) -> None:
    """What failed left nothing behind: the journal is whole, and goes on."""
    actions, layers = replay(address)
    assert actions == store.head() > 0
    assert len(layers["anna"]) == LARGE.rows * LARGE.columns
    store.label("anna", [labels(SCAN, {(0, 1): 2})], ANNA)
    assert replay(address)[0] == actions + 1


@contextmanager
def files_limited(count: int) -> Iterator[None]:
    """No file of this process grows beyond ``count`` bytes meanwhile, as on a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (count, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)


def test_a_file_that_cannot_grow_is_told_and_keeps_what_it_has(tmp_path: Path) -> None:
    path = tmp_path / "room.labels.sqlite"
    with LabelStore.open(path, RECORDING, create=True) as store:
        with files_limited(1 << 20):
            error = str(fill(store))
        assert "\n" not in error
        assert str(path) in error
        assert "Nothing of this action was written" in error
        require_usable(store, str(path))


@pytest.fixture
def small_disk() -> Iterator[Path]:
    """A disk of 2 MB, where the tests may make one."""
    folder = Path(tempfile.mkdtemp())
    mount = shutil.which("mount")
    try:
        command = [mount, "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(folder)]
        if mount is None or subprocess.run(command, check=False, capture_output=True).returncode:
            pytest.skip("a small disk can be made by root alone")
        try:
            yield folder
        finally:
            subprocess.run(["umount", "--lazy", str(folder)], check=True)
    finally:
        folder.rmdir()


def fill_disk(folder: Path) -> Path:
    """The file that takes all that is left."""
    ballast = folder / "ballast"
    with ballast.open("wb", buffering=0) as file, suppress(OSError):
        while file.write(bytes(4096)):
            pass
    assert not shutil.disk_usage(folder).free
    return ballast


def test_a_full_disk_is_told_and_nothing_is_half_written(small_disk: Path) -> None:
    path = small_disk / "room.labels.sqlite"
    with LabelStore.open(path, RECORDING, create=True) as store:
        store.label("anna", many(1), ANNA)
        ballast = fill_disk(small_disk)
        error = str(fill(store))
        assert error.startswith(f"{path}: the disk is full. Nothing of this action was written")
        # What is there can still be read, and a program that opens it now reads it too.
        assert len(state_of(store, "anna")[LARGE]) == LARGE.rows * LARGE.columns
        with LabelStore.open(path, RECORDING, create=False) as other:
            assert other.head() == store.head()
        ballast.unlink()
        require_usable(store, str(path))


def test_a_store_that_cannot_be_made_on_a_full_disk_leaves_nothing(small_disk: Path) -> None:
    fill_disk(small_disk)
    path = small_disk / "room.labels.sqlite"
    with pytest.raises(ExportError, match=r"the disk is full|No space left"):
        LabelStore.open(path, RECORDING, create=True)
    assert [file.name for file in small_disk.iterdir()] == ["ballast"]


@pytest.fixture
def read_only() -> Iterator[Callable[[Path], None]]:
    """Makes a folder read-only for this process: by a mount for root, by its rights for others."""
    undo: list[Callable[[], object]] = []

    def make(folder: Path) -> None:
        if os.geteuid():
            folder.chmod(0o500)
            undo.append(lambda: folder.chmod(0o700))
            return
        unmount = ["umount", "--lazy", str(folder)]
        for options in (["--bind", str(folder)], ["-o", "remount,bind,ro"]):
            command = ["mount", *options, str(folder)]
            if subprocess.run(command, check=False, capture_output=True).returncode:
                pytest.skip("a folder cannot be made read-only for root here")
            if "--bind" in options:
                undo.append(lambda: subprocess.run(unmount, check=True))

    yield make
    for step in undo:
        step()


def test_a_store_in_a_read_only_folder_is_read(
    tmp_path: Path, read_only: Callable[[Path], None]
) -> None:
    folder = tmp_path / "given"
    folder.mkdir()
    path = folder / "room.labels.sqlite"
    with LabelStore.open(path, RECORDING, create=True) as store:
        store.label("anna", [labels(SCAN, {(0, 1): 2})], ANNA)
    read_only(folder)
    for create in (False, True):
        with LabelStore.open(path, RECORDING, create=create) as store:
            assert state_of(store, "anna") == {SCAN: {(0, 1): 2}}
            assert store.read_only_because in ("the folder is read-only", "the file is read-only")
            store.remember_digests({FileState("room.mcap", 1, 1): "ab" * 32})
            for write in (
                lambda store=store: store.label("anna", [labels(SCAN, {(0, 1): 3})], ANNA),
                lambda store=store: store.undo("anna", "anna"),
            ):
                with pytest.raises(ExportError, match=r"cannot be written: the f.* is read-only"):
                    write()
    with pytest.raises(ExportError, match="cannot be written"):
        LabelStore.open(folder / "new.sqlite", RECORDING, create=True)
    assert [file.name for file in folder.iterdir()] == [path.name]


def test_a_log_that_a_read_only_folder_keeps_from_being_read_is_told(
    tmp_path: Path, read_only: Callable[[Path], None]
) -> None:
    path = tmp_path / "open" / "room.labels.sqlite"
    path.parent.mkdir()
    killed = tmp_path / "killed"
    with LabelStore.open(path, RECORDING, create=True) as store:
        store.label("anna", [labels(SCAN, {(0, 1): 2})], ANNA)
        shutil.copytree(path.parent, killed)
    (killed / f"{path.name}-shm").unlink()
    read_only(killed)
    with pytest.raises(ExportError, match=r"cannot be read or written"):
        LabelStore.open(killed / path.name, RECORDING, create=False)


def test_a_store_that_others_keep_locked_is_told(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sqlite_database, "LOCK_TIMEOUT_S", 0.1)
    monkeypatch.setattr(postgresql_database, "LOCK_TIMEOUT_S", 0.1)
    with LabelStore.open(address, RECORDING, create=True) as store:
        store.label("anna", [labels(SCAN, {(0, 1): 2})], ANNA)
        if address.startswith("postgresql"):
            other = psycopg.connect(address)
            other.execute("SELECT id FROM store FOR UPDATE")
        else:
            other = sqlite3.connect(address, isolation_level=None)
            other.execute("BEGIN IMMEDIATE")
        with closing(other):
            with pytest.raises(ExportError, match=r"has kept it locked .* Nothing of this action"):
                store.label("anna", [labels(SCAN, {(0, 1): 3})], ANNA)
            assert state_of(store, "anna") == {SCAN: {(0, 1): 2}}
        store.label("anna", [labels(SCAN, {(0, 1): 3})], ANNA)
        assert state_of(store, "anna") == {SCAN: {(0, 1): 3}}


def test_a_server_that_goes_and_comes_is_told_and_used_again(
    postgresql: Server, new_database: NewAddress
) -> None:
    address = new_database()
    with LabelStore.open(address, RECORDING, create=True) as store:
        store.label("anna", [labels(SCAN, {(0, 1): 2})], ANNA)
        postgresql.stop("immediate")
        try:
            with pytest.raises(ExportError, match="the database cannot be reached") as refused:
                store.label("anna", [labels(SCAN, {(0, 1): 3})], ANNA)
        finally:
            postgresql.start()
        assert "\n" not in str(refused.value)
        store.label("anna", [labels(SCAN, {(0, 1): 4})], ANNA)
        assert state_of(store, "anna") == {SCAN: {(0, 1): 4}}


def test_a_person_who_may_not_write_is_told(postgresql: Server, new_database: NewAddress) -> None:
    address = new_database()
    schema = address.rpartition("%3D")[2]
    with LabelStore.open(address, RECORDING, create=True) as store:
        store.label("anna", [labels(SCAN, {(0, 1): 2})], ANNA)
    with psycopg.connect(address, autocommit=True) as connection:
        for statement in (
            "CREATE ROLE guest LOGIN PASSWORD 'guest'",
            f"GRANT USAGE ON SCHEMA {schema} TO guest",
            f"GRANT SELECT ON ALL TABLES IN SCHEMA {schema} TO guest",
        ):
            connection.execute(statement.encode())
    own = address[: address.index("//") + 2] + "guest:guest" + address[address.index("@") :]
    with LabelStore.open(own, RECORDING, create=False) as store:
        assert state_of(store, "anna") == {SCAN: {(0, 1): 2}}
        with pytest.raises(ExportError, match="cannot be written: permission denied"):
            store.label("anna", [labels(SCAN, {(0, 1): 3})], ANNA)
