"""Label stores in PostgreSQL: one database, or one schema of it, for each recording."""

from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, inspect, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError

from fusion_core.annotation import schema
from fusion_core.annotation.database import Database
from fusion_core.annotation.database_errors import LOCK_TIMEOUT_S, explained_errors
from fusion_core.annotation.identity import RecordingIdentity
from fusion_core.annotation.store_check import make_store, require_recording, require_sound
from fusion_core.model.errors import LabelStoreError, SettingsError

_CONNECT_TIMEOUT_S = 10
# Any number will do that other programs in this database are unlikely to choose.
_MAKING_LOCK = 0x5363_4C6C


def open_postgresql(address: str, recording: RecordingIdentity, *, create: bool) -> Database:
    """Open the store at ``postgresql://USER@HOST/DATABASE``, or make it in an empty database.

    Raises SettingsError where the address cannot be read or the driver is missing, LabelStoreError
    where the store is missing or is no sound store of this recording, ExportError where the
    database cannot be reached.
    """
    database = _database(address)
    try:
        with explained_errors(database.place), database.engine.begin() as connection:
            if create:
                # Of two programs that open a recording for the first time, one makes the store.
                connection.execute(text("SELECT pg_advisory_xact_lock(:n)"), {"n": _MAKING_LOCK})
            if not _holds_store(connection, database.place):
                if not create:
                    raise LabelStoreError(
                        "holds no label store.",
                        file=database.place,
                        advice="Label something first, or check the address.",
                    )
                _require_unicode(connection, database.place)
                make_store(connection, recording)
            require_sound(connection, database.place)
            require_recording(connection, database.place, recording)
    except BaseException:
        database.close()
        raise
    return database


def peek_postgresql(address: str) -> Database | None:
    """The store at ``address``, of whichever recording; None where there is none. Raises as
    ``open_postgresql``."""
    database = _database(address)
    try:
        with database.reading() as connection:
            if _holds_store(connection, database.place):
                require_sound(connection, database.place)
                return database
    except BaseException:
        database.close()
        raise
    database.close()
    return None


def _database(address: str) -> Database:
    try:
        url = make_url(address).set(drivername="postgresql+psycopg")
    except (ArgumentError, ValueError) as error:
        raise SettingsError(
            "a label store's address cannot be read.",
            advice="Give a file, or postgresql://USER@HOST/DATABASE.",
        ) from error
    return Database(engine=_engine(url), place=_place(url))


def _place(url: URL) -> str:
    """The address as messages show it: its password stays out of them, wherever it stands."""
    shown = url.set(drivername="postgresql", password=None, query={})
    return shown.render_as_string()


def _engine(url: URL) -> Engine:
    arguments: dict[str, Any] = {"connect_timeout": _CONNECT_TIMEOUT_S}
    try:
        # A connection that the server has closed meanwhile is made anew.
        engine = create_engine(url, pool_pre_ping=True, max_overflow=-1, connect_args=arguments)
    except ModuleNotFoundError as error:
        raise SettingsError(
            "labels in PostgreSQL need its driver, psycopg.",
            advice="Install it: pip install 'scanloom[postgresql]'.",
        ) from error

    @event.listens_for(engine, "connect")
    def connect(connection: Any, record: object) -> None:
        connection.execute(f"SET lock_timeout = {LOCK_TIMEOUT_S * 1000:.0f}")
        # What is streamed is read to its end: a plan for a quick first row takes minutes longer.
        connection.execute("SET cursor_tuple_fraction = 1")
        # A commit is on disk, whatever the server's default; what is stricter stays.
        connection.execute(
            "SELECT set_config('synchronous_commit', 'on', false)"
            " WHERE current_setting('synchronous_commit') = 'off'"
        )
        connection.commit()

    return engine


def _holds_store(connection: Connection, place: str) -> bool:
    tables = set(inspect(connection).get_table_names())
    if schema.store.name in tables or not tables:
        return bool(tables)
    raise LabelStoreError(
        f"holds other tables ({', '.join(sorted(tables)[:3])}).",
        file=place,
        advice="Name a database of its own for the labels of each recording.",
    )


def _require_unicode(connection: Connection, place: str) -> None:
    encoding = connection.execute(text("SHOW server_encoding")).scalar_one()
    if encoding != "UTF8":
        raise LabelStoreError(
            f"keeps text as {encoding}.", file=place, advice="Make it with: createdb -E UTF8."
        )
