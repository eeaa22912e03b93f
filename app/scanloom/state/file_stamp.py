"""Detects that the files of a recording have changed since they were opened."""

from dataclasses import dataclass
from pathlib import Path
from typing import Self


@dataclass(frozen=True, slots=True)
class FileStamp:
    """Size and modification time of a file, or of each file of a folder."""

    path: Path
    files: dict[Path, tuple[int, int]]

    @classmethod
    def of(cls, path: Path) -> Self:
        """The present state. Files that cannot be read are left out."""
        try:
            files = sorted(path.iterdir()) if path.is_dir() else [path]
        except OSError:
            files = []
        found: dict[Path, tuple[int, int]] = {}
        for file in files:
            try:
                status = file.stat()
            except OSError:
                continue
            found[file] = status.st_size, status.st_mtime_ns
        return cls(path, found)

    def change(self) -> str | None:
        """What has changed since, as text for a message; None if nothing has."""
        now = FileStamp.of(self.path).files
        if now == self.files:
            return None
        if self.files.keys() - now.keys():
            return "is gone, or a part of it is,"
        if any(now[file][0] < size for file, (size, _) in self.files.items()):
            return "has become shorter"
        return "has changed"
