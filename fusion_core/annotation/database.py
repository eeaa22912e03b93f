"""A label store's database: transactions that read, and transactions that write."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock

from sqlalchemy import Connection, Engine, select

from fusion_core.annotation import schema
from fusion_core.annotation.database_errors import explained_errors
from fusion_core.model.errors import ExportError

SQLITE_BEGIN = "sqlite_begin"
"""The execution option that says how a transaction of SQLite begins."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Database:
    """``place``: the store, as messages name it. ``read_only_because``: why it cannot be written,
    "" where it can."""

    engine: Engine
    place: str
    read_only_because: str = ""
    _own_writes: Lock = field(default_factory=Lock, repr=False)

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A transaction that sees one state of the journal."""
        with explained_errors(self.place), self.engine.connect() as connection:
            if self.engine.dialect.name == "postgresql":
                connection.execution_options(
                    isolation_level="REPEATABLE READ", postgresql_readonly=True
                )
            with connection.begin():
                yield connection

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """A transaction that is alone in writing this journal, committed to disk at its end, or
        rolled back.

        Raises ExportError where the store cannot be written or stays locked.
        """
        if self.read_only_because:
            raise ExportError(
                f"cannot be written: {self.read_only_because}.",
                file=self.place,
                advice="Ask for the right to write there, or name a copy of it by --labels.",
            )
        # Threads of one program wait for each other without polling the file.
        with (
            self._own_writes,
            explained_errors(self.place),
            self.engine.connect() as connection,
        ):
            connection.execution_options(**{SQLITE_BEGIN: "BEGIN IMMEDIATE"})
            with connection.begin():
                if self.engine.dialect.name == "postgresql":
                    connection.execute(select(schema.store.c.id).with_for_update())
                yield connection

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()
