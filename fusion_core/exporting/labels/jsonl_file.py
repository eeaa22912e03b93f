"""Labels as JSON Lines: the header, one object for each run, and ``{"end": true}``, without which
the file was cut off."""

import io
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

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
from fusion_core.exporting.labels.label_runs import COLUMNS, TableRow, labels_of_rows, table_rows
from fusion_core.files.atomic import atomic_stream
from fusion_core.files.regular_file import open_regular
from fusion_core.model.labels import CaptureLabels

FORMAT = "jsonl"
_END = {"end": True}


def write_jsonl(file: Path, header: LabelHeader, layer: Iterable[CaptureLabels]) -> None:
    """Raises ExportError where it cannot be written."""
    rows = (dict(zip(COLUMNS, row, strict=True)) for row in table_rows(layer))
    write_json_lines(file, header.to_json(FORMAT), rows)


def read_jsonl(file: Path) -> LabelFile:
    """Raises RecordingError."""
    header = LabelHeader.of_json(json_of(first_line(file), file, "its first line"), file)
    return LabelFile(header=header, labels=lambda: labels_of_rows(_rows(file), file, first_row=2))


def write_json_lines(file: Path, header: dict[str, Any], rows: Iterable[dict[str, Any]]) -> None:
    """One line for the header, one for each row, and the end's. Raises ExportError."""
    with atomic_stream(file) as stream:
        text = io.TextIOWrapper(stream, encoding="utf-8", newline="\n")
        text.write(json.dumps(header) + "\n")
        text.writelines(json.dumps(row) + "\n" for row in rows)
        text.write(json.dumps(_END) + "\n")
        text.detach()


def read_json_lines(file: Path) -> Iterator[dict[str, Any]]:
    """The object of each line below the header. Raises RecordingError."""
    try:
        with open_regular(file) as stream:
            lines = text_lines(stream, file)
            next(lines, "")
            for number, line in enumerate(lines, 2):
                found = json_of(line, file, f"row {number}")
                if not isinstance(found, dict):
                    raise damaged(file, f"row {number} is no object")
                if found == _END:
                    return
                yield found
            raise cut_off(file)
    except OSError as error:
        raise unreadable(file, error) from error


def _rows(file: Path) -> Iterator[TableRow]:
    for found in read_json_lines(file):
        yield tuple(found.get(name) for name in COLUMNS)
