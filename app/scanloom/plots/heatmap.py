"""The similarity field S[v, u] as a picture on which an offset can be picked (Xu 2024, Fig. 4)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from scanloom.plots.axes import Axes, image_axes
from scanloom.plots.canvas import (
    BLACK,
    WHITE,
    blank_canvas,
)
from scanloom.plots.color_scale import ColorScale
from scanloom.plots.dock_layout import DockLayout, draw_close_axes
from scanloom.plots.legend import LegendEntry, Symbol
from scanloom.plots.palette import Color, color_map
from scanloom.plots.score_field import Mark, MarkKind, ScoreField
from scanloom.plots.text import draw_text
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import distinct_limits

_LABELS: dict[MarkKind, str] = {
    "peak": "best fit",
    "runner_up": "second best",
    "prior": "expected from the recording",
    "picked": "picked by hand",
}
_NO_SCORE = "no score: too few samples on both sides"
# The peak on top: nothing may cover it.
_DRAWING_ORDER: tuple[MarkKind, ...] = ("prior", "runner_up", "picked", "peak")
# The colours follow the cube of the score's place between the limits: similarity is high over wide
# areas, and a linear scale spends its colours there. The peak then stands out, and the steps
# between the best scores can be seen.
_COLOR_POWER = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Heatmap:
    """``rgb``: (H, W, 3) uint8. ``axes``: u to the right, v downwards; ``limits``: the scores of
    the first and the last colour, None without any score."""

    rgb: ByteArray
    axes: Axes
    u_first: int
    shape: tuple[int, int]
    limits: tuple[float, float] | None

    def offset_at(self, x_px: float, y_px: float) -> tuple[float, float] | None:
        """The offset (u, v) under a point of the picture, None outside the field.

        The half cells at the field's edges count as their centres.
        """
        place = self.axes.to_data(x_px, y_px)
        if place is None:
            return None
        rows, columns = self.shape
        u = np.clip(place[0], self.u_first, self.u_first + columns - 1)
        return float(u), float(np.clip(place[1], 0, rows - 1))

    def place_of(self, u: float, v: float) -> tuple[float, float] | None:
        """x, y in the picture of an offset, None outside the field."""
        rows, columns = self.shape
        is_inside = -0.5 <= u - self.u_first <= columns - 0.5 and -0.5 <= v <= rows - 0.5
        return self.axes.to_pixel(u, v) if is_inside else None


def heatmap(
    field: ScoreField,
    marks: Sequence[Mark],
    *,
    width_px: int,
    height_px: int,
    theme: Theme = LIGHT,
) -> Heatmap:
    """Draw a field with its marks, and all kinds of marks in the legend, whether or not they exist;
    one picked by hand only where it does.

    Raises ValueError where the picture is too small.
    """
    marks = [mark for mark in marks if mark.exists]
    layout = DockLayout.of(_legend(marks), width_px, height_px)
    rgb = blank_canvas(width_px, height_px, theme)
    rows, columns = field.scores.shape
    axes = image_axes(rgb, layout.space, (rows, columns), first_column=field.u_first, theme=theme)
    scale = _scale_of(field, theme)
    scale.paint(axes.inside, field.scores)
    draw_close_axes(axes, "offset u", "row")
    if scale.limits is None:
        _explain_no_score(axes)
    _draw_marks(axes, field, marks)
    low, high = ("", "") if scale.limits is None else (f"{limit:.2f}" for limit in scale.limits)
    layout.draw_scale(
        rgb, scale, "similarity", (low.replace("-", "−"), high.replace("-", "−")), none="no score"
    )
    layout.draw_legend(axes)
    return Heatmap(
        rgb=rgb, axes=axes, u_first=field.u_first, shape=(rows, columns), limits=scale.limits
    )


def _scale_of(field: ScoreField, theme: Theme) -> ColorScale:
    return ColorScale(colors=_colors(), limits=_limits_of(field.scores), theme=theme)


@cache
def _colors() -> ByteArray:
    """(256, 3) uint8, from the least to the greatest score. Not writable."""
    place = np.linspace(0.0, 1.0, 256) ** _COLOR_POWER
    colors: ByteArray = color_map("viridis")[np.rint(255.0 * place).astype(np.intp)]
    colors.setflags(write=False)
    return colors


def _explain_no_score(axes: Axes) -> None:
    box = axes.box
    middle = box.left + 0.5 * box.width, box.top + 0.5 * box.height
    draw_text(axes.rgb, _NO_SCORE, middle, align="middle", color=axes.theme.ink)


def _draw_marks(axes: Axes, field: ScoreField, marks: Sequence[Mark]) -> None:
    for mark in sorted(marks, key=lambda mark: _DRAWING_ORDER.index(mark.kind)):
        if _is_in_field(field, mark):
            _draw_mark(axes, mark)


def _limits_of(scores: FloatArray) -> tuple[float, float] | None:
    low, high = float(np.fmin.reduce(scores, axis=None)), float(np.fmax.reduce(scores, axis=None))
    return distinct_limits(low, high) if np.isfinite(low) else None


def _is_in_field(field: ScoreField, mark: Mark) -> bool:
    rows, columns = field.scores.shape
    in_rows = mark.v is None or -0.5 <= mark.v <= rows - 0.5
    return bool(in_rows and -0.5 <= mark.u - field.u_first <= columns - 0.5)


def _draw_mark(axes: Axes, mark: Mark) -> None:
    x, y = axes.to_pixel(mark.u, 0.0 if mark.v is None else mark.v)
    place = round(x) - axes.box.left, round(y) - axes.box.top
    if mark.v is None:
        _draw_dashes(axes.inside, place)
    else:
        _MARKS[mark.kind](axes.inside, place)


def _draw_dashes(part: ByteArray, place: tuple[int, int]) -> None:
    """A vertical line of light dashes between dark ones: visible on every colour, and thin, so
    that it hides little of its column."""
    columns = slice(max(place[0], 0), max(place[0] + 1, 0))
    part[:, columns] = BLACK
    for y in range(1, part.shape[0], 8):
        part[y : y + 5, columns] = WHITE


def _draw_twice(draw: Callable[[Color, int], object]) -> None:
    """Light on a broader dark line: visible on every colour."""
    draw(BLACK, 4)
    draw(WHITE, 2)


def _draw_cross(part: ByteArray, place: tuple[int, int]) -> None:
    """A cross with an open middle, so that the peak itself is seen."""

    def draw(color: Color, thickness: int) -> None:
        for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            start, end = (
                (place[0] + 3 * x, place[1] + 3 * y),
                (place[0] + 7 * x, place[1] + 7 * y),
            )
            cv2.line(part, start, end, color, thickness, cv2.LINE_AA)

    _draw_twice(draw)


def _draw_circle(part: ByteArray, place: tuple[int, int]) -> None:
    _draw_twice(lambda color, thickness: cv2.circle(part, place, 5, color, thickness, cv2.LINE_AA))


def _draw_diamond(part: ByteArray, place: tuple[int, int]) -> None:
    corners = np.array(place) + np.array([(-7, 0), (0, -7), (7, 0), (0, 7)])

    def draw(color: Color, thickness: int) -> None:
        cv2.polylines(part, [corners.astype(np.int32)], True, color, thickness, cv2.LINE_AA)

    _draw_twice(draw)


_MARKS: dict[MarkKind, Callable[[ByteArray, tuple[int, int]], None]] = {
    "peak": _draw_cross,
    "runner_up": _draw_circle,
    "picked": _draw_diamond,
    "prior": _draw_dashes,
}


def _legend(marks: Sequence[Mark]) -> list[LegendEntry]:
    kinds: list[MarkKind] = ["peak", "runner_up", "prior"]
    kinds += ["picked"] if any(mark.kind == "picked" for mark in marks) else []
    return [LegendEntry(_symbol(kind), _LABELS[kind]) for kind in kinds]


def _symbol(kind: MarkKind) -> Symbol:
    return lambda part, _theme: _MARKS[kind](part, (part.shape[1] // 2, part.shape[0] // 2))
