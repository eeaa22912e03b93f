"""The noise of each frame along the recording's time, as a low, wide picture that is clicked."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray
from scanloom.plots.canvas import Box, box_between
from scanloom.plots.frame_times import FrameTimes
from scanloom.plots.palette import Color, class_color
from scanloom.plots.text import Align, draw_text, text_width
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import time_ticks
from scanloom.state.frame_survey import FrameCounts, FrameStatus

_LEFT_PX, _RIGHT_PX = 42, 10
_ABOVE_PX, _BELOW_PX = 17, 17
_TICK_PX = 3
_TICK_ROOM_PX = 64
_SIZE_PX = 11
# Top of the scale: the least of these that holds all.
_SCALES = (0.1, 0.25, 0.5, 1.0)
# What the bars are stacked of, from below: the worst lies on the axis, where heights compare best.
_STACK = (NoiseClass.CONFLICT, NoiseClass.BURR, NoiseClass.HOLE)
_UNTRUSTED_PX = 4
_SWATCH_PX, _LEGEND_GAP_PX = 10, 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimeStrip:
    """``rgb``: (H, W, 3) uint8; ``box``: its part with the frames; ``times``: theirs."""

    rgb: ByteArray
    box: Box
    times: FrameTimes

    def frame_at(self, x_px: float, y_px: float) -> int | None:
        """The frame nearest to a point of the picture, None outside the strip."""
        if not self.box.contains(x_px, y_px):
            return None
        return self.times.frame_at(self.time_at(x_px))

    def time_at(self, x_px: float) -> float:
        """Seconds after the first frame at a column, also beyond the strip."""
        first_s, last_s = self.times.limits_s
        return first_s + (x_px - self.box.left + 0.5) / self.box.width * (last_s - first_s)

    def place_of(self, frame_index: int) -> tuple[float, float] | None:
        """The middle of a frame's part of the picture, None for a frame that does not exist."""
        if not 0 <= frame_index < self.times.times_s.size:
            return None
        x_px = _to_px(self.box, self.times, self.times.middle_s[frame_index])
        return float(x_px), self.box.top + 0.5 * self.box.height - 0.5


def time_strip(
    times: FrameTimes,
    counts: FrameCounts | None,
    *,
    width_px: int,
    height_px: int,
    theme: Theme = LIGHT,
    has_pairs: bool = True,
) -> TimeStrip:
    """Draw the frames' shares of noise, or their times only while there are no counts.

    ``has_pairs``: False for frames of one sensor alone, which have no noise to be counted, and
    where noise is not to be told: then times and gaps are all there is. Raises ValueError where the
    picture is too small.
    """
    rgb = np.empty((height_px, width_px, 3), dtype=np.uint8)
    rgb[:] = theme.background
    box = box_between(_LEFT_PX, _ABOVE_PX, width_px - _RIGHT_PX, height_px - _BELOW_PX)
    columns = _Columns.of(box, times, counts)
    if not has_pairs:
        columns = replace(columns, is_unknown=np.zeros_like(columns.is_unknown))
    scale = _draw_columns(box.view(rgb), columns, theme)
    cv2.rectangle(
        rgb, (box.left - 1, box.top - 1), (box.right, box.bottom), theme.grey, 1, cv2.LINE_4
    )
    _draw_axes(rgb, box, times, scale if has_pairs else None, theme)
    _draw_legend(rgb, box, columns, theme, has_pairs=has_pairs)
    return TimeStrip(rgb=rgb, box=box, times=times)


