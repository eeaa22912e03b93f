"""Values over the time of a run: axes, numbers, one line for each."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray, read_only
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import width_of, write
from scanloom.plots.palette import Color
from scanloom.plots.sheet import FAINT, LINE_PX, MARGIN_PX, LegendEntry

_NAME_PX, _BELOW_PX = 26, 40
_GRID: Color = (241, 243, 245)
_DASH_PX = 6
_SHIFT = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """``times_s``, ``values``: (N,), times rising; NaN breaks the line."""

    words: str
    color: Color
    times_s: FloatArray
    values: FloatArray

    def __post_init__(self) -> None:
        read_only(self.times_s)
        read_only(self.values)


def time_picture(
    courses: Sequence[Course],
    *,
    words: str,
    limits: tuple[float, float],
    level: tuple[float, str] | None = None,
    width_px: int,
    height_px: int,
) -> ByteArray:
    """Draw courses between the ``limits`` of their values, ``words`` beside the axis.

    ``level``: a value to mark with a dashed line, and what it is. Returns (height_px, width_px, 3)
    uint8. Raises ValueError where there is no course, or too small a picture.
    """
    if not any(course.times_s.size for course in courses):
        raise ValueError("there is nothing to draw")
    sheet = paper.blank_sheet(width_px, height_px)
    entries = [LegendEntry(paper.stroke(course.color), course.words) for course in courses]
    if level is not None:
        entries.append(LegendEntry(_dashes, level[1]))
    legend = paper.legend_lines(entries, width_px - 2 * MARGIN_PX)
    bottom = height_px - _BELOW_PX - len(legend) * LINE_PX
    low, high = paper.wide_limits(*limits)
    levels = paper.ticks_between(low, high, max(2, (bottom - MARGIN_PX - 6) // 26))
    left = _NAME_PX + 10 + max(width_of(paper.number(value)) for value in levels)
    box = paper.room(left, MARGIN_PX + 6, width_px - MARGIN_PX - 10, bottom)
    times = np.concatenate([course.times_s for course in courses])
    first_s, last_s = paper.wide_limits(float(times.min()), float(times.max()))

    def place(time_s: FloatArray, value: FloatArray) -> FloatArray:
        x = (time_s - first_s) / (last_s - first_s) * (box.width - 1)
        y = (high - value) / (high - low) * (box.height - 1)
        return np.column_stack([x, np.clip(y, -1.0, box.height)])

    for time_s in paper.ticks_between(first_s, last_s, max(2, box.width // 60)):
        x = place(np.array([time_s]), np.array([low]))[0, 0]
        paper.tick_below(sheet, box, box.left + x, paper.number(time_s))
    for value in levels:
        y = round(place(np.array([first_s]), np.array([value]))[0, 1])
        paper.tick_left(sheet, box, box.top + y, paper.number(value))
        cv2.line(sheet, (box.left, box.top + y), (box.right - 1, box.top + y), _GRID, 1)
    part = box.view(sheet)
    if level is not None:
        y = round(place(np.array([first_s]), np.array([level[0]]))[0, 1])
        for x in range(0, box.width, 2 * _DASH_PX):
            cv2.line(part, (x, y), (min(x + _DASH_PX, box.width) - 1, y), FAINT, 1)
    for course in courses:
        known = np.isfinite(course.values)
        places = place(course.times_s[known], course.values[known])
        fixed = np.rint(places * (1 << _SHIFT)).astype(np.int32)
        # NaN in between are a gap.
        cuts = np.flatnonzero(np.diff(np.flatnonzero(known)) > 1) + 1
        for run in np.split(fixed, cuts):
            if len(run) == 1:
                cv2.circle(
                    part, run[0].tolist(), 2 << _SHIFT, course.color, -1, cv2.LINE_AA, _SHIFT
                )
            elif len(run):
                cv2.polylines(part, [run], False, course.color, 2, cv2.LINE_AA, _SHIFT)
    box.frame(sheet)
    write(sheet, "time (s)", box.left + 0.5 * box.width, box.bottom + 27, align="middle")
    write(sheet, words, 12, box.top + 0.5 * box.height, align="middle", turned=True)
    paper.draw_legend(sheet, legend, MARGIN_PX, bottom + _BELOW_PX - 4)
    return sheet


def _dashes(part: ByteArray) -> None:
    middle = LINE_PX // 2
    for x in (1, 13):
        cv2.line(part, (x, middle), (x + _DASH_PX - 1, middle), FAINT, 1)
