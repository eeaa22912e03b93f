"""sensor_msgs/CompressedImage to pixels: JPEG and PNG files, and compressedDepth (PNG, RVL).

image_transport writes into ``format`` what the image was and how it was packed:
"rgb8; jpeg compressed bgr8", "16UC1; png compressed", "32FC1; compressedDepth rvl". Other drivers
write "jpeg" or "png" alone.
"""

import struct
from math import isfinite
from typing import Any, Literal

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array
from fusion_core.recordings.messages.bad_message import BadMessage
from fusion_core.recordings.messages.image_headers import BadImage, read_image_size
from fusion_core.recordings.messages.image_pixels import is_depth_encoding
from fusion_core.recordings.quoting import quote_clipped

# Set by hand, above any depth camera; keeps the decoded values and masks well below 256 MiB.
MAX_DEPTH_PIXELS = 1 << 24
_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_JPEG_MAGIC = b"\xff\xd8\xff"
# Bit depth and colour type, which is 0 for grey.
_PNG_KIND = slice(24, 26)
_GREY_16_BIT = b"\x10\x00"
# compressedDepth begins with its ConfigHeader: an unused number and the parameters A and B.
_CONFIG = struct.Struct("<iff")
_RVL_SIZE = struct.Struct("<II")
_CUT_SHORT = "The message was cut short; record again or leave the topic out."

Compression = Literal["file", "compressedDepth png", "compressedDepth rvl", "unknown"]


def decompressed_encoding(format: str, data: ByteArray) -> str:
    """The encoding of the image as sensor_msgs/Image; ``format`` itself if it is not supported.

    Reads only the first bytes of ``data``.
    """
    encoding, packing = _parse_format(format)
    head = data[: _PNG_KIND.stop].tobytes()
    if packing == "unknown" or (is_depth_encoding(encoding) and head.startswith(_JPEG_MAGIC)):
        # JPEG has only 8 lossy bits: such an image is a picture of depth, not depth.
        return format
    if is_depth_encoding(encoding):
        return "16UC1" if encoding == "mono16" and packing != "file" else encoding
    if not encoding and head.startswith(_PNG_MAGIC) and head[_PNG_KIND] == _GREY_16_BIT:
        return "mono16"
    return "rgb8" if head.startswith((_PNG_MAGIC, _JPEG_MAGIC)) else format


def decompress_image(format: str, data: ByteArray) -> np.ndarray[Any, Any]:
    """(H, W, 3) uint8 RGB, (H, W) uint16 millimetres or (H, W) float32 metres.

    Raises BadMessage for an unsupported format, and for data that is truncated, damaged or claims
    too large a size.
    """
    packing = _parse_format(format)[1]
    encoding = decompressed_encoding(format, data)
    packed = data.tobytes()
    if encoding == "rgb8":
        return _decompress_rgb(packed)
    if not is_depth_encoding(encoding):
        raise BadMessage(
            f"a compressed image of format {quote_clipped(format)} is not read",
            "Read are JPEG and PNG, and compressedDepth as PNG or RVL; or its data is damaged.",
        )
    if packing == "file":
        return _decompress_depth_file(packed, encoding)
    values = (
        _decompress_rvl(packed)
        if packing == "compressedDepth rvl"
        else _decompress_depth_png(packed)
    )
    return _metres_from_inverse(packed, values) if encoding == "32FC1" else values


def _parse_format(format: str) -> tuple[str, Compression]:
    """The encoding before compression (empty if not stated in ``format``), and the compression."""
    encoding, separator, rest = (part.strip() for part in format.partition(";"))
    if not separator:
        # Early versions of compressedDepth wrote the encoding alone.
        return (encoding, "compressedDepth png") if is_depth_encoding(encoding) else ("", "file")
    if "compressedDepth" not in rest:
        return encoding, "file"
    codec = rest.partition("compressedDepth")[2].split()[:1]
    if is_depth_encoding(encoding) and codec in ([], ["png"]):
        return encoding, "compressedDepth png"
    if is_depth_encoding(encoding) and codec == ["rvl"]:
        return encoding, "compressedDepth rvl"
    return encoding, "unknown"


