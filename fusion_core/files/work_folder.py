"""The hidden folder in which a run builds its results, locked by that run."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fusion_core.files.lock import acquire_lock
from fusion_core.model.errors import ExportError

WORK_NAME = ".scanloom-unfinished"
_LOCK_NAME = "lock"


@contextmanager
def work_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder inside ``folder``, which is created if it does not exist.

    Another run into ``folder`` is refused meanwhile. What a killed run has left is removed first.
    At the end the work folder is removed, and ``folder`` too if it was created here and is still
    empty. Raises ExportError where another run holds the lock, or a folder cannot be created.
    """
    is_new = not folder.exists()
    work = folder / WORK_NAME
    try:
        descriptor = _acquire(work)
    except OSError as error:
        if is_new:
            _remove_empty(folder)
        raise ExportError(
            f"cannot be made: {error.strerror or error}.",
            file=folder,
            advice="Name another output folder.",
        ) from error
    if descriptor is None:
        raise ExportError(
            "is being written by another run.",
            file=folder,
            advice="Wait until that has ended, or name another output folder.",
        )
    try:
        results = work / "results"
        _clear(work)
        results.mkdir()
        yield results
    finally:
        _release(work, descriptor)
        if is_new:
            _remove_empty(folder)


def clear_abandoned(folder: Path) -> None:
    """Remove what a killed run has left in ``folder``, if nothing prevents it."""
    work = folder / WORK_NAME
    if work.is_dir() and not work.is_symlink():
        with suppress(OSError):
            descriptor = acquire_lock(work / _LOCK_NAME)
            if descriptor is not None:
                _release(work, descriptor)


def _release(work: Path, descriptor: int) -> None:
    _clear(work)
    # The lock goes last: until then no other run starts here.
    (work / _LOCK_NAME).unlink(missing_ok=True)
    _remove_empty(work)
    os.close(descriptor)


def _acquire(work: Path) -> int | None:
    while True:
        work.mkdir(parents=True, exist_ok=True)
        if work.is_symlink():
            raise NotADirectoryError(0, f"{WORK_NAME} in it is a link")
        try:
            return acquire_lock(work / _LOCK_NAME)
        except FileNotFoundError:
            # Another run has just ended, and removed its folder.
            continue


def _clear(work: Path) -> None:
    for child in work.iterdir():
        if child.is_dir() and not child.is_symlink():
            shutil.rmtree(child, ignore_errors=True)
        elif child.name != _LOCK_NAME:
            child.unlink(missing_ok=True)


def _remove_empty(folder: Path) -> None:
    # Another run may have begun in it.
    with suppress(OSError):
        folder.rmdir()
