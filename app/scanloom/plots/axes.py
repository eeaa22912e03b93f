"""Axes: a box of a picture that shows a window of the plane, with ticks, labels and marks in it."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray, IntArray
from scanloom.plots.canvas import LINE_PX, TITLE_PX, Box
from scanloom.plots.palette import Color
from scanloom.plots.text import Align, draw_text, draw_vertical_text, shorten
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import number_label, ticks_between, whole_ticks_between

LEFT_PX = 54
"""Room for ticks and label to the left of a box."""
BELOW_PX = 40
"""Room for ticks and label above or below a box."""
ABOVE_PX = LINE_PX + 10
"""Room for a title above a box."""

_TICK_PX = 4
# A label of four digits with its gap.
_X_TICK_ROOM_PX, _Y_TICK_ROOM_PX = 52, 34
# OpenCV draws to a sixteenth of a pixel; far beyond the picture its integers would overflow.
FRACTION_BITS = 4
_FAR_PX = 1e4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Axes:
    """``box`` of the picture ``rgb`` shows the plane linearly.

    ``x_limits``: x at the left and the right edge of the box; ``y_limits``: y at the bottom and the
    top edge. Either axis may be reversed. Pixel centres are integers. ``theme``: of the picture.
    """

    rgb: ByteArray
    box: Box
    x_limits: tuple[float, float]
    y_limits: tuple[float, float]
    theme: Theme = LIGHT

    @property
    def px_per_unit(self) -> tuple[float, float]:
        """Columns for a unit of x, rows upwards for a unit of y; negative for a reversed axis."""
        (left, right), (bottom, top) = self.x_limits, self.y_limits
        return self.box.width / (right - left), self.box.height / (top - bottom)

    def to_pixel(self, x: float, y: float) -> tuple[float, float]:
        """The pixel of a point, which may lie outside the box."""
        zoom_x, zoom_y = self.px_per_unit
        return (
            self.box.left - 0.5 + (x - self.x_limits[0]) * zoom_x,
            self.box.bottom - 0.5 - (y - self.y_limits[0]) * zoom_y,
        )

    def to_data(self, x_px: float, y_px: float) -> tuple[float, float] | None:
        """The point at a pixel, None outside the box."""
        if not self.box.contains(x_px, y_px):
            return None
        zoom_x, zoom_y = self.px_per_unit
        return (
            self.x_limits[0] + (x_px - self.box.left + 0.5) / zoom_x,
            self.y_limits[0] + (self.box.bottom - 0.5 - y_px) / zoom_y,
        )

    # Around the box

    def draw_frame(self) -> None:
        """Draw a line around the box, outside of it."""
        self.box.draw_frame(self.rgb, self.theme)

    def draw_title(self, title: str) -> None:
        """Write above the box, cut to its width."""
        text = shorten(title, self.box.width, size_px=TITLE_PX)
        place_px = self.box.left, self.box.top - 13
        draw_text(self.rgb, text, place_px, size_px=TITLE_PX, color=self.theme.ink)

    def x_ticks(self, *, whole: bool = False) -> list[float]:
        """Round values of x, as many as fit."""
        count = max(2, self.box.width // _X_TICK_ROOM_PX)
        return _ticks(self.x_limits, count, whole=whole)

    def y_ticks(self, *, whole: bool = False) -> list[float]:
        """Round values of y, as many as fit."""
        count = max(2, self.box.height // _Y_TICK_ROOM_PX)
        return _ticks(self.y_limits, count, whole=whole)

    def draw_x_axis(self, label: str, ticks: Iterable[float]) -> None:
        """Ticks with their values below the box, and the axis' label below those."""
        for value in ticks:
            x = round(self.to_pixel(value, 0.0)[0])
            bottom = self.box.bottom
            cv2.line(self.rgb, (x, bottom + 1), (x, bottom + _TICK_PX), self.theme.grey)
            self._write(number_label(value), (x, bottom + _TICK_PX + 8))
        middle = self.box.left + 0.5 * self.box.width
        self._write(label, (middle, self.box.bottom + 28))

    def draw_y_axis(self, label: str, ticks: Iterable[float]) -> None:
        """Ticks with their values left of the box, and the axis' label left of those."""
        for value in ticks:
            y = round(self.to_pixel(0.0, value)[1])
            left = self.box.left
            cv2.line(self.rgb, (left - 2, y), (left - 1 - _TICK_PX, y), self.theme.grey)
            self._write(number_label(value), (left - _TICK_PX - 3, y), align="right")
        middle = self.box.top + 0.5 * self.box.height
        draw_vertical_text(self.rgb, label, (self.box.left - 41, middle), color=self.theme.ink)

    def _write(self, text: str, place_px: tuple[float, float], *, align: Align = "middle") -> None:
        draw_text(self.rgb, text, place_px, align=align, color=self.theme.ink)

    # Within the box

    @property
    def inside(self) -> ByteArray:
        """The box's part of the picture; what is drawn into it is clipped to the box."""
        return self.box.view(self.rgb)

    def draw_grid(self, x_values: Iterable[float], y_values: Iterable[float]) -> None:
        """A line through the box at each value."""
        for value in x_values:
            column = round(self.to_pixel(value, 0.0)[0]) - self.box.left
            self.inside[:, min(max(column, 0), self.box.width - 1)] = self.theme.grid
        for value in y_values:
            row = round(self.to_pixel(0.0, value)[1]) - self.box.top
            self.inside[min(max(row, 0), self.box.height - 1)] = self.theme.grid

    def to_fixed(self, points: FloatArray) -> IntArray:
        """(N, 2) places inside the box as OpenCV draws them, with FRACTION_BITS.

        ``points``: (N, >= 2); NaN and far points are mapped outside of every picture.
        """
        zoom_x, zoom_y = self.px_per_unit
        places = (points[:, :2] - (self.x_limits[0], self.y_limits[0])) * (zoom_x, -zoom_y)
        places += (-0.5, self.box.height - 0.5)
        # fmax replaces NaN.
        places = np.fmin(np.fmax(places, -_FAR_PX), _FAR_PX)
        fixed: IntArray = np.rint(places * (1 << FRACTION_BITS)).astype(np.int32)
        return fixed

    def draw_line(self, points: FloatArray, color: Color, thickness_px: int = 2) -> None:
        """A line through (N, >= 2) points, in order."""
        if len(points) > 1:
            fixed = [self.to_fixed(points)]
            cv2.polylines(
                self.inside, fixed, False, color, thickness_px, cv2.LINE_AA, FRACTION_BITS
            )

    def draw_segments(self, starts: FloatArray, ends: FloatArray, color: Color) -> None:
        """Thin lines, each from one of (N, >= 2) points to the other of its row."""
        segments = list(np.stack([self.to_fixed(starts), self.to_fixed(ends)], axis=1))
        cv2.polylines(self.inside, segments, False, color, 1, cv2.LINE_AA, FRACTION_BITS)

    def draw_dots(self, points: FloatArray, color: Color, radius_px: float) -> None:
        """Filled circles at (N, >= 2) points."""
        inside, radius = self.inside, round(radius_px * (1 << FRACTION_BITS))
        for place in self.to_fixed(points).tolist():
            cv2.circle(inside, place, radius, color, cv2.FILLED, cv2.LINE_AA, FRACTION_BITS)

    def draw_crosses(self, points: FloatArray, color: Color, arm_px: float) -> None:
        """Diagonal crosses at (N, >= 2) points."""
        draw_crosses(self.inside, self.to_fixed(points), color, arm_px)


