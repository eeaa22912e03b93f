"""Atomic writes: a file is written under a temporary name, flushed to disk and renamed."""

import errno
import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from fusion_core.files.lock import acquire_lock
from fusion_core.model.errors import ExportError

# Failures of the write itself. Any other OSError in the caller's block is not about this file.
_WRITING_FAILED = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG}
_TOKEN_BYTES = 4


class AtomicFile:
    """A file being written: the caller writes to ``temporary``, and ``publish`` renames it.

    ``temporary`` is a path in the same folder with the same suffix. It is locked until ``close``:
    temporary files without a lock were left by killed processes, and are removed first.
    Raises ExportError where the folder cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            _remove_abandoned(path)
            # Created here, not by the caller, so that an unwritable folder fails before any work.
            self.temporary, descriptor = _create_temporary(path)
        except OSError as error:
            raise cannot_write(path, error) from error
        self._descriptor: int | None = descriptor

    def publish(self) -> None:
        """Flush what was written to disk and rename it to ``path``; the caller has closed it."""
        _flush_to_disk(self.temporary)
        try:
            self.temporary.replace(self.path)
        except OSError as error:
            raise cannot_write(self.path, error) from error
        # The rename itself is durable only when the folder is flushed.
        _flush_to_disk(self.path.parent)

    def close(self) -> None:
        """Remove what was not published; a second call does nothing."""
        if self._descriptor is None:
            return
        with suppress(FileNotFoundError):
            self.temporary.unlink()
        os.close(self._descriptor)
        self._descriptor = None


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, with the same suffix, to be written by the caller.

    It is renamed to ``path`` when the block ends and removed when it raises. Raises ExportError
    where the folder cannot be written.
    """
    file = AtomicFile(path)
    try:
        yield file.temporary
        file.publish()
    except OSError as error:
        if error.errno in _WRITING_FAILED:
            raise cannot_write(path, error) from error
        raise
    finally:
        file.close()


@contextmanager
def atomic_stream(path: Path) -> Iterator[BinaryIO]:
    """Yield a binary stream whose content becomes ``path`` when the block ends."""
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        yield stream
        # Closed before the rename, so that the file is complete when it gets its name.
        stream.close()


def require_folder_of(path: Path) -> None:
    """Raise ExportError where the folder of a file to be written does not exist; to be asked before
    long work."""
    if not path.parent.is_dir():
        raise ExportError(
            "there is no such folder.", file=path.parent, advice="Make it, or name another."
        )


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file."""
    with atomic_stream(path) as stream:
        stream.write(content)


def write_text(path: Path, text: str) -> None:
    """Write a whole file as UTF-8, line ends as they are in ``text``."""
    write_bytes(path, text.encode("utf-8"))


def cannot_write(path: Path, error: OSError) -> ExportError:
    """The error for a file that cannot be written."""
    return ExportError(
        f"cannot be written: {error.strerror or error}.",
        file=path,
        advice="Choose another output folder or free space.",
    )


def _create_temporary(path: Path) -> tuple[Path, int]:
    """A new temporary file beside ``path``, and the descriptor of its lock."""
    while True:
        token = secrets.token_hex(_TOKEN_BYTES)
        temporary = path.with_name(f".{path.stem}.{token}.partial{path.suffix}")
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        # Another process may have taken it for an abandoned one in between.
        descriptor = acquire_lock(temporary, create=False)
        if descriptor is not None:
            return temporary, descriptor


def _remove_abandoned(path: Path) -> None:
    """Remove temporary files that killed processes have left beside ``path``."""
    stem, suffix = re.escape(path.stem), re.escape(path.suffix)
    name = re.compile(rf"\.{stem}\.[0-9a-f]{{{2 * _TOKEN_BYTES}}}\.partial{suffix}")
    for beside in path.parent.iterdir():
        if not name.fullmatch(beside.name) or beside.is_symlink() or not beside.is_file():
            continue
        # A file that we may not lock belongs to another user.
        with suppress(PermissionError):
            descriptor = acquire_lock(beside, create=False)
            if descriptor is not None:
                beside.unlink(missing_ok=True)
                os.close(descriptor)


def _flush_to_disk(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
