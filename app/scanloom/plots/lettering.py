"""Text on pictures: DejaVu Sans, which has the signs °, ε, σ and ≤, smoothed to whole pixels."""

import threading
from bisect import bisect_right
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from fusion_core.model.conventions import ByteArray
from scanloom.plots.palette import Color

if TYPE_CHECKING:
    from matplotlib.ft2font import FT2Font

Align = Literal["left", "middle", "right"]

SIZE_PX = 12
INK: Color = (33, 37, 41)

# Half the height of a figure: what brings the middle of numbers onto a line.
_HALF_FIGURE = 0.36
# A font holds the text that it draws: two threads must not use one at a time.
_drawing = threading.Lock()


def write(
    sheet: ByteArray,
    text: str,
    x_px: float,
    y_px: float,
    *,
    align: Align = "left",
    size_px: int = SIZE_PX,
    color: Color = INK,
    turned: bool = False,
) -> None:
    """Write a line into ``sheet``, (H, W, 3) uint8; text outside is clipped.

    ``y_px``: the middle of the line's figures. ``turned``: reads upwards, and then ``x_px`` is that
    middle and ``align`` is along y, left at the bottom.
    """
    coverage, baseline = _drawn(text, size_px)
    middle = baseline - round(_HALF_FIGURE * size_px + 0.5)
    before = {"left": 0.0, "middle": 0.5, "right": 1.0}[align] * coverage.shape[1]
    if turned:
        coverage = np.rot90(coverage)
        left, top = round(x_px) - middle, round(y_px - coverage.shape[0] + before)
    else:
        left, top = round(x_px - before), round(y_px) - middle
    bottom, right = top + coverage.shape[0], left + coverage.shape[1]
    target = sheet[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)]
    alpha = coverage[max(-top, 0) :, max(-left, 0) :][: target.shape[0], : target.shape[1]]
    alpha = alpha[:, :, np.newaxis].astype(np.int32)
    # uint8 would wrap around in the products.
    target[:] = (target * (255 - alpha) + np.array(color, dtype=np.int32) * alpha + 127) // 255


def width_of(text: str, *, size_px: int = SIZE_PX) -> int:
    """The width of a line of text in pixels."""
    width: int = _drawn(text, size_px)[0].shape[1]
    return width


def shortened(text: str, width_px: int, *, size_px: int = SIZE_PX) -> str:
    """``text``, cut and with an ellipsis at its end where it is wider than ``width_px``."""
    # No sign is narrower than a pixel, and a name may be long.
    text = text[: width_px + 1]
    if width_of(text, size_px=size_px) <= width_px:
        return text
    fits = bisect_right(
        range(1, len(text)), width_px, key=lambda n: width_of(f"{text[:n]}…", size_px=size_px)
    )
    return f"{text[:fits].rstrip()}…" if fits else ""


@lru_cache(maxsize=4096)
def _drawn(text: str, size_px: int) -> tuple[ByteArray, int]:
    """(h, w) uint8 coverage of a line of text, and the first row below its baseline."""
    if not text:
        return np.zeros((1, 0), dtype=np.uint8), 1
    font = _font()
    with _drawing:
        # Names come from recordings: what the font lacks is shown as such.
        text = "".join(sign if font.get_char_index(ord(sign)) else "\ufffd" for sign in text)
        # At 72 dots an inch a point is a pixel.
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
