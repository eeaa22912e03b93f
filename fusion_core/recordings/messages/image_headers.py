"""Sizes claimed by image files, checked before a decoder allocates memory for them."""

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

# Set by hand: a damaged header may claim any size, and OpenCV allocates it before reading on.
MAX_DECODED_BYTES = 1 << 26
# Set by hand, far above what encoders write; bounds the time for files of tiny parts.
_MAX_PARTS = 1 << 16

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_PNG_CHUNK = struct.Struct(">I4s")
_PNG_CRC = struct.Struct(">I")
_PNG_HEADER = struct.Struct(">IIBB")
# Channels after decoding, by colour type; a palette becomes three.
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 4, 6: 4}
_JPEG_MAGIC = b"\xff\xd8\xff"
_JPEG_END = b"\xff\xd9"
_JPEG_SEGMENT = struct.Struct(">BBH")
_JPEG_FRAME = struct.Struct(">BHH")
# Start-of-frame markers of all JPEG modes; C4, C8 and CC are no frames.
_JPEG_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_SCAN = 0xDA
_PNM_CHANNELS = {b"P5": 1, b"P6": 3}
_PNM_HEAD_BYTES = 4096
_TIFF_ORDERS: Final = {b"II*\0": "<", b"MM\0*": ">"}
_TIFF_ENTRY_BYTES = 12
_TIFF_TYPES = {3: "H", 4: "I"}
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_BITS, _TIFF_CHANNELS = 256, 257, 258, 277
_TIFF_STRIP_ROWS, _TIFF_TILE_WIDTH, _TIFF_TILE_HEIGHT = 278, 322, 323
_TIFF_ALL_ROWS = (1 << 32) - 1


class BadImage(ValueError):
    """The bytes are an unsupported format, truncated, or claim too large a size."""


@dataclass(frozen=True, slots=True)
class ImageSize:
    """Size of an image in pixels, and bytes per decoded pixel."""

    width: int
    height: int
    pixel_bytes: int


def read_image_size(packed: bytes) -> ImageSize:
    """The size of a PNG, JPEG, PGM, PPM or single-channel TIFF image.

    Raises BadImage for other content, for a file that ends too early, for a damaged PNG, and for
    a size beyond ``MAX_DECODED_BYTES``.
    """
    reader = next((read for magic, read in _READERS.items() if packed.startswith(magic)), None)
    if reader is None:
        raise BadImage("is no PNG, JPEG, PGM, PPM or TIFF image")
    try:
        size = reader(packed)
    except struct.error:
        raise BadImage("is an image that is cut short") from None
    if size.width * size.height == 0:
        raise BadImage(f"claims {size.width} x {size.height} pixels")
    if size.width * size.height * size.pixel_bytes > MAX_DECODED_BYTES:
        raise BadImage(
            f"claims {size.width} x {size.height} pixels of {size.pixel_bytes} bytes, more than "
            f"{MAX_DECODED_BYTES} bytes in all"
        )
    return size


def _png(packed: bytes) -> ImageSize:
    """Checks every chunk's length, which libpng trusts, and its checksum."""
    view, position, size = memoryview(packed), len(_PNG_MAGIC), None
    for _ in range(_MAX_PARTS):
        length, kind = _PNG_CHUNK.unpack_from(packed, position)
        content = position + _PNG_CHUNK.size
        if content + length + _PNG_CRC.size > len(packed):
            raise BadImage("is a PNG image that is cut short")
        # The checksum covers the chunk's name, the last four bytes before its content.
        (checksum,) = _PNG_CRC.unpack_from(packed, content + length)
        if zlib.crc32(view[content - 4 : content + length]) != checksum:
            raise BadImage("is a PNG image that is damaged: a checksum does not fit")
        if kind == b"IHDR":
            width, height, bits, color_type = _PNG_HEADER.unpack_from(packed, content)
            channels = _PNG_CHANNELS.get(color_type, 4)
            size = ImageSize(width, height, channels * (2 if bits > 8 else 1))
        if kind == b"IEND" and size is not None:
            return size
        position = content + length + _PNG_CRC.size
    raise BadImage(f"is a PNG image of more than {_MAX_PARTS} chunks")


