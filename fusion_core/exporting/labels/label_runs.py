"""A layer as one table of runs: neighbouring samples of a row that have one label.

Each row of the table names the capture, the row of samples, the run's first and last column, and
the label. Runs stand in the order of Capture, row and column.
"""

from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.exporting.labels.label_file import capture_of, damaged, label_of, ordered
from fusion_core.model.labels import Capture, CaptureLabels, Label

CAPTURE_COLUMNS = ("sensor", "topic", "stamp_ns", "index", "rows", "columns")
RUN_COLUMNS = ("row", "first_column", "last_column", "label")
COLUMNS = (*CAPTURE_COLUMNS, *RUN_COLUMNS)
INTEGER_COLUMNS = frozenset(COLUMNS) - {"sensor", "topic", "label"}

TableRow = tuple[Any, ...]
"""In the order of COLUMNS."""

_NAMES = {int(label): label.name.lower() for label in Label}
_CAPTURE_FIELDS = len(CAPTURE_COLUMNS)


def capture_fields(capture: Capture) -> TableRow:
    """In the order of CAPTURE_COLUMNS."""
    return (
        capture.sensor,
        capture.topic,
        capture.stamp_ns,
        capture.index,
        capture.rows,
        capture.columns,
    )


def table_rows(layer: Iterable[CaptureLabels]) -> Iterator[TableRow]:
    """The table of a layer."""
    for labels in layer:
        capture = capture_fields(labels.capture)
        ends = np.diff(labels.row) != 0
        ends |= (np.diff(labels.column) != 1) | (np.diff(labels.label) != 0)
        first = np.concatenate([[True], ends]).nonzero()[0]
        last = np.concatenate([ends, [True]]).nonzero()[0]
        for row, start, end, code in zip(
            labels.row[first].tolist(),
            labels.column[first].tolist(),
            labels.column[last].tolist(),
            labels.label[first].tolist(),
            strict=True,
        ):
            yield (*capture, row, start, end, _NAMES[code])


def labels_of_rows(rows: Iterable[TableRow], file: Path, first_row: int) -> Iterator[CaptureLabels]:
    """The layer of a table, whose rows are numbered from ``first_row`` in errors.

    Raises RecordingError for values that no table has, runs that lie outside their capture or
    overlap, and rows out of order.
    """
    return ordered(_captures_of_rows(rows, file, first_row), file)


def _captures_of_rows(
    rows: Iterable[TableRow], file: Path, first_row: int
) -> Iterator[CaptureLabels]:
    number = first_row
    for fields, group in groupby(rows, key=itemgetter(slice(_CAPTURE_FIELDS))):
        where = f"row {number}"
        capture = capture_of(fields, file, where)
        runs: list[Sequence[int]] = []
        for row in group:
            runs.append(_run_of(row[_CAPTURE_FIELDS:], capture, file, f"row {number}"))
            number += 1
        yield _expanded(capture, runs, file, where)


def _run_of(fields: TableRow, capture: Capture, file: Path, where: str) -> Sequence[int]:
    row, first, last, name = fields
    if not (type(row) is type(first) is type(last) is int):
        raise damaged(file, f"{where} has a place that is no whole number")
    if not (0 <= row < capture.rows and 0 <= first <= last < capture.columns):
        raise damaged(file, f"{where} has a run outside its capture")
    return row, first, last, label_of(name, file, where)


def _expanded(
    capture: Capture, runs: Sequence[Sequence[int]], file: Path, where: str
) -> CaptureLabels:
    row, first, last, code = np.array(runs, dtype=np.int64).T
    start = row * capture.columns + first
    size = last - first + 1
    # Before they are written out: runs that overlap could be any number of samples.
    if (start[1:] < (start + size)[:-1]).any():
        raise damaged(
            file, f"the capture from {where} on has runs that overlap or are out of order"
        )
    # Of each sample, how far it stands from the first of its run.
    step = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
    return CaptureLabels(
        capture=capture,
        row=np.repeat(row, size),
        column=np.repeat(first, size) + step,
        label=np.repeat(code, size),
    )
