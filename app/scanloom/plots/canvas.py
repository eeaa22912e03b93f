"""The canvas of a picture, and boxes of whole pixels on it.

The canvas is white with an edge of its own, so that it reads the same on light and dark pages.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray
from scanloom.plots.palette import Color

WHITE: Color = (255, 255, 255)
BLACK: Color = (0, 0, 0)
GREY: Color = (134, 142, 150)
"""Ticks, frames and guide lines."""
GRID: Color = (236, 239, 242)

MARGIN_PX = 8
LINE_PX = 18
"""Height of a line of text with its leading."""
TITLE_PX = 13

_EDGE: Color = (206, 212, 218)
# Narrower axes have no room for two ticks.
_SMALLEST_PX = 16


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

    def view(self, rgb: ByteArray) -> ByteArray:
        """The box's part of a picture; what is drawn into it is clipped to the box."""
        return rgb[self.top : self.bottom, self.left : self.right]

    def contains(self, x_px: float, y_px: float) -> bool:
        """Whether a point lies on one of the box's pixels, whose centres are integers."""
        return (
            self.left - 0.5 <= x_px < self.right - 0.5
            and self.top - 0.5 <= y_px < self.bottom - 0.5
        )

    def draw_frame(self, rgb: ByteArray) -> None:
        """Draw a line around the box, outside of it."""
        cv2.rectangle(
            rgb, (self.left - 1, self.top - 1), (self.right, self.bottom), GREY, 1, cv2.LINE_4
        )


def blank_canvas(width_px: int, height_px: int) -> ByteArray:
    """(height_px, width_px, 3) uint8, white with an edge."""
    rgb = np.full((height_px, width_px, 3), 255, dtype=np.uint8)
    cv2.rectangle(rgb, (0, 0), (width_px - 1, height_px - 1), _EDGE, 1)
    return rgb


def box_between(left: int, top: int, right: int, bottom: int) -> Box:
    """The box between these edges. Raises ValueError where the picture is too small for one."""
    if right - left < _SMALLEST_PX or bottom - top < _SMALLEST_PX:
        raise ValueError(f"the picture leaves {right - left} x {bottom - top} px to draw in")
    return Box(left, top, right - left, bottom - top)
