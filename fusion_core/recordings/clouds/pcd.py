"""PCD, the files of the Point Cloud Library, of version 0.7 and before: ascii, binary and
binary_compressed."""

import struct
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from fusion_core.model.conventions import Float32Array
from fusion_core.recordings.clouds import lzf
from fusion_core.recordings.clouds.bad_cloud import BadCloud
from fusion_core.recordings.clouds.point_layout import PointField, PointLayout, require_count
from fusion_core.recordings.clouds.rows import read_binary_rows, read_text_rows
from fusion_core.recordings.quoting import quote_clipped

_MAX_HEADER_BYTES = 1 << 20
_KINDS = {"I": "i", "U": "u", "F": "f"}
_SIZES = {"i": (1, 2, 4, 8), "u": (1, 2, 4, 8), "f": (4, 8)}
_STORAGES = ("ascii", "binary", "binary_compressed")
# Set by hand: x, y, z and intensity of the largest cloud, and as much again before them.
_MAX_CONTENT_BYTES = 256 << 20


def is_pcd(head: bytes) -> bool:
    """Whether the first bytes of a file are those of a PCD file."""
    lines = head.splitlines()
    if lines and lines[0].startswith(b"# .PCD"):
        return True
    words = next((line.split() for line in lines if line.strip()[:1] not in (b"", b"#")), [])
    return bool(words) and words[0] in (b"VERSION", b"FIELDS", b"COLUMNS")


def read_pcd(file: BinaryIO, size_bytes: int, warnings: list[str]) -> Float32Array:
    """(N, 3 or 4) x, y, z and intensity as they are stored; the viewpoint is left alone.

    Rows that the file lacks are left out, those that are damaged are NaN; ``warnings`` says so.
    Raises BadCloud.
    """
    header = _read_header(file)
    rest_bytes = size_bytes - file.tell()
    if header.storage == "binary_compressed":
        return _read_compressed(file, header, rest_bytes, warnings)
    if header.storage == "binary":
        values = read_binary_rows(file, header.layout, header.count)
    else:
        values, damaged = read_text_rows(file, header.layout, header.count)
        if damaged:
            warnings.append(f"{damaged} of its lines are damaged; their points are left out.")
    if len(values) < header.count:
        warnings.append(f"It is cut short: {len(values)} of {header.count} points are there.")
    return values


@dataclass(frozen=True, slots=True)
class _Header:
    layout: PointLayout
    count: int
    storage: str


def _read_header(file: BinaryIO) -> _Header:
    entries: dict[str, list[str]] = {}
    read_bytes = 0
    while "DATA" not in entries:
        line = file.readline(_MAX_HEADER_BYTES - read_bytes)
        read_bytes += len(line)
        if not line:
            raise BadCloud("its header does not end with a line DATA")
        words = line.decode("ascii", errors="replace").split()
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
    storage = " ".join(entries["DATA"])
    if storage not in _STORAGES:
        raise BadCloud(
            f"its data are {quote_clipped(storage)}", f"PCD files hold {', '.join(_STORAGES)}."
        )
    return _Header(_layout(entries), _count(entries), storage)


def _layout(entries: dict[str, list[str]]) -> PointLayout:
    names = entries.get("FIELDS", entries.get("COLUMNS", []))
    sizes, types = entries.get("SIZE", []), entries.get("TYPE", [])
    counts = entries.get("COUNT", ["1"] * len(names))
    if not len(names) == len(sizes) == len(types) == len(counts):
        raise BadCloud(
            f"its header has {len(names)} FIELDS, {len(sizes)} SIZE, {len(types)} TYPE and "
            f"{len(counts)} COUNT"
        )
    fields = []
    for name, size, kind, count in zip(names, sizes, types, counts, strict=True):
        code = _KINDS.get(kind)
        if code is None or _whole(size, "SIZE") not in _SIZES[code]:
            raise BadCloud(
                f"its field {quote_clipped(name)} is of type {quote_clipped(kind)} and "
                f"{quote_clipped(size)} bytes"
            )
        dtype = np.dtype(f"<{code}{size}")
        # PCL reads a count of 0 as 1.
        fields.append(PointField(name, dtype, max(1, _whole(count, "COUNT"))))
    return PointLayout(tuple(fields))


def _count(entries: dict[str, list[str]]) -> int:
    width, height, points = (
        _whole(" ".join(entries[key]), key) if key in entries else None
        for key in ("WIDTH", "HEIGHT", "POINTS")
    )
    product = points if width is None else width * (1 if height is None else height)
    if product is None:
        raise BadCloud("its header does not state the number of points")
    if points not in (None, product):
        raise BadCloud(f"its header states {width} x {height} and {points} points")
    return require_count(product)


def _whole(text: str, key: str) -> int:
    # isdecimal also holds for digits of other scripts; thousands of digits are no number.
    if not (text.isascii() and text.isdecimal()) or len(text) > 18:
        raise BadCloud(f"its header states {key} {quote_clipped(text)}")
    return int(text)


def _read_compressed(
    file: BinaryIO, header: _Header, rest_bytes: int, warnings: list[str]
) -> Float32Array:
    """Each field is stored for all points at once, and all of them are one LZF stream."""
    sizes = file.read(8)
    if len(sizes) < 8:
        raise BadCloud("it is cut short: no point is there")
    packed_bytes, content_bytes = struct.unpack("<II", sizes)
    if content_bytes != header.count * header.layout.row_bytes:
        raise BadCloud(
            f"it claims {content_bytes} bytes, {header.count} points have "
            f"{header.count * header.layout.row_bytes}"
        )
    columns = header.layout.columns()
    ends = [header.count * (column.byte + column.dtype.itemsize) for column in columns]
    needed_bytes = max(ends)
    there_bytes = min(packed_bytes, rest_bytes - 8)
    if needed_bytes > _MAX_CONTENT_BYTES:
        raise BadCloud(
            f"it unpacks to {needed_bytes} bytes", f"At most {_MAX_CONTENT_BYTES} are read."
        )
    if content_bytes > lzf.MAX_RATIO * packed_bytes:
        raise BadCloud(f"{packed_bytes} compressed bytes cannot hold {content_bytes}")
    try:
        content, found = lzf.decompress(
            file.read(there_bytes), min(needed_bytes, lzf.MAX_RATIO * there_bytes)
        )
    except ValueError as error:
        raise BadCloud(str(error)) from error
    values = np.full((header.count, len(columns)), np.nan, np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        for place, column in enumerate(columns):
            start, item = header.count * column.byte, column.dtype.itemsize
            there = min(header.count, max(0, found - start) // item)
            found_bytes = content[start : start + there * item].tobytes()
            values[:there, place] = np.frombuffer(found_bytes, column.dtype)
    if found < needed_bytes:
        whole = int(np.isfinite(values[:, :3]).all(axis=1).sum())
        warnings.append(f"It is cut short: {whole} of {header.count} points have x, y and z.")
    return values
