"""Points that lie row by row in a file, as bytes or as text, read within bounds of memory."""

import os
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

from fusion_core.model.conventions import Float32Array
from fusion_core.recordings.clouds.bad_cloud import BadCloud
from fusion_core.recordings.clouds.point_layout import Column, PointLayout

_BLOCK_BYTES = 1 << 20
_MAX_LINE_BYTES = 1 << 16


def read_binary_rows(file: BinaryIO, layout: PointLayout, count: int) -> Float32Array:
    """(N, 3 or 4) of the layout's columns: as many of ``count`` rows as the file still has."""
    columns = layout.columns()
    there_bytes = max(0, os.fstat(file.fileno()).st_size - file.tell())
    values = np.empty((min(count, there_bytes // layout.row_bytes), len(columns)), np.float32)
    block_rows = max(1, _BLOCK_BYTES // layout.row_bytes)
    for start in range(0, len(values), block_rows):
        block = values[start : start + block_rows]
        data = file.read(len(block) * layout.row_bytes)
        if len(data) < len(block) * layout.row_bytes:
            # The file has become shorter meanwhile.
            return values[:start]
        _fill_columns(block, data, columns, layout.row_bytes)
    return values


def read_text_rows(file: BinaryIO, layout: PointLayout, count: int) -> tuple[Float32Array, int]:
    """(N, 3 or 4) of the layout's columns, and how many of the rows are damaged, which are NaN.

    A last line without an end is dropped if rows are missing: it may have been cut short.
    """
    columns = layout.columns()
    blocks: list[Float32Array] = []
    damaged = 0
    missing = count
    rest = b""
    while missing:
        data = file.read(_BLOCK_BYTES)
        *lines, rest = (rest + data).split(b"\n")
        if len(rest) > _MAX_LINE_BYTES:
            raise BadCloud(f"a line has more than {_MAX_LINE_BYTES} bytes")
        if not data and missing == 1:
            lines = [rest]
        rows = [words for line in lines if (words := line.split())][:missing]
        if rows:
            block = np.array(
                [_numbers(row, columns, layout.row_words) for row in rows], dtype=np.float64
            )
            damaged += int(np.isneginf(block[:, 0]).sum())
            blocks.append(_as_float32(block))
        missing -= len(rows)
        if not data:
            break
    return _joined(blocks, len(columns)), damaged


def skip_text_rows(file: BinaryIO, count: int) -> None:
    """Go past ``count`` lines."""
    for _ in range(count):
        if not file.readline(_MAX_LINE_BYTES):
            return


def _numbers(words: Sequence[bytes], columns: Sequence[Column], row_words: int) -> list[float]:
    """The columns of one row; -inf where the row is damaged, which no scanner writes as such."""
    try:
        if len(words) == row_words:
            return [float(words[column.word]) for column in columns]
    except ValueError:
        pass
    return [-np.inf] * len(columns)


def _fill_columns(
    values: Float32Array, data: bytes, columns: Sequence[Column], row_bytes: int
) -> None:
    # A float64 beyond float32 becomes infinite; a signalling NaN is one as well.
    with np.errstate(over="ignore", invalid="ignore"):
        for place, column in enumerate(columns):
            values[:, place] = np.ndarray(
                len(values), column.dtype, data, column.byte, strides=(row_bytes,)
            )


def _as_float32(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> Float32Array:
    with np.errstate(over="ignore"):
        return values.astype(np.float32)


def _joined(blocks: Sequence[Float32Array], width: int) -> Float32Array:
    return np.concatenate(blocks) if blocks else np.empty((0, width), np.float32)
