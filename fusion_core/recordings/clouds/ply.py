"""PLY, the polygon files of Stanford, of which the vertices are read: ascii, and binary of either
byte order."""

import os
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from fusion_core.model.conventions import Float32Array
from fusion_core.recordings.clouds.bad_cloud import BadCloud
from fusion_core.recordings.clouds.point_layout import PointField, PointLayout, require_count
from fusion_core.recordings.clouds.rows import read_binary_rows, read_text_rows, skip_text_rows
from fusion_core.recordings.quoting import quote_clipped

_MAX_HEADER_BYTES = 1 << 20
# No file is larger; beyond it a place in a file is no 64-bit number.
_MAX_SKIPPED_BYTES = 1 << 50
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}


def is_ply(head: bytes) -> bool:
    """Whether the first bytes of a file are those of a PLY file."""
    return head.startswith((b"ply\n", b"ply\r"))


def read_ply(file: BinaryIO, warnings: list[str]) -> Float32Array:
    """(N, 3 or 4) x, y, z and intensity of the vertices.

    Rows that the file lacks are left out, those that are damaged are NaN; ``warnings`` says so.
    Raises BadCloud.
    """
    storage, elements = _read_header(file)
    vertices = _go_to_vertices(file, storage, elements)
    if vertices.has_list:
        raise BadCloud("its vertices hold lists", "Write them with single numbers alone.")
    layout, count = PointLayout(tuple(vertices.fields)), require_count(vertices.count)
    if storage == "ascii":
        values, damaged = read_text_rows(file, layout, count)
        if damaged:
            warnings.append(f"{damaged} of its lines are damaged; their points are left out.")
    else:
        values = read_binary_rows(file, layout, count)
    if len(values) < count:
        warnings.append(f"It is cut short: {len(values)} of {count} points are there.")
    return values


@dataclass(slots=True)
class _Element:
    name: str
    count: int
    fields: list[PointField]
    has_list: bool = False


def _read_header(file: BinaryIO) -> tuple[str, list[_Element]]:
    storage = ""
    elements: list[_Element] = []
    read_bytes = 0
    while True:
        line = file.readline(_MAX_HEADER_BYTES - read_bytes)
        read_bytes += len(line)
        if not line:
            raise BadCloud("its header does not end")
        match line.decode("ascii", errors="replace").split():
            case ["end_header"]:
                break
            case ["format", str(storage), _]:
                if storage not in _ORDERS:
                    raise BadCloud(
                        f"its format is {quote_clipped(storage)}",
                        f"PLY files are {', '.join(_ORDERS)}.",
                    )
            case ["element", name, count] if count.isascii() and count.isdecimal():
                # Thousands of digits are no number.
                elements.append(_Element(name, int(count[:18]), []))
            case ["property", "list", _, _, _] if elements:
                elements[-1].has_list = True
            case ["property", kind, name] if elements and kind in _TYPES:
                dtype = np.dtype(_ORDERS.get(storage, "<") + _TYPES[kind])
                elements[-1].fields.append(PointField(name, dtype))
            case ["element" | "property" | "format", *_]:
                raise BadCloud(f"its header has the line {quote_clipped(repr(line.strip())[2:-1])}")
    if not storage:
        raise BadCloud("its header does not state the format")
    return storage, elements


def _go_to_vertices(file: BinaryIO, storage: str, elements: list[_Element]) -> _Element:
    """Go past the elements before the vertices, which are usually the first."""
    for element in elements:
        if element.name == "vertex":
            return element
        if storage == "ascii":
            skip_text_rows(file, element.count)
        elif element.has_list:
            raise BadCloud(
                f"lists of {quote_clipped(element.name)} stand before its vertices",
                "Write the vertices first.",
            )
        else:
            skipped_bytes = element.count * PointLayout(tuple(element.fields)).row_bytes
            if skipped_bytes > _MAX_SKIPPED_BYTES:
                raise BadCloud(f"it claims {element.count} of {quote_clipped(element.name)}")
            file.seek(skipped_bytes, os.SEEK_CUR)
    raise BadCloud("it has no vertices", "Name a file with points.")
