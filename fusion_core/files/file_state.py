"""Files as they stand, without reading them."""

from pathlib import Path
from typing import NamedTuple, Self


class FileState(NamedTuple):
    """A file by its name, size in bytes and time of change: where all are as they were, its content
    is taken to be as it was. ``name``: relative to the folder that is hashed with it."""

    name: str
    size: int
    mtime_ns: int

    @classmethod
    def of(cls, file: Path, name: str) -> Self:
        """Raises OSError."""
        state = file.stat()
        return cls(name, state.st_size, state.st_mtime_ns)
