"""The canvas of a picture, with an edge of its own, and boxes of whole pixels on it."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray
from scanloom.plots.palette import Color
from scanloom.plots.theme import LIGHT, Theme

WHITE: Color = (255, 255, 255)
BLACK: Color = (0, 0, 0)

MARGIN_PX = 8
LINE_PX = 18
"""Height of a line of text with its leading."""
TITLE_PX = 13

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

    def draw_frame(self, rgb: ByteArray, theme: Theme = LIGHT) -> None:
        """Draw a line around the box, outside of it."""
        corners = (self.left - 1, self.top - 1), (self.right, self.bottom)
        cv2.rectangle(rgb, *corners, theme.grey, 1, cv2.LINE_4)


def blank_canvas(width_px: int, height_px: int, theme: Theme = LIGHT) -> ByteArray:
    """(height_px, width_px, 3) uint8: the theme's background with its edge."""
    rgb = np.empty((height_px, width_px, 3), dtype=np.uint8)
    corners = (0, 0), (width_px - 1, height_px - 1)
    cv2.rectangle(rgb, *corners, theme.background, cv2.FILLED)
    cv2.rectangle(rgb, *corners, theme.edge, 1)
    return rgb


def box_between(left: int, top: int, right: int, bottom: int) -> Box:
    """The box between these edges. Raises ValueError where the picture is too small for one."""
    if right - left < _SMALLEST_PX or bottom - top < _SMALLEST_PX:
        raise ValueError(f"the picture leaves {right - left} x {bottom - top} px to draw in")
    return Box(left, top, right - left, bottom - top)
