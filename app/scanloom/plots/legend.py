"""Legends: symbols with their labels, in lines below the axes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2

from fusion_core.model.conventions import ByteArray
from scanloom.plots.canvas import LINE_PX
from scanloom.plots.color_scale import hatch
from scanloom.plots.palette import Color
from scanloom.plots.text import draw_text, text_width
from scanloom.plots.theme import LIGHT, Theme

SYMBOL_PX = 20
"""Width of a symbol, which is LINE_PX high."""

_GAP_PX = 12
_MIDDLE_Y = LINE_PX // 2
# As wide as a digit.
_FIGURE_SPACE = "\u2007"

Symbol = Callable[[ByteArray, Theme], None]
"""Draws into a (LINE_PX, SYMBOL_PX, 3) part of a picture of a theme."""


@dataclass(frozen=True, slots=True)
class LegendEntry:
    """A symbol, and the label beside it."""

    symbol: Symbol
    label: str


@dataclass(frozen=True, slots=True)
class Legend:
    """Entries in lines, none wider than it may be unless it has a single one."""

    lines: tuple[tuple[LegendEntry, ...], ...]

    @classmethod
    def of(cls, entries: Sequence[LegendEntry], width_px: int) -> "Legend":
        """Lay out the entries in order."""
        lines: list[list[LegendEntry]] = []
        used = width_px
        for entry in entries:
            entry_px = SYMBOL_PX + 4 + text_width(entry.label) + _GAP_PX
            if used + entry_px - _GAP_PX > width_px:
                lines.append([])
                used = 0
            lines[-1].append(entry)
            used += entry_px
        return cls(tuple(tuple(line) for line in lines))

    @property
    def height_px(self) -> int:
        """What it takes of the picture."""
        return len(self.lines) * LINE_PX

    def draw(self, rgb: ByteArray, left: int, top: int, theme: Theme = LIGHT) -> None:
        """Draw it with its upper left corner at this pixel."""
        for number, line in enumerate(self.lines):
            x, y = left, top + number * LINE_PX
            for entry in line:
                entry.symbol(rgb[y : y + LINE_PX, x : x + SYMBOL_PX], theme)
                x += SYMBOL_PX + 4
                draw_text(rgb, entry.label, (x, y + _MIDDLE_Y), color=theme.ink)
                x += text_width(entry.label) + _GAP_PX


def padded(label: str, length: int) -> str:
    """``label`` padded with spaces as wide as digits: a legend whose numbers change from frame to
    frame then keeps its lines."""
    return label.ljust(length, _FIGURE_SPACE)


def swatch(color: Color) -> Symbol:
    """A small square of a colour."""

    def draw(part: ByteArray, theme: Theme) -> None:
        cv2.rectangle(part, (5, 3), (16, 14), color, -1)
        cv2.rectangle(part, (5, 3), (16, 14), theme.grey, 1)

    return draw


def line_symbol(color: Color, thickness_px: int = 2) -> Symbol:
    """A line of a colour."""

    def draw(part: ByteArray, _theme: Theme) -> None:
        cv2.line(part, (2, _MIDDLE_Y), (17, _MIDDLE_Y), color, thickness_px, cv2.LINE_AA)

    return draw


def hatch_symbol(part: ByteArray, theme: Theme) -> None:
    """No value."""
    stripes = hatch(12, 12, theme)
    part[3:15, 5:17] = stripes[: part[3:15, 5:17].shape[0], : part[3:15, 5:17].shape[1]]
    cv2.rectangle(part, (5, 3), (16, 14), theme.grey, 1)