def _decompress_rgb(packed: bytes) -> ByteArray:
    bgr = _decode_image_file(packed, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    rgb: ByteArray = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)
    return rgb


def _decompress_depth_file(packed: bytes, encoding: str) -> np.ndarray[Any, Any]:
    """An image file of one channel: 16 bits, or floating metres for 32FC1."""
    pixels = _decode_image_file(packed, cv2.IMREAD_UNCHANGED, MAX_DEPTH_PIXELS)
    expected = np.float32 if encoding == "32FC1" else np.uint16
    if pixels.ndim != 2 or pixels.dtype != expected:
        raise BadMessage(
            f"the {encoding} image is unpacked to {pixels.dtype} of shape {pixels.shape}",
            "Check the driver that compresses it.",
        )
    return pixels


def _decompress_depth_png(packed: bytes) -> np.ndarray[Any, Any]:
    """(H, W) uint16. Searches for the PNG, because some writers omit the header before it."""
    start = packed.find(_PNG_MAGIC)
    if start < 0:
        raise BadMessage("the compressed depth holds no PNG image", _CUT_SHORT)
    return _decompress_depth_file(packed[start:], "16UC1")


def _decompress_rvl(packed: bytes) -> np.ndarray[Any, Any]:
    """(H, W) uint16."""
    # numba takes longer to import than most recordings to index, and few need it.
    from fusion_core.recordings.messages.rvl import decompress

    body = _CONFIG.size + _RVL_SIZE.size
    if len(packed) < body:
        raise BadMessage(f"the compressed depth is cut short at {len(packed)} bytes", _CUT_SHORT)
    width, height = _RVL_SIZE.unpack_from(packed, _CONFIG.size)
    _check_pixels(width, height, MAX_DEPTH_PIXELS)
    try:
        return decompress(packed[body:], width * height).reshape(height, width)
    except ValueError as error:
        raise BadMessage(f"the RVL image of {width} x {height} {error}", _CUT_SHORT) from error


def _metres_from_inverse(packed: bytes, values: np.ndarray[Any, Any]) -> Float32Array:
    """(H, W) depth from its quantised inverse: A / (inverse - B), NaN where the inverse is 0."""
    if 0 <= packed.find(_PNG_MAGIC) < _CONFIG.size:
        raise BadMessage(
            "the 32FC1 depth lacks the header with its A and B",
            "Check the driver that compresses it.",
        )
    _, a, b = _CONFIG.unpack_from(packed)
    if not (isfinite(a) and isfinite(b) and a > 0.0):
        raise BadMessage(
            f"depth cannot be had from its inverse with A = {a:g} and B = {b:g}",
            "Check the driver that compresses it.",
        )
    depth_m = values.astype(np.float32)
    depth_m -= np.float32(b)
    with np.errstate(divide="ignore", over="ignore"):
        np.divide(np.float32(a), depth_m, out=depth_m)
    depth_m[values == 0] = np.nan
    return depth_m


def _decode_image_file(
    packed: bytes, flags: int, max_pixels: int | None = None
) -> np.ndarray[Any, Any]:
    try:
        size = read_image_size(packed)
        if max_pixels is not None:
            _check_pixels(size.width, size.height, max_pixels)
        pixels = cv2.imdecode(np.frombuffer(packed, np.uint8), flags)
    except BadImage as error:
        raise BadMessage(f"the image {error}", _CUT_SHORT) from error
    except cv2.error as error:
        raise BadMessage(f"the image is damaged: {error.err}", _CUT_SHORT) from error
    if pixels is None:
        raise BadMessage("the image is damaged", _CUT_SHORT)
    return np.asarray(pixels)


def _check_pixels(width: int, height: int, most: int) -> None:
    if not 0 < width * height <= most:
        raise BadMessage(
            f"the image claims {width} x {height} pixels, not 1 to {most}",
            "The message is damaged; leave the topic out.",
        )
