"""Bounded reads of files that a user names: regular files only.

A pipe waits for its other end, a device may never end, and neither has a size to check.
"""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

# Some flags are missing on some platforms. O_NONBLOCK: a pipe opens at once and is then refused.
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
_FLAGS |= getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)


def open_regular(path: Path, max_bytes: int | None = None) -> BinaryIO:
    """Open a regular file for reading, without blocking.

    Raises OSError where it cannot be opened, is not a regular file or is larger than ``max_bytes``.
    """
    descriptor = os.open(path, _FLAGS)
    try:
        state = os.fstat(descriptor)
        if not stat.S_ISREG(state.st_mode):
            number = errno.EISDIR if stat.S_ISDIR(state.st_mode) else errno.EINVAL
            raise OSError(number, "it is not a regular file", str(path))
        if max_bytes is not None and state.st_size > max_bytes:
            raise _too_large(path, max_bytes)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_regular(path: Path, max_bytes: int) -> bytes:
    """The bytes of a regular file.

    Raises OSError where it cannot be read, is not a regular file or is larger than ``max_bytes``.
    """
    with open_regular(path, max_bytes) as file:
        # A file may grow meanwhile, and files of the system (/proc) report no size.
        content = file.read(max_bytes + 1) or b""
    if len(content) > max_bytes:
        raise _too_large(path, max_bytes)
    return content


def read_head(path: Path, count: int) -> bytes:
    """The first ``count`` bytes of a regular file, fewer of a shorter one. Raises OSError."""
    with open_regular(path) as file:
        # read() gives None for a file of the system that has no data yet.
        return file.read(count) or b""


def _too_large(path: Path, max_bytes: int) -> OSError:
    return OSError(errno.EFBIG, f"it is larger than {max_bytes} bytes", str(path))
