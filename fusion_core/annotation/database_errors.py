"""Errors of the databases, as lines that say what to do."""

from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy.exc import DBAPIError, DisconnectionError, OperationalError

from fusion_core.model.errors import ExportError, LabelStoreError, ScanLoomError
from fusion_core.model.names import printable

LOCK_TIMEOUT_S = 30.0
"""How long an action waits for those of others."""

_NOTHING = "Nothing of this action was written"
# By the prefixes of SQLite's names of result codes and of PostgreSQL's SQLSTATE (its appendix A).
_LOCKED = ("SQLITE_BUSY", "SQLITE_LOCKED", "55P03")
_FULL = ("SQLITE_FULL", "53100")
_DAMAGED = ("SQLITE_CORRUPT", "SQLITE_NOTADB", "XX001", "XX002")
_READ_ONLY = ("SQLITE_READONLY", "SQLITE_PERM", "42501", "25006")
_UNREADABLE = ("SQLITE_CANTOPEN", "SQLITE_IOERR", "58030")


@contextmanager
def explained_errors(place: str) -> Iterator[None]:
    """Raise what a database refuses as ExportError, where it cannot be written or reached, or as
    LabelStoreError, where it is damaged. ``place``: the store, as messages name it."""
    try:
        yield
    except (DBAPIError, DisconnectionError) as error:
        explained = _explain(error, place)
        if explained is None:
            raise
        raise explained from error


def _explain(error: DBAPIError | DisconnectionError, place: str) -> ScanLoomError | None:
    """None for what is a fault of the program."""
    cause = getattr(error, "orig", None) or error
    code = getattr(cause, "sqlite_errorname", None) or getattr(cause, "sqlstate", None) or ""
    reason = _one_line(str(cause))
    if code.startswith(_LOCKED):
        return ExportError(
            f"another program has kept it locked for {LOCK_TIMEOUT_S:.0f} s.",
            file=place,
            advice=f"{_NOTHING}: repeat it when that program has ended.",
        )
    if code.startswith(_FULL):
        return ExportError(
            "the disk is full.", file=place, advice=f"{_NOTHING}: free space, then repeat it."
        )
    if code.startswith(_DAMAGED):
        return damaged(place, reason)
    if code.startswith(_READ_ONLY):
        return ExportError(
            f"cannot be written: {reason}.",
            file=place,
            advice=f"{_NOTHING}: ask for the right to write there.",
        )
    if code.startswith(_UNREADABLE):
        return ExportError(
            f"cannot be read or written: {reason}.",
            file=place,
            advice=f"{_NOTHING}: see to the disk and its folder, then repeat it.",
        )
    if isinstance(error, DisconnectionError | OperationalError):
        return ExportError(
            f"the database cannot be reached: {reason}.",
            file=place,
            advice="See that it runs; then look whether this action is in the journal.",
        )
    return None


def damaged(place: str, reason: str) -> LabelStoreError:
    """The error for a store with wrong content."""
    return LabelStoreError(
        f"is damaged: {_one_line(reason)}.",
        file=place,
        advice="Restore it from a copy; it was left as it is.",
    )


def _one_line(text: str) -> str:
    return printable(" ".join(text.split()).rstrip("."))
