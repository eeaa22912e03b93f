"""Pictures for the browser: encoded once, even if displayed in several places."""

import weakref

import cv2
import numpy as np
import viser

from fusion_core.model.conventions import ByteArray, read_only

_OPTIONS = [
    *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_DEFAULT),
    *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_NONE),
]
# By identity, as long as the picture lives.
_encoded: dict[int, bytes] = {}


def show_picture(handle: viser.GuiImageHandle | viser.ImageHandle, rgb: ByteArray) -> None:
    """Give an image of a panel or of the scene another picture, (H, W, 3) uint8, to be kept as it
    is: it becomes read-only."""
    # Replaces viser's setter, which would encode anew at each call and with little compression.
    handle._image, handle._format, handle._data = rgb, "png", png_of(rgb)


def png_of(rgb: ByteArray) -> bytes:
    """A picture, (H, W, 3) uint8, as PNG. Drawings, with their flat areas, take a third of the
    bytes and less time with this strategy and no filter than as OpenCV writes them by itself."""
    key = id(rgb)
    if key not in _encoded:
        read_only(rgb)
        bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
        weakref.finalize(rgb, _encoded.pop, key, None)
        _encoded[key] = cv2.imencode(".png", bgr, _OPTIONS)[1].tobytes()
    return _encoded[key]


def show_png(handle: viser.GuiImageHandle, png: bytes) -> None:
    """Show a PNG file as it is. Raises ValueError where it is none."""
    bgr = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR) if png else None
    if bgr is None:
        raise ValueError("not a PNG file")
    rgb = cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB).astype(np.uint8, copy=False)
    handle._image, handle._format, handle._data = rgb, "png", png
