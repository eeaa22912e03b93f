"""Locks on files and folders, each held by one process until it releases it or ends.

The lock is the system's own (``flock``), so that a killed process leaves none behind.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    from fcntl import LOCK_EX, LOCK_NB, flock
except ImportError as error:
    raise ImportError("ScanLoom needs flock, which Linux, macOS and WSL have.") from error


def acquire_lock(path: Path, *, create: bool = True) -> int | None:
    """Open a file and lock it. Returns its descriptor, which the caller closes to release the lock;
    None where another process holds it, or where it does not exist and ``create`` is False.

    Raises OSError where it cannot be opened.
    """
    flags = os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | (os.O_CREAT if create else 0)
    while True:
        try:
            descriptor = os.open(path, flags, 0o666)
        except FileNotFoundError:
            if create:
                raise
            return None
        try:
            flock(descriptor, LOCK_EX | LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            return None
        except OSError:
            os.close(descriptor)
            raise
        if _is_still_at(path, descriptor):
            return descriptor
        # The previous holder has removed the file in between.
        os.close(descriptor)


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Hold the lock on an existing folder, and wait until nobody else does. Nothing is written.

    Raises OSError where the folder cannot be opened.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC | os.O_DIRECTORY)
    try:
        flock(descriptor, LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _is_still_at(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except FileNotFoundError:
        return False