def _ticks(limits: tuple[float, float], max_count: int, *, whole: bool) -> list[float]:
    between = whole_ticks_between if whole else ticks_between
    return between(min(limits), max(limits), max_count)


def draw_dot(part: ByteArray, place: list[int], color: Color, radius_px: float) -> None:
    """A filled circle; ``place``: x and y with FRACTION_BITS, as in legends."""
    radius = round(radius_px * (1 << FRACTION_BITS))
    cv2.circle(part, place, radius, color, cv2.FILLED, cv2.LINE_AA, FRACTION_BITS)


def draw_ring(
    part: ByteArray, place: list[int], color: Color, radius_px: float, thickness_px: int = 1
) -> None:
    """A circle; ``place``: x and y with FRACTION_BITS."""
    radius = round(radius_px * (1 << FRACTION_BITS))
    cv2.circle(part, place, radius, color, thickness_px, cv2.LINE_AA, FRACTION_BITS)


def draw_crosses(part: ByteArray, places: IntArray, color: Color, arm_px: float) -> None:
    """Diagonal crosses; ``places``: (N, 2) with FRACTION_BITS."""
    arm = round(arm_px * (1 << FRACTION_BITS))
    for sign in (-1, 1):
        diagonal = np.array([arm, sign * arm])
        lines = np.stack([places - diagonal, places + diagonal], axis=1).astype(np.int32)
        cv2.polylines(part, list(lines), False, color, 1, cv2.LINE_AA, FRACTION_BITS)


def image_axes(
    rgb: ByteArray,
    box: Box,
    shape: tuple[int, int],
    *,
    first_column: int = 0,
    theme: Theme = LIGHT,
) -> Axes:
    """Axes whose x is the column and y the row, downwards, of an image of ``shape`` in the box; its
    first column has the number ``first_column``."""
    rows, columns = shape
    left = first_column - 0.5
    return Axes(
        rgb=rgb,
        box=box,
        x_limits=(left, left + columns),
        y_limits=(rows - 0.5, -0.5),
        theme=theme,
    )


def metric_axes(
    rgb: ByteArray, box: Box, middle_m: FloatArray, px_per_m: float, *, theme: Theme = LIGHT
) -> Axes:
    """Axes of one scale in x and y around a point."""
    half_x, half_y = 0.5 * box.width / px_per_m, 0.5 * box.height / px_per_m
    x, y = float(middle_m[0]), float(middle_m[1])
    return Axes(
        rgb=rgb,
        box=box,
        x_limits=(x - half_x, x + half_x),
        y_limits=(y - half_y, y + half_y),
        theme=theme,
    )


def fit_axes(
    rgb: ByteArray, box: Box, low_m: FloatArray, high_m: FloatArray, *, theme: Theme = LIGHT
) -> Axes:
    """The largest metric axes that show all from ``low_m`` to ``high_m``, (2,) each."""
    px_per_m = float((np.array([box.width, box.height]) / (high_m - low_m)).min())
    return metric_axes(rgb, box, 0.5 * (low_m + high_m), px_per_m, theme=theme)