def _to_px(box: Box, times: FrameTimes, time_s: FloatArray | float) -> FloatArray:
    first_s, last_s = times.limits_s
    fraction = (np.asarray(time_s, dtype=np.float64) - first_s) / (last_s - first_s)
    return box.left - 0.5 + fraction * box.width


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Columns:
    """What each of the W columns of pixels shows.

    ``share``: (W, 4) of the pairs by class, NaN where none was counted. ``is_gap``: no images, or
    none with a scan; ``is_unknown``: not counted yet; ``is_unmatched``; ``is_untrusted``: also of
    columns with a share.
    """

    share: FloatArray
    is_gap: BoolArray
    is_unknown: BoolArray
    is_unmatched: BoolArray
    is_untrusted: BoolArray

    @classmethod
    def of(cls, box: Box, times: FrameTimes, counts: FrameCounts | None) -> "_Columns":
        """The frames whose middles lie in a column, else the one whose cell reaches over it."""
        first, last = _frames_of_columns(box, times)
        if counts is None:
            status = np.full(times.times_s.size, FrameStatus.UNKNOWN)
            pairs = np.zeros((times.times_s.size, len(NoiseClass)))
        else:
            status, pairs = counts.status, np.nan_to_num(counts.counts.astype(np.float64))

        def summed(values: FloatArray | IntArray | BoolArray) -> FloatArray:
            ends = np.zeros((values.shape[0] + 1, *values.shape[1:]))
            np.cumsum(values, axis=0, out=ends[1:])
            return ends[last] - ends[first]

        by_class = summed(pairs)
        whole = by_class.sum(axis=1, keepdims=True)
        share = np.divide(by_class, whole, out=np.full(by_class.shape, np.nan), where=whole > 0.0)
        is_counted = whole[:, 0] > 0.0
        seen = summed((status == FrameStatus.COUNTED) | (status == FrameStatus.UNTRUSTED)) > 0
        unmatched = (status == FrameStatus.UNMATCHED) | (status == FrameStatus.UNREADABLE)
        without = summed(status == FrameStatus.NO_SCAN) > 0
        left_out = summed(status == FrameStatus.UNKNOWN) > 0
        is_unmatched = ~is_counted & (seen | (summed(unmatched) > 0))
        is_gap = ~is_counted & ~is_unmatched & (without | (first == last))
        return cls(
            share=share,
            is_gap=is_gap,
            is_unmatched=is_unmatched,
            is_unknown=~is_counted & ~is_unmatched & ~is_gap & left_out,
            is_untrusted=is_unmatched | (summed(status == FrameStatus.UNTRUSTED) > 0),
        )


def _frames_of_columns(box: Box, times: FrameTimes) -> tuple[IntArray, IntArray]:
    """(W,) the first frame of each column, and the one after its last; equal in a gap."""
    edges_px = box.left - 0.5 + np.arange(box.width + 1)
    inside = np.searchsorted(_to_px(box, times, times.middle_s), edges_px)
    first, last = inside[:-1].copy(), inside[1:].copy()
    middle_px = edges_px[:-1] + 0.5
    left_px, right_px = _to_px(box, times, times.left_s), _to_px(box, times, times.right_s)
    over = np.clip(np.searchsorted(left_px, middle_px, side="right") - 1, 0, None)
    is_over = (first == last) & (middle_px <= right_px[over])
    first[is_over], last[is_over] = over[is_over], over[is_over] + 1
    return first, last


def _draw_columns(part: ByteArray, columns: _Columns, theme: Theme) -> float:
    """Fill the strip; return the share at its top."""
    height = part.shape[0]
    noise = columns.share[:, list(_STACK)]
    is_counted = np.isfinite(noise[:, 0])
    tops = np.cumsum(np.nan_to_num(noise), axis=1)
    highest = float(tops[:, -1].max(initial=0.0))
    scale = next((scale for scale in _SCALES if highest <= scale + 1e-9), _SCALES[-1])
    y, x = np.mgrid[: part.shape[0], : part.shape[1]]
    for chosen, pattern, color in (
        (columns.is_unknown, (x % 4 == 0) & (y % 4 == 0) | (x % 4 == 2) & (y % 4 == 2), theme.grey),
        (columns.is_gap, (x + y) % 6 < 2, theme.hatch[1]),
        (columns.is_unmatched, ((x + y) % 6 == 0) | ((x - y) % 6 == 0), theme.grey),
    ):
        ground = theme.hatch[0] if chosen is columns.is_gap else theme.background
        part[:, chosen] = ground
        part[pattern & chosen] = color
    # Upwards, so that no noise is too little to be seen.
    rows_px = np.ceil(tops / scale * height - 1e-9).astype(np.int64)
    from_below = height - 1 - y
    for place in range(len(_STACK) - 1, -1, -1):
        part[(from_below < rows_px[:, place]) & is_counted] = class_color(_STACK[place])
    untrusted = part[: _UNTRUSTED_PX + 1]
    untrusted[:, columns.is_untrusted] = theme.background
    untrusted[:_UNTRUSTED_PX, columns.is_untrusted] = theme.ink
    return scale


