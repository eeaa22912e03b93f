"""Text on pictures: DejaVu Sans, which has the characters °, ε, σ and ≤, antialiased."""

import threading
from bisect import bisect_right
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray
from scanloom.plots.palette import Color
from scanloom.plots.theme import LIGHT

if TYPE_CHECKING:
    from matplotlib.ft2font import FT2Font

Align = Literal["left", "middle", "right"]

SIZE_PX = 12

# Half the height of a digit in multiples of the size, by the font.
_HALF_DIGIT = 0.36
# A font object holds the text that it renders: one thread at a time.
_rendering = threading.Lock()


def draw_text(
    rgb: ByteArray,
    text: str,
    place_px: tuple[float, float],
    *,
    align: Align = "left",
    size_px: int = SIZE_PX,
    color: Color = LIGHT.ink,
) -> None:
    """Draw a line of text into ``rgb``, (H, W, 3) uint8; what lies outside is clipped.

    ``place_px``: x of the text's left end, middle or right end by ``align``, and y of the middle of
    its digits. ``color``: the ink of the picture's theme, as a rule.
    """
    coverage, baseline = _render(text, size_px)
    before = {"left": 0.0, "middle": 0.5, "right": 1.0}[align] * coverage.shape[1]
    left, top = round(place_px[0] - before), round(place_px[1]) - _middle(baseline, size_px)
    _blend(rgb, coverage, left, top, color)


def draw_vertical_text(
    rgb: ByteArray, text: str, place_px: tuple[float, float], *, color: Color = LIGHT.ink
) -> None:
    """Draw a line that reads upwards, with its middle at ``place_px``; else as ``draw_text``."""
    coverage, baseline = _render(text, SIZE_PX)
    coverage = np.rot90(coverage)
    left = round(place_px[0]) - _middle(baseline, SIZE_PX)
    top = round(place_px[1] - coverage.shape[0] + 0.5 * coverage.shape[0])
    _blend(rgb, coverage, left, top, color)


def _middle(baseline: int, size_px: int) -> int:
    """The row of a rendered text that is the middle of its digits."""
    return baseline - round(_HALF_DIGIT * size_px + 0.5)


def _blend(rgb: ByteArray, coverage: ByteArray, left: int, top: int, color: Color) -> None:
    """Blend a colour into a picture by its (h, w) coverage, clipped at the edges."""
    bottom, right = top + coverage.shape[0], left + coverage.shape[1]
    target = rgb[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)]
    alpha = coverage[max(-top, 0) :, max(-left, 0) :][: target.shape[0], : target.shape[1]]
    if not target.size:
        return
    # uint8 would wrap around in the products. By OpenCV, for numpy takes several times as long.
    opaque = cv2.cvtColor(alpha, cv2.COLOR_GRAY2RGB)
    paper = cv2.multiply(target, cv2.bitwise_not(opaque), dtype=cv2.CV_16U)
    ink = cv2.multiply(opaque, np.array([*color, 0], dtype=np.float64), dtype=cv2.CV_16U)
    target[:] = cv2.convertScaleAbs(cv2.add(paper, ink), alpha=1.0 / 255.0)


def text_width(text: str, *, size_px: int = SIZE_PX) -> int:
    """The width of a line of text in pixels."""
    width: int = _render(text, size_px)[0].shape[1]
    return width


def shorten(text: str, width_px: int, *, size_px: int = SIZE_PX) -> str:
    """``text``, cut and with an ellipsis at its end where it is wider than ``width_px``."""
    # No character is narrower than a pixel, and a name may be long.
    text = text[: width_px + 1]
    if text_width(text, size_px=size_px) <= width_px:
        return text
    fits = bisect_right(
        range(1, len(text)), width_px, key=lambda n: text_width(f"{text[:n]}…", size_px=size_px)
    )
    return f"{text[:fits].rstrip()}…" if fits else ""


@lru_cache(maxsize=4096)
def _render(text: str, size_px: int) -> tuple[ByteArray, int]:
    """(h, w) uint8 coverage of a line of text, and the first row below its baseline."""
    if not text:
        return np.zeros((1, 0), dtype=np.uint8), 1
    font = _font()
    with _rendering:
        # Names come from recordings: characters that the font lacks are replaced.
        text = "".join(c if font.get_char_index(ord(c)) else "\ufffd" for c in text)
        # At 72 dots per inch a point is a pixel.
        font.set_size(size_px, 72.0)
        font.set_text(text)
        font.draw_glyphs_to_bitmap(antialiased=True)
        coverage = np.array(font.get_image(), dtype=np.uint8)
        descent = round(font.get_descent() / 64.0)
    coverage.setflags(write=False)
    # The last row is empty for any text.
    return coverage, coverage.shape[0] - 1 - descent


@cache
def _font() -> "FT2Font":
    # Imported with the first text: it takes longer than all else that a command starts with.
    import matplotlib as mpl
    from matplotlib.ft2font import FT2Font

    return FT2Font(str(Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"))
