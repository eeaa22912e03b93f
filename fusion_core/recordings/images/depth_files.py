"""Depth image files: 16-bit PNG, PGM, TIFF and NPY in a given unit, floats in metres.

Every function raises RecordingError with the file's name.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from fusion_core.model.conventions import Float32Array
from fusion_core.model.errors import RecordingError
from fusion_core.recordings.images.frame_files import decode_image, read_image_bytes
from fusion_core.recordings.messages.image_headers import (
    MAX_DECODED_BYTES,
    BadImage,
    read_image_size,
)
from fusion_core.recordings.units import (
    MILLIMETRES_PER_METRE,
    SATURATED_DEPTH,
    depth_m_from_metres,
    depth_m_from_units,
)

_NPY_MAGIC = b"\x93NUMPY"
# The header that numpy writes for a plain two-dimensional array. It is a Python literal; matching
# it avoids evaluating untrusted input.
_NPY_HEADER = re.compile(
    rb"\x93NUMPY\x01\0..\{'descr': '([<>](?:u2|f4|f8))', 'fortran_order': (True|False), "
    rb"'shape': \((\d{1,6}), (\d{1,6})\), \} *\n",
    re.DOTALL,
)
# Set by hand: with fewer values the encoding is not checked.
_MIN_PIXELS = 100
# Large images are subsampled to about this many, for speed.
_MAX_SAMPLED_PIXELS = 1 << 20
# About the range limit of structured-light and time-of-flight cameras; set by hand.
_FARTHEST_MM = 10_000
# The largest 13-bit number: distances from 1024 mm, rotated left by 3 bits, exceed it.
_ROTATED_MM = 8_191
_MIN_FRACTION = 0.99


def read_depth(file: Path, units_per_metre: float) -> tuple[Float32Array, str]:
    """(H, W) metres, NaN where missing, and the encoding for DepthImage.

    ``units_per_metre`` is for 16-bit files; floating files hold metres. Encoding "16UC1" means
    millimetres; other units are returned as "32FC1", which represents them without loss.
    """
    pixels = _read_pixels(file)
    if pixels.dtype == np.uint16:
        encoding = "16UC1" if units_per_metre == MILLIMETRES_PER_METRE else "32FC1"
        return depth_m_from_units(pixels, units_per_metre), encoding
    with np.errstate(over="ignore"):
        metres = pixels.astype(np.float32)
    return depth_m_from_metres(metres), "32FC1"


def read_depth_shape(file: Path) -> tuple[int, int]:
    """(rows, columns) without decoding."""
    packed = read_image_bytes(file)
    if packed.startswith(_NPY_MAGIC):
        rows, columns = _npy_pixels(file, packed).shape
        return rows, columns
    try:
        size = read_image_size(packed)
    except BadImage as error:
        raise RecordingError(f"{error}.", file=file, advice="Copy it again.") from error
    return size.height, size.width


@dataclass(frozen=True, slots=True)
class DepthEncodingCheck:
    """Result of a check of depth files.

    ``has_integers``: some file has 16-bit values, whose unit must be known. ``scrambled_bits``: why
    these cannot be distances in any unit; ``other_unit``: why they cannot be millimetres. Each
    names its file, and is None if nothing was found.
    """

    has_integers: bool = False
    scrambled_bits: str | None = None
    other_unit: str | None = None


def check_depth_encoding(files: Sequence[Path]) -> DepthEncodingCheck:
    """Check the values of ``files``; those that cannot be read are skipped."""
    stored = DepthEncodingCheck()
    for file in files:
        try:
            pixels = _read_pixels(file)
        except RecordingError:
            continue
        if pixels.dtype == np.uint16:
            values = pixels.ravel()[:: 1 + pixels.size // _MAX_SAMPLED_PIXELS]
            values = values[(values != 0) & (values != SATURATED_DEPTH)]
            known = values.size >= _MIN_PIXELS
            disorder = _find_scrambled_bits(values) if known else None
            other_unit = _find_other_unit(values) if known else None
            stored = DepthEncodingCheck(
                True,
                stored.scrambled_bits or (disorder and f"{file.name}: {disorder}"),
                stored.other_unit or (other_unit and f"{file.name}: {other_unit}"),
            )
    return stored


def _find_scrambled_bits(values: np.ndarray[Any, Any]) -> str | None:
    low, high = int((values & 0xFF).max()), int((values >> 8).max())
    if 2 <= low < _FARTHEST_MM >> 8 < high:
        return "its two bytes seem swapped, as in raw dumps of NYU Depth"
    # Rotated left by 3, the zero high bits of a short distance become the low bits.
    if values.max() > _ROTATED_MM and not (values & 0b110).any():
        return "its bits seem rotated, as in SUN RGB-D"
    return None


def _find_other_unit(values: np.ndarray[Any, Any]) -> str | None:
    if values.max() > _FARTHEST_MM and (values % 5 == 0).mean() > _MIN_FRACTION:
        return "its steps are 5 and it reaches beyond 10 m, as in TUM RGB-D with 1/5000 m"
    return None


def _read_pixels(file: Path) -> np.ndarray[Any, Any]:
    """(H, W) uint16 or floating."""
    packed = read_image_bytes(file)
    if packed.startswith(_NPY_MAGIC):
        return _npy_pixels(file, packed)
    pixels = decode_image(file, packed, cv2.IMREAD_UNCHANGED)
    if pixels.ndim != 2 or pixels.dtype not in (np.uint16, np.float32):
        raise RecordingError(
            f"is no depth image: {pixels.dtype} of shape {pixels.shape}.",
            file=file,
            advice="Depth is a 16-bit PNG, PGM or TIFF, or metres as float TIFF or NPY.",
        )
    return pixels


def _npy_pixels(file: Path, packed: bytes) -> np.ndarray[Any, Any]:
    """A view of ``packed``, so that a header cannot claim more memory than the file has."""
    header = _NPY_HEADER.match(packed)
    if header is None:
        raise RecordingError(
            "is no NPY array of a depth image.",
            file=file,
            advice="Save rows x columns as float32 metres or uint16.",
        )
    dtype = np.dtype(header[1].decode())
    rows, columns = int(header[3]), int(header[4])
    needed = rows * columns * dtype.itemsize
    there = len(packed) - header.end()
    if not 0 < needed <= min(there, MAX_DECODED_BYTES):
        raise RecordingError(
            f"claims {rows} x {columns} values, {there} bytes follow.",
            file=file,
            advice="Copy it again from its source.",
        )
    values = np.frombuffer(packed, dtype, rows * columns, header.end())
    by_columns = header[2] == b"True"
    pixels = values.reshape(columns, rows).T if by_columns else values.reshape(rows, columns)
    return pixels.astype(dtype.newbyteorder("="), copy=False)
