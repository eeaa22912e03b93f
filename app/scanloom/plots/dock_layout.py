"""What the pictures of a dock share: a colour bar in one line above the axes, numbers close to the
axes, a legend below. Little is spent on them, so that the data get the width.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2

from fusion_core.model.conventions import ByteArray
from scanloom.plots.axes import Axes
from scanloom.plots.canvas import LINE_PX, Box, box_between
from scanloom.plots.color_scale import ColorScale, cells_of_pixels
from scanloom.plots.legend import SYMBOL_PX, Legend, LegendEntry, hatch_symbol
from scanloom.plots.text import draw_text, text_width
from scanloom.plots.ticks import number_label

_MARGIN_PX = 4
_GAP_PX = 6
# Numbers of three digits left of the axes.
_LEFT_PX = 32
_TICK_PX = 3
_X_LINE_PX = 16
_BAR_HEIGHT_PX = 9
_NUMBER_PX = 11
# A number with the space around it.
_X_STEP_PX, _Y_STEP_PX = 58, 44


@dataclass(frozen=True, slots=True, kw_only=True)
class DockLayout:
    """Where the parts are: the line of the colour bar, ``space`` for the axes, the legend."""

    width_px: int
    space: Box
    legend: Legend

    @classmethod
    def of(cls, entries: Sequence[LegendEntry], width_px: int, height_px: int) -> "DockLayout":
        """Raises ValueError where the picture is too small."""
        legend = Legend.of(entries, width_px - 2 * _MARGIN_PX)
        top = _MARGIN_PX + LINE_PX + _MARGIN_PX
        bottom = height_px - legend.height_px - _MARGIN_PX - _X_LINE_PX
        space = box_between(_LEFT_PX, top, width_px - _MARGIN_PX - 1, bottom)
        return cls(width_px=width_px, space=space, legend=legend)

    def height_px(self, box: Box) -> int:
        """Of the picture, with the axes in this box of the space."""
        return box.bottom + _X_LINE_PX + self.legend.height_px + _MARGIN_PX

    def draw_scale(
        self,
        rgb: ByteArray,
        scale: ColorScale,
        label: str,
        ends: tuple[str, str],
        *,
        none: str,
    ) -> None:
        """The colour bar in one line: what it shows, its ``ends`` in text, and the hatch with what
        it means."""
        y = _MARGIN_PX + LINE_PX // 2
        ink = scale.theme.ink
        draw_text(rgb, label, (_MARGIN_PX, y), color=ink)
        right = self.width_px - _MARGIN_PX - text_width(none)
        draw_text(rgb, none, (right, y), color=ink)
        right -= SYMBOL_PX
        hatch_symbol(rgb[_MARGIN_PX : _MARGIN_PX + LINE_PX, right : right + SYMBOL_PX], scale.theme)
        if scale.limits is None:
            return
        left = _MARGIN_PX + text_width(label) + 2 * _GAP_PX
        draw_text(rgb, ends[0], (left, y), color=ink)
        right -= 2 * _GAP_PX
        draw_text(rgb, ends[1], (right, y), align="right", color=ink)
        left += text_width(ends[0]) + _GAP_PX
        right -= text_width(ends[1]) + _GAP_PX
        bar = Box(left, y - _BAR_HEIGHT_PX // 2, max(right - left, 1), _BAR_HEIGHT_PX)
        bar.view(rgb)[:] = scale.colors[cells_of_pixels(256, bar.width)]
        bar.draw_frame(rgb, scale.theme)

    def draw_legend(self, axes: Axes) -> None:
        """Below the axes."""
        self.legend.draw(axes.rgb, _MARGIN_PX, axes.box.bottom + _X_LINE_PX, axes.theme)


def draw_close_axes(
    axes: Axes, x_name: str, y_name: str, *, y_ticks: Iterable[float] | None = None
) -> None:
    """A frame with few numbers close to it. The names of the axes take the place of the last number
    of x, and of that of y at the upper end. ``y_ticks``: the numbers of y, few whole ones if None.
    """
    axes.draw_frame()
    box, theme = axes.box, axes.theme
    right = box.right - text_width(x_name, size_px=_NUMBER_PX)
    y = box.bottom + _X_LINE_PX // 2 + 1
    _write(axes, x_name, (box.right, y))
    for value in _few(axes.x_ticks(whole=True), box.width // _X_STEP_PX):
        x = round(axes.to_pixel(value, 0.0)[0])
        cv2.line(axes.rgb, (x, box.bottom + 1), (x, box.bottom + _TICK_PX), theme.grey)
        end = x + text_width(number_label(value), size_px=_NUMBER_PX) // 2
        if end < right - _GAP_PX:
            _write(axes, number_label(value), (end, y))
    _write(axes, y_name, (box.left - _TICK_PX - 2, box.top + _NUMBER_PX // 2))
    if y_ticks is None:
        y_ticks = _few(axes.y_ticks(whole=True), box.height // _Y_STEP_PX)
    for value in y_ticks:
        y = round(axes.to_pixel(0.0, value)[1])
        cv2.line(axes.rgb, (box.left - 2, y), (box.left - 1 - _TICK_PX, y), theme.grey)
        if y > box.top + 1.5 * _NUMBER_PX:
            _write(axes, number_label(value), (box.left - _TICK_PX - 2, y))


def _write(axes: Axes, text: str, end_px: tuple[float, float]) -> None:
    """Text that ends at a place."""
    draw_text(axes.rgb, text, end_px, align="right", size_px=_NUMBER_PX, color=axes.theme.ink)


def _few(ticks: Iterable[float], most: int) -> list[float]:
    """Every k-th of rising ticks, at most so many."""
    every = list(ticks)
    step = max(1, -(-len(every) // max(most, 2)))
    return every[::step]
