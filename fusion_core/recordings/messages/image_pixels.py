"""sensor_msgs/Image to pixels: encodings, byte order and the padding of rows."""

from typing import Any

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray
from fusion_core.recordings.messages.bad_message import BadMessage
from fusion_core.recordings.quoting import quote_clipped

MAX_PIXELS = 1 << 26

# Bytes per pixel, and OpenCV's conversion to RGB.
_COLOR_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "8UC3": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "mono8": (1, cv2.COLOR_GRAY2RGB),
    "8UC1": (1, cv2.COLOR_GRAY2RGB),
}
_DEPTH_DTYPES = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}


def is_depth_encoding(encoding: str) -> bool:
    """Whether an image of this encoding holds depth. ``mono16`` may also be a grey image."""
    return encoding in _DEPTH_DTYPES


def is_color_encoding(encoding: str) -> bool:
    """Whether an image of this encoding can be shown as colour."""
    return encoding in _COLOR_ENCODINGS


def read_depth_pixels(raw: Any) -> np.ndarray[Any, Any]:
    """(H, W) uint16 millimetres or float32 metres of a depth encoding, a view of the message."""
    dtype = np.dtype((">" if raw.is_bigendian else "<") + _DEPTH_DTYPES[raw.encoding])
    return _rows(raw, dtype.itemsize).view(dtype)


def read_rgb_pixels(raw: Any) -> ByteArray:
    """(H, W, 3) uint8 of a colour or grey encoding; a copy, so that the message can be freed."""
    if raw.encoding not in _COLOR_ENCODINGS:
        known = ", ".join([*_DEPTH_DTYPES, *_COLOR_ENCODINGS])
        raise BadMessage(
            f"image encoding {quote_clipped(raw.encoding)} is not read", f"Read are {known}."
        )
    pixel_bytes, conversion = _COLOR_ENCODINGS[raw.encoding]
    pixels = _rows(raw, pixel_bytes).reshape(raw.height, raw.width, pixel_bytes)
    if conversion is None:
        return pixels.copy()
    rgb: ByteArray = np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)
    return rgb


def _rows(raw: Any, pixel_bytes: int) -> ByteArray:
    """(H, W * pixel_bytes) view of an image without the padding at the ends of its rows."""
    height, width, step = int(raw.height), int(raw.width), int(raw.step)
    row_bytes = width * pixel_bytes
    if height == 0 or width == 0 or step < row_bytes:
        raise BadMessage(
            f"a {raw.encoding} image of {width} x {height} pixels cannot have step {step}",
            "Check the camera driver's image settings.",
        )
    if height * width > MAX_PIXELS:
        raise BadMessage(
            f"the image claims {width} x {height} pixels, more than {MAX_PIXELS}",
            "The message is damaged; leave the topic out.",
        )
    data: ByteArray = raw.data
    # The last row may lack its padding.
    needed = (height - 1) * step + row_bytes
    if data.nbytes < needed:
        raise BadMessage(
            f"the image holds {data.nbytes} bytes, {width} x {height} {raw.encoding} need {needed}",
            "The message was cut short; record again or leave the topic out.",
        )
    return np.ndarray((height, row_bytes), np.uint8, data, strides=(step, 1))
