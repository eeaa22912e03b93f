"""A folder with a file for each capture, and ``index.jsonl`` that says which one is whose.

The index has the header, with the value that stands for each label, and an object for each file:
its path and the capture's fields. A capture without labels has no file.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from fusion_core.exporting.labels.capture_names import CaptureNames
from fusion_core.exporting.labels.jsonl_file import read_json_lines, write_json_lines
from fusion_core.exporting.labels.label_file import (
    MASK_VALUES,
    LabelFile,
    LabelHeader,
    capture_of,
    damaged,
    first_line,
    json_of,
    ordered,
    unreadable,
)
from fusion_core.exporting.labels.label_runs import CAPTURE_COLUMNS, capture_fields
from fusion_core.files.atomic import write_bytes
from fusion_core.files.regular_file import read_regular
from fusion_core.model.conventions import IntArray
from fusion_core.model.labels import Capture, CaptureLabels

INDEX = "index.jsonl"


@dataclass(frozen=True, slots=True, kw_only=True)
class MaskCoding:
    """How a capture's values, (rows, columns) of MASK_VALUES, become a file.

    ``decode`` raises ValueError for what is no such file of the given rows and columns, before it
    takes memory for more. ``max_bytes`` is for rows and columns, too.
    """

    format: str
    suffix: str
    encode: Callable[[IntArray], bytes]
    decode: Callable[[bytes, int, int], IntArray]
    max_bytes: Callable[[int, int], int]


def write_capture_folder(
    folder: Path, header: LabelHeader, layer: Iterable[CaptureLabels], coding: MaskCoding
) -> None:
    """Write into an existing, empty folder. Raises ExportError where it cannot be written."""
    whole_header = header.to_json(coding.format) | {"values": MASK_VALUES}
    write_json_lines(folder / INDEX, whole_header, _write_files(folder, layer, coding))


def _write_files(
    folder: Path, layer: Iterable[CaptureLabels], coding: MaskCoding
) -> Iterator[dict[str, Any]]:
    names = CaptureNames()
    for labels in layer:
        name = names.name(labels.capture, coding.suffix)
        file = folder / name
        file.parent.mkdir(exist_ok=True)
        write_bytes(file, coding.encode(labels.as_image() + 1))
        fields = zip(CAPTURE_COLUMNS, capture_fields(labels.capture), strict=True)
        yield {"file": name, **dict(fields)}


def read_capture_folder(folder: Path, coding: MaskCoding) -> LabelFile:
    """Raises RecordingError."""
    header = folder_header(folder)
    index = folder / INDEX
    if header.get("format") != coding.format or header.get("values") != MASK_VALUES:
        raise damaged(index, f"its files are not those of {coding.format}")
    return LabelFile(
        header=LabelHeader.of_json(header, index),
        labels=lambda: ordered(_read_files(folder, coding), index),
    )


def folder_header(folder: Path) -> dict[str, Any]:
    """The header in a folder's index. Raises RecordingError where there is none."""
    index = folder / INDEX
    found = json_of(first_line(index), index, "its first line")
    if not isinstance(found, dict):
        raise damaged(index, "its first line is no header")
    return found


def _read_files(folder: Path, coding: MaskCoding) -> Iterator[CaptureLabels]:
    index = folder / INDEX
    for number, found in enumerate(read_json_lines(index), 2):
        where = f"row {number}"
        capture = capture_of((found.get(key) for key in CAPTURE_COLUMNS), index, where)
        name = found.get("file")
        if not isinstance(name, str) or not _stays_inside(name):
            raise damaged(index, f"{where} names no file of this folder")
        yield _read_file(folder / name, capture, coding)


def _stays_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return (
        bool(path.parts) and not path.is_absolute() and ".." not in path.parts and "\0" not in name
    )


def _read_file(file: Path, capture: Capture, coding: MaskCoding) -> CaptureLabels:
    rows, columns = capture.rows, capture.columns
    try:
        values = coding.decode(read_regular(file, coding.max_bytes(rows, columns)), rows, columns)
    except OSError as error:
        raise unreadable(file, error) from error
    except ValueError as error:
        raise damaged(file, str(error)) from error
    if (values > max(MASK_VALUES.values())).any():
        raise damaged(file, f"it has the value {values.max()}, which stands for no label")
    return CaptureLabels.of_image(capture, values.astype(np.int64) - 1)
