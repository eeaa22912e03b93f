"""Files that appear whole or not at all: written aside, flushed to disk, renamed."""

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from fusion_core.model.errors import ExportError

# Failures of writing itself. Any other OSError in the caller's block is not about this file.
_WRITING_FAILED = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG}


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder, with the same suffix, to be written by the caller.

    It is renamed to ``path`` when the block ends and removed when it raises. Raises ExportError
    where the folder cannot be written.
    """
    aside = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        # Created here, not by the caller, so that an unwritable folder fails before any work.
        os.close(os.open(aside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise _cannot_write(path, error) from error
    try:
        yield aside
        _publish(aside, path)
    except OSError as error:
        if error.errno in _WRITING_FAILED:
            raise _cannot_write(path, error) from error
        raise
    finally:
        aside.unlink(missing_ok=True)


@contextmanager
def atomic_stream(path: Path) -> Iterator[BinaryIO]:
    """Yield a binary stream whose content becomes ``path`` when the block ends."""
    with atomic_path(path) as aside, aside.open("wb") as stream:
        yield stream
        # Closed before the rename, so that the file is whole when it gets its name.
        stream.close()


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file."""
    with atomic_stream(path) as stream:
        stream.write(content)


def write_text(path: Path, text: str) -> None:
    """Write a whole file as UTF-8, line ends as they are in ``text``."""
    write_bytes(path, text.encode("utf-8"))


def _publish(aside: Path, path: Path) -> None:
    _flush_to_disk(aside)
    try:
        aside.replace(path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    # The rename itself is durable only when the folder is flushed; Windows has no such call.
    if os.name == "posix":
        _flush_to_disk(path.parent)


def _flush_to_disk(path: Path) -> None:
    # Windows flushes only what was opened for writing; a folder opens for reading only.
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _cannot_write(path: Path, error: OSError) -> ExportError:
    return ExportError(
        f"cannot be written: {error.strerror}.",
        file=path,
        advice="Choose another output folder or free space.",
    )
