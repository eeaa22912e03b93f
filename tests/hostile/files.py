"""Paths that are no plain files: pipes, huge arrays, links to themselves."""

import io
import os
import zipfile
from pathlib import Path

import numpy as np


def write_pipe(path: Path) -> Path:
    """A named pipe without a writer: a reader blocks."""
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


def write_huge_array(path: Path) -> Path:
    """An .npz of some hundred bytes whose one array claims to be of 8 petabytes."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        head, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("scan_true.npy", head.getvalue())
    return path
