"""Labels of depth images as masks: an 8-bit grey PNG for each image, as its rows are stored.

A pixel is 0 where there is no label, and else the label's code + 1.
"""

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from fusion_core.exporting.labels.capture_folder import (
    MaskCoding,
    read_capture_folder,
    write_capture_folder,
)
from fusion_core.exporting.labels.label_file import LabelFile, LabelHeader
from fusion_core.model.conventions import IntArray
from fusion_core.model.labels import CaptureLabels

FORMAT = "png"
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_EIGHT_BIT_GREY = (8, 0)
# A chunk's length and kind, and its checksum.
_CHUNK_BYTES = 12
# Set by hand, above what packing adds at worst and other programs write beside the pixels.
_SPARE_BYTES = 1 << 16


def write_png_masks(folder: Path, header: LabelHeader, layer: Iterable[CaptureLabels]) -> None:
    """Write into an existing, empty folder. Raises ExportError where it cannot be written."""
    write_capture_folder(folder, header, layer, _CODING)


def read_png_masks(folder: Path) -> LabelFile:
    """Raises RecordingError."""
    return read_capture_folder(folder, _CODING)


def _encode(values: IntArray) -> bytes:
    # Stretches of one value pack best so, and fastest.
    strategy = [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    return cv2.imencode(".png", values.astype(np.uint8), strategy)[1].tobytes()


def _decode(content: bytes, rows: int, columns: int) -> IntArray:
    _require_whole_mask(content, rows, columns)
    mask = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if mask is None or mask.shape != (rows, columns) or mask.dtype != np.uint8:
        raise ValueError("it is a damaged image")
    return mask.astype(np.int64)


def _require_whole_mask(content: bytes, rows: int, columns: int) -> None:
    """Raises ValueError. Of a damaged file OpenCV gives what it could read, without a word."""
    if not content.startswith(_SIGNATURE):
        raise ValueError("it is no PNG")
    place = len(_SIGNATURE)
    kind = b""
    while kind != b"IEND":
        size, kind = struct.unpack(">I4s", content[place : place + 8].ljust(8, b"\0"))
        body = content[place + 4 : place + 8 + size]
        checksum = content[place + 8 + size : place + _CHUNK_BYTES + size]
        if checksum != zlib.crc32(body).to_bytes(4, "big"):
            raise ValueError("it is cut off or damaged")
        if place == len(_SIGNATURE):
            width, height, *depth_and_color = struct.unpack(">4xIIBB", body[:14].ljust(14, b"\0"))
            if (height, width) != (rows, columns):
                raise ValueError(
                    f"it has {height} x {width} pixels, and its image {rows} x {columns}"
                )
            if tuple(depth_and_color) != _EIGHT_BIT_GREY:
                raise ValueError("it is no 8-bit grey PNG")
        place += _CHUNK_BYTES + size


_CODING = MaskCoding(
    format=FORMAT,
    suffix=".png",
    encode=_encode,
    decode=_decode,
    max_bytes=lambda rows, columns: 2 * (rows + 1) * (columns + 1) + _SPARE_BYTES,
)
