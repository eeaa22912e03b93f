"""The similarity field S[v, u] as a picture on which an offset can be picked (Xu 2024, Fig. 4)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import shortened, width_of, write
from scanloom.plots.palette import Color, color_map
from scanloom.plots.score_field import AzimuthAxis, Mark, MarkKind, ScoreField
from scanloom.plots.sheet import LINE_PX, MARGIN_PX, Box, LegendEntry

_WORDS: dict[MarkKind, str] = {
    "peak": "peak",
    "runner_up": "runner-up",
    "prior": "recording's u",
    "picked": "picked by hand",
}
_LIGHT: Color = (255, 255, 255)
_DARK: Color = (0, 0, 0)
# Names of the axes and numbers above and below the box, and left of it.
_AXIS_PX = 36
_LEFT_PX = 54
_NO_SCORE = "no score: too few samples on both sides"


@dataclass(frozen=True, slots=True, kw_only=True)
class Heatmap:
    """``rgb``: (H, W, 3) uint8. ``box``: where the field lies in it; ``limits``: the scores of the
    first and the last colour, None without any score."""

    rgb: ByteArray
    box: Box
    u_first: int
    shape: tuple[int, int]
    limits: tuple[float, float] | None

    def offset_at(self, x_px: float, y_px: float) -> tuple[float, float] | None:
        """The offset (u, v) under a point of the picture, None outside the field.

        Pixel centres are integers. The half cells at the field's edges count as their centres.
        """
        if not self.box.holds(x_px, y_px):
            return None
        rows, columns = self.shape
        u = (x_px - self.box.left + 0.5) * columns / self.box.width - 0.5
        v = (y_px - self.box.top + 0.5) * rows / self.box.height - 0.5
        return self.u_first + float(np.clip(u, 0, columns - 1)), float(np.clip(v, 0, rows - 1))

    def pixel_of(self, u: float, v: float) -> tuple[float, float]:
        """Where an offset lies in the picture, also beyond the field; inverse of ``offset_at``."""
        rows, columns = self.shape
        x = self.box.left + (u - self.u_first + 0.5) * self.box.width / columns - 0.5
        y = self.box.top + (v + 0.5) * self.box.height / rows - 0.5
        return x, y


def heatmap(
    field: ScoreField,
    marks: Sequence[Mark],
    axis: AzimuthAxis,
    *,
    width_px: int,
    height_px: int,
    title: str = "",
    limits: tuple[float, float] | None = None,
) -> Heatmap:
    """Draw a field with its axes, its marks and what they mean.

    ``limits``: scores of the first and the last colour, for pictures that are compared; else the
    field's own least and greatest. Raises ValueError where the picture is too small.
    """
    scores = field.scores
    own = _limits_of(scores)
    shown = own if limits is None or own is None else paper.wide_limits(*limits)
    drawn = [mark for mark in marks if mark.exists]
    legend = paper.legend_lines(_legend(field, drawn), width_px - 2 * MARGIN_PX)
    top = MARGIN_PX + (LINE_PX if title else 0) + _AXIS_PX
    bottom = height_px - MARGIN_PX // 2 - len(legend) * LINE_PX - _AXIS_PX
    box = paper.room(_LEFT_PX, top, width_px - paper.COLOR_BAR_PX, bottom)
    rgb = paper.blank_sheet(width_px, height_px)
    shape = (scores.shape[0], scores.shape[1])
    result = Heatmap(rgb=rgb, box=box, u_first=field.u_first, shape=shape, limits=shown)
    if title:
        _write_title(rgb, title)
    paper.paint_values(box.view(rgb), scores, shown, color_map("viridis"))
    box.frame(rgb)
    _draw_axes(result, axis)
    if shown is None or own is None:
        write(
            rgb, _NO_SCORE, box.left + 0.5 * box.width, box.top + 0.5 * box.height, align="middle"
        )
    else:
        beyond = own[0] < shown[0], own[1] > shown[1]
        paper.color_bar(rgb, box, shown, color_map("viridis"), words="similarity", beyond=beyond)
    # The peak last: nothing may cover it.
    for mark in sorted(drawn, key=lambda mark: _DRAWN_IN_ORDER.index(mark.kind)):
        if _in_field(field, mark):
            _draw_mark(result, mark)
    paper.draw_legend(rgb, legend, MARGIN_PX, box.bottom + _AXIS_PX)
    return result


def _write_title(rgb: ByteArray, title: str) -> None:
    wide = rgb.shape[1] - 2 * MARGIN_PX
    write(
        rgb,
        shortened(title, wide, size_px=paper.TITLE_PX),
        MARGIN_PX,
        MARGIN_PX + LINE_PX // 2,
        size_px=paper.TITLE_PX,
    )


def _limits_of(scores: FloatArray) -> tuple[float, float] | None:
    low, high = float(np.fmin.reduce(scores, axis=None)), float(np.fmax.reduce(scores, axis=None))
    return paper.wide_limits(low, high) if np.isfinite(low) else None


def _draw_axes(result: Heatmap, axis: AzimuthAxis) -> None:
    rgb, box = result.rgb, result.box
    rows, columns = result.shape
    first, last = result.u_first, result.u_first + columns - 1
    for u in paper.whole_ticks_between(first, last, max(2, box.width // 44)):
        paper.tick_below(rgb, box, result.pixel_of(u, 0.0)[0], paper.number(u))
    for v in paper.whole_ticks_between(0, rows - 1, max(2, box.height // 34)):
        paper.tick_left(rgb, box, result.pixel_of(0.0, v)[1], paper.number(v))
    low, high = sorted((axis.azimuth_deg(first), axis.azimuth_deg(last)))
    for degrees in paper.ticks_between(low, high, max(2, box.width // 52)):
        x = result.pixel_of(axis.offset_of(degrees), 0.0)[0]
        paper.tick_above(rgb, box, x, f"{paper.number(degrees)}°")
    middle = box.left + 0.5 * box.width
    write(
        rgb,
        _fitting(box, "offset u along the LiDAR curve (samples)", "u (samples)"),
        middle,
        box.bottom + 28,
        align="middle",
    )
    write(
        rgb,
        _fitting(box, "azimuth in the LiDAR frame (°)", "azimuth (°)"),
        middle,
        box.top - 29,
        align="middle",
    )
    write(rgb, "depth row v", 11, box.top + 0.5 * box.height, align="middle", turned=True)


def _fitting(box: Box, words: str, short: str) -> str:
    """The longer words where there is room."""
    return words if width_of(words) <= box.width else short


_DRAWN_IN_ORDER: tuple[MarkKind, ...] = ("prior", "runner_up", "picked", "peak")


def _in_field(field: ScoreField, mark: Mark) -> bool:
    rows, columns = field.scores.shape
    in_rows = mark.v is None or -0.5 <= mark.v <= rows - 0.5
    return bool(in_rows and -0.5 <= mark.u - field.u_first <= columns - 0.5)


def _draw_mark(result: Heatmap, mark: Mark) -> None:
    x, y = result.pixel_of(mark.u, 0.0 if mark.v is None else mark.v)
    inside = result.box.view(result.rgb)
    place = round(x) - result.box.left, round(y) - result.box.top
    if mark.v is None:
        _dashed(inside, place[0])
    else:
        _SYMBOLS[mark.kind](inside, place)


def _dashed(part: ByteArray, x: int) -> None:
    """A vertical line of light dashes between dark ones: visible on every colour, and thin, so
    that it hides little of its column."""
    part[:, max(x, 0) : max(x + 1, 0)] = _DARK
    for y in range(1, part.shape[0], 8):
        part[y : y + 5, max(x, 0) : max(x + 1, 0)] = _LIGHT


def _twice(draw: Callable[[Color, int], object]) -> None:
    """Light on a broader dark line: visible on every colour."""
    draw(_DARK, 4)
    draw(_LIGHT, 2)


def _cross(part: ByteArray, at: tuple[int, int]) -> None:
    def draw(color: Color, thickness: int) -> None:
        for sign in (-1, 1):
            start, end = (at[0] - 5, at[1] - 5 * sign), (at[0] + 5, at[1] + 5 * sign)
            cv2.line(part, start, end, color, thickness, cv2.LINE_AA)

    _twice(draw)


def _circle(part: ByteArray, at: tuple[int, int]) -> None:
    _twice(lambda color, thickness: cv2.circle(part, at, 5, color, thickness, cv2.LINE_AA))


def _diamond(part: ByteArray, at: tuple[int, int]) -> None:
    corners = np.array(at) + np.array([(-7, 0), (0, -7), (7, 0), (0, 7)])

    def draw(color: Color, thickness: int) -> None:
        cv2.polylines(part, [corners.astype(np.int32)], True, color, thickness, cv2.LINE_AA)

    _twice(draw)


_SYMBOLS: dict[MarkKind, Callable[[ByteArray, tuple[int, int]], None]] = {
    "peak": _cross,
    "runner_up": _circle,
    "picked": _diamond,
    "prior": lambda part, at: _dashed(part, at[0]),
}


def _legend(field: ScoreField, marks: Sequence[Mark]) -> list[LegendEntry]:
    """An entry for each mark, with its place, and one for cells without a score."""
    entries = []
    for mark in marks:
        words = _WORDS[mark.kind]
        u = f"{mark.u:.1f}".replace("-", "−")
        if not _in_field(field, mark):
            words += ": not in the field"
        elif mark.v is None:
            words += " " + paper.steady(u, 5)
        else:
            words += " " + paper.steady(f"({u}, {mark.v:.0f})", 12)
        entries.append(LegendEntry(_symbol(mark.kind), words))
    return [*entries, LegendEntry(paper.hatched, "no score")]


def _symbol(kind: MarkKind) -> Callable[[ByteArray], None]:
    return lambda part: _SYMBOLS[kind](part, (part.shape[1] // 2, part.shape[0] // 2))