def _draw_axes(
    rgb: ByteArray, box: Box, times: FrameTimes, scale: float | None, theme: Theme
) -> None:
    first_s, last_s = times.limits_s
    for value_s, label in time_ticks(first_s, last_s, max(2, box.width // _TICK_ROOM_PX)):
        x = round(float(_to_px(box, times, value_s)))
        cv2.line(rgb, (x, box.bottom + 1), (x, box.bottom + _TICK_PX), theme.grey)
        half = 0.5 * text_width(label, size_px=_SIZE_PX)
        middle = min(max(x, half + 1.0), rgb.shape[1] - half - 1.0)
        _write(rgb, label, (middle, box.bottom + 10), theme, align="middle")
    if scale is None:
        return
    for value, y in ((scale, box.top + 3), (0.0, box.bottom - 4)):
        text = f"{value:.0%}".replace("%", " %") if value else "0"
        _write(rgb, text, (box.left - 4, y), theme, align="right")


def _draw_legend(
    rgb: ByteArray, box: Box, columns: _Columns, theme: Theme, *, has_pairs: bool
) -> None:
    """The classes, and those marks that occur, as many as there is room for."""
    entries: list[tuple[str, Color | None, str]] = [
        (name, class_color(noise), "")
        for name, noise in (
            ("hole", NoiseClass.HOLE),
            ("burr", NoiseClass.BURR),
            ("conflict", NoiseClass.CONFLICT),
        )
        if has_pairs
    ]
    for label, pattern, chosen in (
        ("not counted yet", "unknown", columns.is_unknown),
        ("no image or no scan" if has_pairs else "nothing recorded", "gap", columns.is_gap),
        ("not matched", "unmatched", columns.is_unmatched),
        ("offset not trusted", "untrusted", columns.is_untrusted & ~columns.is_unmatched),
    ):
        if chosen.any():
            entries.append((label, None, pattern))
    x, y = box.left, 8
    title = "pairs of beam and pixel:" if has_pairs else "time of the recording"
    if box.width > 420:
        _write(rgb, title, (x, y), theme)
        x += text_width(title, size_px=_SIZE_PX) + 8
    for label, color, pattern in entries:
        width = _SWATCH_PX + 4 + text_width(label, size_px=_SIZE_PX)
        if x + width > box.right:
            break
        swatch = rgb[y - 5 : y - 5 + _SWATCH_PX, x : x + _SWATCH_PX]
        if color is not None:
            swatch[:] = color
        else:
            _draw_columns(swatch, _one_kind(pattern), theme)
            cv2.rectangle(rgb, (x, y - 5), (x + _SWATCH_PX - 1, y + 4), theme.grey, 1, cv2.LINE_4)
        _write(rgb, label, (x + _SWATCH_PX + 4, y), theme)
        x += width + _LEGEND_GAP_PX


def _one_kind(kind: str) -> _Columns:
    """Columns of a legend's swatch."""

    def are(name: str) -> BoolArray:
        return np.full(_SWATCH_PX, kind == name)

    return _Columns(
        share=np.full((_SWATCH_PX, len(NoiseClass)), np.nan),
        is_gap=are("gap"),
        is_unknown=are("unknown"),
        is_unmatched=are("unmatched"),
        is_untrusted=are("untrusted"),
    )


def _write(
    rgb: ByteArray,
    text: str,
    place_px: tuple[float, float],
    theme: Theme,
    *,
    align: Align = "left",
) -> None:
    draw_text(rgb, text, place_px, align=align, size_px=_SIZE_PX, color=theme.ink)
