"""What the pictures share: white paper with an edge, a plot box, ticks, a colour bar, a legend.

The paper is the picture's own, so that it reads the same on a light and on a dark page.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, IntArray
from scanloom.plots.lettering import width_of, write
from scanloom.plots.palette import Color

FAINT: Color = (134, 142, 150)
MARGIN_PX = 8
LINE_PX = 18
TITLE_PX = 13

_PAPER = 255
_EDGE: Color = (206, 212, 218)
_HATCH: tuple[Color, Color] = ((233, 236, 239), (206, 212, 218))
_HATCH_STEP_PX = 6
_TICK_PX = 4
_BAR_PX = 12
_SYMBOL_PX = 20
_GAP_PX = 12
# As wide as a figure.
_FIGURE_SPACE = "\u2007"

COLOR_BAR_PX = 76
"""Width that a colour bar takes with its numbers and its name."""


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of whole pixels in a picture."""

    left: int
    top: int
    width: int
    height: int

    @property
    def right(self) -> int:
        """The first column beyond."""
        return self.left + self.width

    @property
    def bottom(self) -> int:
        """The first row beyond."""
        return self.top + self.height

    def view(self, sheet: ByteArray) -> ByteArray:
        """The box's part of a picture; what is drawn into it stays inside."""
        return sheet[self.top : self.bottom, self.left : self.right]

    def holds(self, x_px: float, y_px: float) -> bool:
        """Whether a point lies on one of the box's pixels, whose centres are integers."""
        return (
            self.left - 0.5 <= x_px < self.right - 0.5
            and self.top - 0.5 <= y_px < self.bottom - 0.5
        )

    def frame(self, sheet: ByteArray) -> None:
        """Draw a line around the box, outside of it."""
        cv2.rectangle(
            sheet, (self.left - 1, self.top - 1), (self.right, self.bottom), FAINT, 1, cv2.LINE_4
        )


@dataclass(frozen=True, slots=True)
class LegendEntry:
    """``symbol`` draws into a (LINE_PX, 20, 3) part of the picture; ``words`` stand beside it."""

    symbol: Callable[[ByteArray], None]
    words: str


def blank_sheet(width_px: int, height_px: int) -> ByteArray:
    """(height_px, width_px, 3) uint8 of white paper with an edge."""
    sheet = np.full((height_px, width_px, 3), _PAPER, dtype=np.uint8)
    cv2.rectangle(sheet, (0, 0), (width_px - 1, height_px - 1), _EDGE, 1)
    return sheet


def room(left: int, top: int, right: int, bottom: int) -> Box:
    """The box between these edges. Raises ValueError where the picture is too small for one."""
    if right - left < 16 or bottom - top < 16:
        raise ValueError(f"the picture leaves {right - left} x {bottom - top} px to draw in")
    return Box(left, top, right - left, bottom - top)


def cells_of_pixels(cells: int, pixels: int) -> IntArray:
    """(pixels,) index of the cell that each pixel of a stretched axis shows."""
    return (2 * np.arange(pixels) + 1) * cells // (2 * pixels)


def paint_values(
    target: ByteArray,
    values: FloatArray | Float32Array,
    limits: tuple[float, float] | None,
    colors: ByteArray,
) -> None:
    """Fill ``target``, (h, w, 3), with ``values``, (H, W), in ``colors``; NaN is hatched.

    ``limits``: the values of the first and the last colour; None where there is no value.
    """
    height, width = target.shape[:2]
    if limits is None:
        target[:] = hatch(height, width)
        return
    for axis, pixels in enumerate((height, width)):
        if pixels < values.shape[axis]:
            # What is not shown need not be coloured.
            values = values.take(cells_of_pixels(values.shape[axis], pixels), axis=axis)
    rows = cells_of_pixels(values.shape[0], height)
    columns = cells_of_pixels(values.shape[1], width)
    low, high = limits
    missing = np.isnan(values)
    steps = np.clip((values - low) * (255.0 / (high - low)), 0.0, 255.0) + 0.5
    steps[missing] = 0.0
    # Stretched before it is coloured, and along one axis after the other: several times as fast.
    shades = steps.astype(np.uint8).take(columns, axis=1).take(rows, axis=0)
    target[:] = cv2.applyColorMap(shades, colors.reshape(256, 1, 3))
    if missing.any():
        stretched = missing.take(columns, axis=1).take(rows, axis=0)
        cv2.copyTo(hatch(height, width), stretched.view(np.uint8), target)


@lru_cache(maxsize=16)
def hatch(height_px: int, width_px: int) -> ByteArray:
    """(height_px, width_px, 3) uint8: the neutral stripes that say "no value". Not writable."""
    stripe = np.add.outer(np.arange(height_px), np.arange(width_px)) % _HATCH_STEP_PX < 2
    stripes = np.array(_HATCH, dtype=np.uint8)[stripe.astype(np.intp)]
    stripes.setflags(write=False)
    return stripes


def wide_limits(low: float, high: float) -> tuple[float, float]:
    """Limits of a scale that are apart even where all values are one."""
    least = 1e-6 * max(abs(low), abs(high), 1e-3)
    return (low, high) if high - low > least else (low - 0.5, high + 0.5)


def ticks_between(low: float, high: float, most: int) -> list[float]:
    """At most ``most`` round values from ``low`` to ``high``: steps of 1, 2 or 5 times 10^k."""
    span = high - low
    if not span > 0.0:
        return [low]
    power = 10.0 ** np.floor(np.log10(span / max(most, 1)))
    for factor in (1.0, 2.0, 5.0, 10.0, 20.0):
        step = factor * power
        first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
        if last - first + 1 <= most:
            break
    return [float(f"{number * step:.12g}") for number in range(first, last + 1)]


