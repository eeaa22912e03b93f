"""Label stores in a file of SQLite, with a write-ahead log, flushed to disk at each commit.

https://sqlite.org/wal.html; the file's header: https://sqlite.org/fileformat2.html, §1.3.
"""

import os
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, NullPool, QueuePool, create_engine, event

from fusion_core.annotation.database import SQLITE_BEGIN, Database
from fusion_core.annotation.database_errors import LOCK_TIMEOUT_S, damaged, explained_errors
from fusion_core.annotation.identity import RecordingIdentity
from fusion_core.annotation.store_check import make_store, require_recording, require_sound
from fusion_core.files.atomic import atomic_path, cannot_write
from fusion_core.files.label_store_header import APPLICATION_ID, is_label_store
from fusion_core.files.lock import locked_folder
from fusion_core.files.regular_file import read_head
from fusion_core.model.errors import LabelStoreError, ScanLoomError

_HEADER_BYTES = 100
# Both of the file's format versions, for writing and for reading, are 2 where it has a
# write-ahead log.
_FORMAT_VERSIONS, _WITH_LOG = 18, b"\2\2"


def open_sqlite(path: Path, recording: RecordingIdentity, *, create: bool) -> Database:
    """Open the store at ``path``, or make it.

    Raises LabelStoreError where it is missing or is no sound store of this recording; the file is
    untouched then. Raises ExportError where it cannot be made.
    """
    if create and not os.path.lexists(path):
        _make(path, recording)
    _peek(path, recording)
    reason = _read_only_reason(path)
    engine = _reading_engine(path) if reason else _engine(path, "rw", QueuePool)
    return Database(engine=engine, place=str(path), read_only_because=reason)


def peek_sqlite(path: Path) -> Database | None:
    """The store at ``path``, of whichever recording, for reading alone; None where there is none.

    Raises LabelStoreError where it is no sound store.
    """
    if not os.path.lexists(path):
        return None
    _peek(path, None)
    return Database(engine=_reading_engine(path), place=str(path), read_only_because="only read")


def _make(path: Path, recording: RecordingIdentity) -> None:
    try:
        # Of two programs that open a recording for the first time, one makes the store.
        with locked_folder(path.parent):
            if not os.path.lexists(path):
                with atomic_path(path) as temporary:
                    _build(temporary, recording)
    except OSError as error:
        raise cannot_write(path, error) from error


def _build(path: Path, recording: RecordingIdentity) -> None:
    engine = _engine(path, "rwc", NullPool)
    with explained_errors(str(path)), engine.connect() as connection:
        # Nothing but the file itself: what is interrupted is thrown away whole.
        connection.exec_driver_sql("PRAGMA journal_mode = OFF")
        connection.exec_driver_sql(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.commit()
        with connection.begin():
            make_store(connection, recording)
    # SQLite's own switch would leave a log beside the file where it is interrupted.
    with path.open("r+b") as file:
        file.seek(_FORMAT_VERSIONS)
        file.write(_WITH_LOG)


def _peek(path: Path, recording: RecordingIdentity | None) -> None:
    """Check a store without a trace: no lock, no log, no checkpoint of a killed program's log."""
    _require_own_file(path)

    def check(mode: str) -> None:
        engine = _engine(path, mode, NullPool)
        with explained_errors(str(path)), engine.begin() as connection:
            require_sound(connection, str(path))
            if recording is not None:
                require_recording(connection, str(path), recording)

    mode = _reading_mode(path)
    try:
        check(mode)
    except ScanLoomError:
        if mode == "ro" or _reading_mode(path) != "ro":
            raise
        # Somebody has begun to write meanwhile.
        check("ro")


def _require_own_file(path: Path) -> None:
    try:
        header = read_head(path, _HEADER_BYTES)
    except FileNotFoundError as error:
        raise LabelStoreError(
            "does not exist.", file=path, advice="Label something first, or check the path."
        ) from error
    except OSError as error:
        raise LabelStoreError(
            f"cannot be read: {error.strerror or error}.",
            file=path,
            advice="Name another label store by --labels.",
        ) from error
    if not is_label_store(header):
        raise LabelStoreError(
            "is not a label store of ScanLoom.",
            file=path,
            advice="Name another by --labels; this file was left as it is.",
        )
    if len(header) < _HEADER_BYTES:
        raise damaged(str(path), "it is cut off")


def _read_only_reason(path: Path) -> str:
    if not os.access(path, os.W_OK):
        return "the file is read-only"
    # The log stands beside it.
    if not os.access(path.resolve().parent, os.W_OK):
        return "the folder is read-only"
    return ""


def _reading_mode(path: Path) -> str:
    """``ro`` takes part in SQLite's locking, for which files beside the store are needed, or made;
    ``immutable`` reads the file alone, which has everything where there is no log."""
    log = Path(f"{path.resolve()}-wal")
    return "ro" if log.exists() and log.stat().st_size else "immutable"


def _reading_engine(path: Path) -> Engine:
    return _engine(path, None, NullPool)


def _engine(path: Path, mode: str | None, pool: type[NullPool] | type[QueuePool]) -> Engine:
    """``mode`` None: as a reader needs it, for each connection anew."""

    def connect() -> sqlite3.Connection:
        chosen = mode or _reading_mode(path)
        options = "mode=ro&immutable=1" if chosen == "immutable" else f"mode={chosen}"
        # SQLAlchemy says where a transaction begins (isolation_level), and which thread has it.
        connection = sqlite3.connect(
            f"{path.resolve().as_uri()}?{options}",
            uri=True,
            timeout=LOCK_TIMEOUT_S,
            isolation_level=None,
            check_same_thread=False,
        )
        with closing(connection.cursor()) as cursor:
            cursor.execute("PRAGMA synchronous = FULL")
            cursor.execute("PRAGMA foreign_keys = ON")
        return connection

    # As many connections as threads read.
    options: dict[str, Any] = {"max_overflow": -1} if pool is QueuePool else {}
    engine = create_engine("sqlite://", creator=connect, poolclass=pool, **options)

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        connection.exec_driver_sql(
            str(connection.get_execution_options().get(SQLITE_BEGIN, "BEGIN"))
        )

    return engine
