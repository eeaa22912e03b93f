"""Digests of a recording's files, kept in its label store: they are not read at each opening."""

from collections.abc import Mapping
from pathlib import Path

from sqlalchemy import insert, select

from fusion_core.annotation.address import peek_database
from fusion_core.annotation.database import Database
from fusion_core.annotation.schema import input_file
from fusion_core.files.file_state import FileState


def known_digests(address: Path | str) -> dict[FileState, str]:
    """SHA-256 of the files that the store at ``address`` has seen; nothing where there is none.

    Raises as LabelStore.open, but for the recording's identity, which it helps to find.
    """
    database = peek_database(address)
    if database is None:
        return {}
    try:
        return _read(database)
    finally:
        database.close()


def remember_digests(database: Database, digests: Mapping[FileState, str]) -> None:
    """Add the digests that the store does not have."""
    if not digests.keys() - _read(database).keys():
        return
    with database.writing() as connection:
        there = {FileState(*row[:3]) for row in connection.execute(select(input_file))}
        new = [
            {**state._asdict(), "sha256": sha256}
            for state, sha256 in digests.items()
            if state not in there
        ]
        if new:
            connection.execute(insert(input_file), new)


def _read(database: Database) -> dict[FileState, str]:
    with database.reading() as connection:
        rows = connection.execute(select(input_file))
        return {FileState(*row[:3]): row.sha256 for row in rows}