def whole_ticks_between(low: int, high: int, most: int) -> list[int]:
    """Those of ``ticks_between`` that are whole."""
    return [int(value) for value in ticks_between(low, high, most) if value == round(value)]


def number(value: float) -> str:
    """A tick's label, short and with a true minus."""
    small = 0.0 < abs(value) < 1e-3
    words = np.format_float_scientific(value, trim="-", exp_digits=1) if small else f"{value:g}"
    return words.replace("-", "−")


def steady(words: str, signs: int) -> str:
    """``words`` with invisible figures after them up to so many signs: a legend whose numbers
    change from frame to frame then keeps its lines."""
    return words.ljust(signs, _FIGURE_SPACE)


def tick_below(sheet: ByteArray, box: Box, x_px: float, words: str) -> None:
    """A tick and its label under the box."""
    x = round(x_px)
    cv2.line(sheet, (x, box.bottom + 1), (x, box.bottom + _TICK_PX), FAINT)
    write(sheet, words, x, box.bottom + _TICK_PX + 8, align="middle")


def tick_above(sheet: ByteArray, box: Box, x_px: float, words: str) -> None:
    """A tick and its label over the box."""
    x = round(x_px)
    cv2.line(sheet, (x, box.top - 2), (x, box.top - 1 - _TICK_PX), FAINT)
    write(sheet, words, x, box.top - _TICK_PX - 8, align="middle")


def tick_left(sheet: ByteArray, box: Box, y_px: float, words: str) -> None:
    """A tick and its label to the left of the box."""
    y = round(y_px)
    cv2.line(sheet, (box.left - 2, y), (box.left - 1 - _TICK_PX, y), FAINT)
    write(sheet, words, box.left - _TICK_PX - 3, y, align="right")


def color_bar(
    sheet: ByteArray,
    box: Box,
    limits: tuple[float, float],
    colors: ByteArray,
    *,
    words: str,
    beyond: tuple[bool, bool] = (False, False),
) -> None:
    """A colour bar beside ``box``, as high as it, with its numbers; the greatest value on top.

    ``beyond``: whether there are values below and above the limits; the ends then say so.
    """
    low, high = limits
    bar = Box(box.right + 9, box.top, _BAR_PX, box.height)
    steps = 255 - cells_of_pixels(256, bar.height)
    bar.view(sheet)[:] = colors[steps][:, np.newaxis]
    bar.frame(sheet)
    x = bar.right + _TICK_PX + 2
    ticks = ticks_between(low, high, max(2, min(6, bar.height // 34)))
    for value in ticks:
        y = round(bar.bottom - 0.5 - (value - low) / (high - low) * bar.height)
        cv2.line(sheet, (bar.right + 1, y), (bar.right + _TICK_PX - 1, y), FAINT)
        write(sheet, number(value), x, y)
    for there, y, sign in ((beyond[0], bar.bottom, "▼"), (beyond[1], bar.top, "▲")):
        if there:
            write(
                sheet,
                sign,
                bar.left + 0.5 * bar.width,
                y + (6 if sign == "▼" else -7),
                align="middle",
                size_px=8,
                color=FAINT,
            )
    write(
        sheet,
        words,
        box.right + COLOR_BAR_PX - 11,
        box.top + 0.5 * box.height,
        align="middle",
        turned=True,
    )


def legend_lines(entries: Sequence[LegendEntry], width_px: int) -> list[list[LegendEntry]]:
    """The entries in lines, none wider than ``width_px`` unless it is a single one."""
    lines: list[list[LegendEntry]] = []
    used = width_px
    for entry in entries:
        wide = _SYMBOL_PX + 4 + width_of(entry.words) + _GAP_PX
        if used + wide - _GAP_PX > width_px:
            lines.append([])
            used = 0
        lines[-1].append(entry)
        used += wide
    return lines


def draw_legend(sheet: ByteArray, lines: list[list[LegendEntry]], left: int, top: int) -> None:
    """Draw what ``legend_lines`` laid out; each line is LINE_PX high."""
    for place, line in enumerate(lines):
        x, y = left, top + place * LINE_PX
        for entry in line:
            entry.symbol(sheet[y : y + LINE_PX, x : x + _SYMBOL_PX])
            x += _SYMBOL_PX + 4
            write(sheet, entry.words, x, y + LINE_PX // 2)
            x += width_of(entry.words) + _GAP_PX


def swatch(color: Color) -> Callable[[ByteArray], None]:
    """A legend's symbol: a small square of a colour."""

    def draw(part: ByteArray) -> None:
        cv2.rectangle(part, (5, 3), (16, 14), color, -1)
        cv2.rectangle(part, (5, 3), (16, 14), FAINT, 1)

    return draw


def stroke(color: Color, thickness_px: int = 2) -> Callable[[ByteArray], None]:
    """A legend's symbol: a line of a colour."""

    def draw(part: ByteArray) -> None:
        middle = LINE_PX // 2
        cv2.line(part, (2, middle), (17, middle), color, thickness_px, cv2.LINE_AA)

    return draw


def hatched(part: ByteArray) -> None:
    """A legend's symbol: no value."""
    part[3:15, 5:17] = hatch(12, 12)[: part[3:15, 5:17].shape[0], : part[3:15, 5:17].shape[1]]
    cv2.rectangle(part, (5, 3), (16, 14), FAINT, 1)
