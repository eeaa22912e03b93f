"""Room for copies of remote recordings: a folder of bounded size that processes share."""

import os
import re
import secrets
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from fusion_core.files.atomic import cannot_write
from fusion_core.files.lock import acquire_lock, locked_folder

_LOCK_NAME = "lock"
_TOKEN_BYTES = 8
# Nothing else in the folder is touched: somebody may name one with files of their own.
_SPACE_NAME = re.compile(rf"scanloom-([0-9]{{1,18}})-[0-9a-f]{{{2 * _TOKEN_BYTES}}}", re.ASCII)
# Another process ends its recording in seconds at best.
_LOOK_AGAIN_S = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoteCache:
    """``folder``: the same for all processes of a machine. ``bytes_max``: of all copies that are
    there at a time."""

    folder: Path
    bytes_max: int


@contextmanager
def cache_space(cache: RemoteCache, needed: int) -> Iterator[Path]:
    """An empty folder with room for ``needed`` bytes, at most ``cache.bytes_max``; it is removed
    at the end of the block. Waits while others need the room; what killed processes have left is
    removed. Raises ExportError where the folder cannot be written.
    """
    try:
        cache.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        while (reserved := _reserve(cache, needed)) is None:
            time.sleep(_LOOK_AGAIN_S)
    except OSError as error:
        raise cannot_write(cache.folder, error) from error
    space, descriptor = reserved
    try:
        yield space / "copy"
    finally:
        with locked_folder(cache.folder):
            shutil.rmtree(space, ignore_errors=True)
            os.close(descriptor)


def _reserve(cache: RemoteCache, needed: int) -> tuple[Path, int] | None:
    """A locked folder whose name says how much it may hold; None where there is no room now."""
    with locked_folder(cache.folder):
        taken = sum(map(_taken, cache.folder.iterdir()))
        if taken + needed > cache.bytes_max:
            return None
        space = cache.folder / f"scanloom-{needed}-{secrets.token_hex(_TOKEN_BYTES)}"
        (space / "copy").mkdir(parents=True)
        descriptor = acquire_lock(space / _LOCK_NAME)
        assert descriptor is not None, "nobody else knows its name"
        return space, descriptor


def _taken(space: Path) -> int:
    """The bytes that a folder of the cache may hold, 0 and removed where nobody uses it."""
    named = _SPACE_NAME.fullmatch(space.name)
    if named is None or space.is_symlink() or not space.is_dir():
        return 0
    descriptor = acquire_lock(space / _LOCK_NAME)
    if descriptor is None:
        return int(named[1])
    shutil.rmtree(space, ignore_errors=True)
    os.close(descriptor)
    return 0
