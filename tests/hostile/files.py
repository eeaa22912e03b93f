"""Paths that are no plain files: what waits, what has no end, what leads to itself."""

import os
from pathlib import Path


def write_pipe(path: Path) -> Path:
    """A named pipe without a writer: who opens it to read waits."""
    os.mkfifo(path)
    return path


def write_loop(path: Path) -> Path:
    """A symbolic link that leads to itself."""
    path.symlink_to(path.name)
    return path


def write_crowd(folder: Path, pipes: int, files: int) -> Path:
    """A folder of pipes named as recordings and of empty files."""
    folder.mkdir()
    for number in range(pipes):
        write_pipe(folder / f"{number}.mcap")
    for number in range(files):
        (folder / f"{number:06}.txt").touch()
    return folder
