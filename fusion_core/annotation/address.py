"""Where a label store is: a file, or a database of PostgreSQL."""

import re
from pathlib import Path

from fusion_core.annotation.database import Database
from fusion_core.annotation.identity import RecordingIdentity
from fusion_core.annotation.postgresql_database import open_postgresql, peek_postgresql
from fusion_core.annotation.sqlite_database import open_sqlite, peek_sqlite
from fusion_core.model.errors import SettingsError

_POSTGRESQL = re.compile(r"postgres(ql)?(\+psycopg)?://")
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")


def open_database(address: Path | str, recording: RecordingIdentity, *, create: bool) -> Database:
    """The store's database, made if it is missing and ``create``. Raises as LabelStore.open."""
    place = parse_address(address)
    if isinstance(place, Path):
        return open_sqlite(place, recording, create=create)
    return open_postgresql(place, recording, create=create)


def peek_database(address: Path | str) -> Database | None:
    """The store of whichever recording, for reading what it knows of files; None where there is
    none. Raises as LabelStore.open."""
    place = parse_address(address)
    return peek_sqlite(place) if isinstance(place, Path) else peek_postgresql(place)


def parse_address(address: Path | str) -> Path | str:
    """A file's path, or the address of a database of PostgreSQL as text.

    Raises SettingsError where it names another kind of database.
    """
    if isinstance(address, Path):
        return address
    if _POSTGRESQL.match(address):
        return "postgresql://" + address.partition("://")[2]
    if (url := _URL.match(address)) is not None:
        raise SettingsError(
            f"labels cannot be kept in {url[0]}….",
            advice="Give a file, or postgresql://USER@HOST/DATABASE.",
        )
    return Path(address)
