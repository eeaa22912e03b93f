"""Pairs of a 2D laser point and its pixel: text with ``x y u v`` (m, m, px, px) on each line."""

from pathlib import Path

import numpy as np

from fusion_core.files.regular_file import read_head
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.number_lines import read_numeric_lines

COLUMNS = "x y u v"
# Nobody clicks a million pixels.
_MAX_PAIRS = 1_000_000
_HEAD_BYTES = 4096


def is_laser_pixel_file(path: Path) -> bool:
    """Whether a file ends in .txt, or holds four numbers on its first line. Raises OSError."""
    if path.is_dir():
        return False
    if path.suffix.lower() == ".txt":
        return True
    lines = read_head(path, _HEAD_BYTES).decode(errors="replace").splitlines()
    fields = next((f for line in lines if (f := line.split()) and not f[0].startswith("#")), [])
    try:
        return len([float(field) for field in fields]) == len(COLUMNS.split())
    except ValueError:
        return False


def read_laser_pixels(file: Path) -> tuple[FloatArray, FloatArray]:
    """(N, 2) laser points in metres and (N, 2) pixels.

    Raises RecordingError for a line that is no pair, OSError where the file cannot be read.
    """
    rows: list[list[float]] = []
    for line in read_numeric_lines(file, COLUMNS):
        if len(rows) == _MAX_PAIRS:
            raise line.error(f"there are more than {_MAX_PAIRS} pairs")
        rows.append(line.numbers(0))
    if not rows:
        raise RecordingError("holds no pairs.", file=file, advice=f"Each line holds {COLUMNS}.")
    pairs = np.array(rows, dtype=np.float64)
    return pairs[:, :2].copy(), pairs[:, 2:].copy()
