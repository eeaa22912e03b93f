"""Labels as CSV: the table of runs below the header, a first line ``# scanloom labels {...}``.

A comment line, since a file beside it gets lost: readers skip it (pandas: ``comment="#"``). So they
do the last line, ``# end``, without which the file was cut off.
"""

import csv
import io
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

from fusion_core.exporting.labels.label_file import (
    LabelFile,
    LabelHeader,
    cut_off,
    damaged,
    first_line,
    json_of,
    text_lines,
    unreadable,
)
from fusion_core.exporting.labels.label_runs import (
    COLUMNS,
    INTEGER_COLUMNS,
    TableRow,
    labels_of_rows,
    table_rows,
)
from fusion_core.files.atomic import atomic_stream
from fusion_core.files.regular_file import open_regular
from fusion_core.model.errors import ExportError
from fusion_core.model.labels import CaptureLabels
from fusion_core.model.names import escape_undecodable

FORMAT = "csv"
MARK = "# scanloom labels "
_END = "# end\n"
_FIRST_ROW = 3
_IS_INTEGER = tuple(name in INTEGER_COLUMNS for name in COLUMNS)


def write_csv(file: Path, header: LabelHeader, layer: Iterable[CaptureLabels]) -> None:
    """Raises ExportError where it cannot be written, and for a topic that CSV cannot hold."""
    with atomic_stream(file) as stream:
        text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
        text.write(f"{MARK}{json.dumps(header.to_json(FORMAT))}\n")
        table = csv.writer(text, lineterminator="\n")
        table.writerow(COLUMNS)
        table.writerows(table_rows(_with_writable_topics(layer, file)))
        text.write(_END)
        text.detach()


def _with_writable_topics(layer: Iterable[CaptureLabels], file: Path) -> Iterator[CaptureLabels]:
    for labels in layer:
        topic = labels.capture.topic
        # A reader would take a line end for the row's, and a surrogate is no UTF-8.
        if "\r" in topic or "\n" in topic or escape_undecodable(topic) != topic:
            raise ExportError(
                f"the topic {topic!r} cannot be written as CSV.",
                file=file,
                advice="Export as jsonl or parquet.",
            )
        yield labels


def read_csv(file: Path) -> LabelFile:
    """Raises RecordingError."""
    line = first_line(file)
    if not line.startswith(MARK):
        raise damaged(file, f"it does not begin with {MARK.strip()!r}")
    header = LabelHeader.of_json(json_of(line.removeprefix(MARK), file, "its first line"), file)
    return LabelFile(
        header=header, labels=lambda: labels_of_rows(_rows(file), file, first_row=_FIRST_ROW)
    )


def _rows(file: Path) -> Iterator[TableRow]:
    try:
        with open_regular(file) as stream:
            lines = text_lines(stream, file)
            next(lines, "")
            table = csv.reader(_before_end(lines, file), strict=True)
            if tuple(next(table, ())) != COLUMNS:
                raise damaged(file, f"its second line is not {','.join(COLUMNS)}")
            for number, row in enumerate(table, _FIRST_ROW):
                if len(row) != len(COLUMNS):
                    raise damaged(file, f"row {number} has {len(row)} fields, not {len(COLUMNS)}")
                yield tuple(
                    _integer(field) if is_integer else field
                    for field, is_integer in zip(row, _IS_INTEGER, strict=True)
                )
    except csv.Error as error:
        raise damaged(file, f"{error}") from error
    except OSError as error:
        raise unreadable(file, error) from error


def _before_end(lines: Iterable[str], file: Path) -> Iterator[str]:
    for line in lines:
        if line == _END:
            return
        yield line
    raise cut_off(file)


def _integer(field: str) -> int | str:
    """The number, or the field itself, which is refused where it is used."""
    # No sign but one minus, no spaces, underscores or other scripts' digits, as int() takes them.
    digits = field.removeprefix("-")
    return int(field) if digits.isascii() and digits.isdigit() and len(digits) < 20 else field
