"""Values as colours: images of them, hatched where there is none, and the colour bar."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, IntArray
from scanloom.plots.canvas import Box
from scanloom.plots.text import draw_text, draw_vertical_text
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import number_label, ticks_between

COLOR_BAR_PX = 76
"""Width that a colour bar takes with its numbers and its label."""

_BAR_PX, _TICK_PX, _TICK_ROOM_PX = 12, 4, 34
_HATCH_STEP_PX = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColorScale:
    """``colors``: (256, 3) uint8; ``limits``: the values of the first and the last of them, None
    where there is no value. ``theme``: of the picture."""

    colors: ByteArray
    limits: tuple[float, float] | None
    theme: Theme = LIGHT

    def paint(self, target: ByteArray, values: FloatArray | Float32Array) -> None:
        """Fill ``target``, (h, w, 3), with ``values``, (H, W); NaN is hatched."""
        height, width = target.shape[:2]
        if self.limits is None:
            target[:] = hatch(height, width, self.theme)
            return
        for axis, pixels in enumerate((height, width)):
            if pixels < values.shape[axis]:
                # Cells that no pixel shows need not be coloured.
                values = values.take(cells_of_pixels(values.shape[axis], pixels), axis=axis)
        rows = cells_of_pixels(values.shape[0], height)
        columns = cells_of_pixels(values.shape[1], width)
        low, high = self.limits
        missing = np.isnan(values)
        steps = np.clip((values - low) * (255.0 / (high - low)), 0.0, 255.0) + 0.5
        steps[missing] = 0.0
        # Stretched before it is coloured, and along one axis after the other: several times as
        # fast.
        shades = steps.astype(np.uint8).take(columns, axis=1).take(rows, axis=0)
        target[:] = cv2.applyColorMap(shades, self.colors.reshape(256, 1, 3))
        if missing.any():
            stretched = missing.take(columns, axis=1).take(rows, axis=0)
            cv2.copyTo(hatch(height, width, self.theme), stretched.view(np.uint8), target)

    def draw_bar(
        self, rgb: ByteArray, box: Box, label: str, *, beyond: tuple[bool, bool] = (False, False)
    ) -> None:
        """A colour bar beside ``box``, as high as it, the greatest value on top; none without
        values.

        ``beyond``: whether there are values below and above the limits; triangles then say so.
        """
        if self.limits is None:
            return
        (low, high), theme = self.limits, self.theme
        bar = Box(box.right + 9, box.top, _BAR_PX, box.height)
        steps = 255 - cells_of_pixels(256, bar.height)
        bar.view(rgb)[:] = self.colors[steps][:, np.newaxis]
        bar.draw_frame(rgb, self.theme)
        x = bar.right + _TICK_PX + 2
        for value in ticks_between(low, high, max(2, min(6, bar.height // _TICK_ROOM_PX))):
            y = round(bar.bottom - 0.5 - (value - low) / (high - low) * bar.height)
            cv2.line(rgb, (bar.right + 1, y), (bar.right + _TICK_PX - 1, y), theme.grey)
            draw_text(rgb, number_label(value), (x, y), color=theme.ink)
        middle = bar.left + 0.5 * bar.width
        for exists, y, sign in (
            (beyond[0], bar.bottom + 6, "▼"),
            (beyond[1], bar.top - 7, "▲"),
        ):
            if exists:
                draw_text(rgb, sign, (middle, y), align="middle", size_px=8, color=theme.grey)
        middle = box.top + 0.5 * box.height
        place_px = box.right + COLOR_BAR_PX - 11, middle
        draw_vertical_text(rgb, label, place_px, color=theme.ink)


def cells_of_pixels(cells: int, pixels: int) -> IntArray:
    """(pixels,) index of the cell that each pixel of a stretched axis shows."""
    return (2 * np.arange(pixels) + 1) * cells // (2 * pixels)


@lru_cache(maxsize=16)
def hatch(height_px: int, width_px: int, theme: Theme = LIGHT) -> ByteArray:
    """(height_px, width_px, 3) uint8: neutral stripes for "no value". Not writable."""
    stripe = np.add.outer(np.arange(height_px), np.arange(width_px)) % _HATCH_STEP_PX < 2
    stripes = np.array(theme.hatch, dtype=np.uint8)[stripe.astype(np.intp)]
    stripes.setflags(write=False)
    return stripes