def _jpeg(packed: bytes) -> ImageSize:
    """Requires the end marker, because decoders fill the rest of a truncated image with grey."""
    position, size = len(_JPEG_END), None
    for _ in range(_MAX_PARTS):
        mark, kind, length = _JPEG_SEGMENT.unpack_from(packed, position)
        if mark != 0xFF:
            raise BadImage("is a JPEG image that is damaged")
        if kind in _JPEG_FRAMES:
            _, height, width = _JPEG_FRAME.unpack_from(packed, position + _JPEG_SEGMENT.size)
            size = ImageSize(width, height, 3)
        if kind == _JPEG_SCAN and size is not None:
            if packed.find(_JPEG_END, position) < 0:
                raise BadImage("is a JPEG image that is cut short")
            return size
        # Any number of fill bytes may precede a segment's marker.
        position += 1 if kind == 0xFF else 2 + length
    raise BadImage(f"is a JPEG image of more than {_MAX_PARTS} segments")


def _pnm(packed: bytes) -> ImageSize:
    head = packed[:_PNM_HEAD_BYTES]
    fields: list[int] = []
    position = 2
    while len(fields) < 3:
        position += len(head[position:]) - len(head[position:].lstrip())
        if head[position : position + 1] == b"#":
            newline = head.find(b"\n", position)
            position = newline if newline >= 0 else len(head)
            continue
        word = head[position:].split(maxsplit=1)[:1]
        if not word or not word[0].isdigit() or len(word[0]) > 9:
            raise BadImage("is a PGM or PPM image without width, height and largest value")
        fields.append(int(word[0]))
        position += len(word[0])
    width, height, largest = fields
    channels = _PNM_CHANNELS[packed[:2]]
    size = ImageSize(width, height, channels * (2 if largest > 255 else 1))
    if len(packed) - position - 1 < width * height * size.pixel_bytes:
        raise BadImage(f"is cut short for {width} x {height} pixels")
    return size


def _tiff(packed: bytes) -> ImageSize:
    """Includes strips and tiles, because the decoder allocates whole ones."""
    order = _TIFF_ORDERS[packed[:4]]
    (directory,) = struct.unpack_from(order + "I", packed, 4)
    (count,) = struct.unpack_from(order + "H", packed, directory)
    tags = {_TIFF_BITS: 1, _TIFF_CHANNELS: 1, _TIFF_TILE_WIDTH: 0, _TIFF_TILE_HEIGHT: 0}
    for place in range(count):
        at = directory + 2 + place * _TIFF_ENTRY_BYTES
        tag, kind, _ = struct.unpack_from(order + "HHI", packed, at)
        if kind in _TIFF_TYPES:
            (tags[tag],) = struct.unpack_from(order + _TIFF_TYPES[kind], packed, at + 8)
    if tags[_TIFF_CHANNELS] != 1:
        raise BadImage(f"is a TIFF image of {tags[_TIFF_CHANNELS]} channels, one is read")
    strip_rows = tags.get(_TIFF_STRIP_ROWS, _TIFF_ALL_ROWS)
    if strip_rows == _TIFF_ALL_ROWS:
        strip_rows = 0
    return ImageSize(
        max(tags.get(_TIFF_WIDTH, 0), tags[_TIFF_TILE_WIDTH]),
        max(tags.get(_TIFF_HEIGHT, 0), tags[_TIFF_TILE_HEIGHT], strip_rows),
        (tags[_TIFF_BITS] + 7) // 8,
    )


_READERS: dict[bytes, Callable[[bytes], ImageSize]] = {
    _PNG_MAGIC: _png,
    _JPEG_MAGIC: _jpeg,
    **dict.fromkeys(_PNM_CHANNELS, _pnm),
    **dict.fromkeys(_TIFF_ORDERS, _tiff),
}
