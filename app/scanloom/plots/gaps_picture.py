"""How far each depth image lies in time from its scan, over the time of the recording."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import INK, write
from scanloom.plots.palette import color_of
from scanloom.plots.sheet import FAINT, LINE_PX, MARGIN_PX, Box, LegendEntry

_LEFT_PX, _BELOW_PX = 58, 40
_DASH_PX, _CROSS_PX, _RING_PX = 5, 3, 5
# Beyond the farthest gap that is drawn.
_MARGIN_SHARE = 0.12
_LEAST_REACH_MS = 0.5
_LIGHT = (255, 255, 255)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GapsPicture:
    """``rgb``: (H, W, 3) uint8. ``box``: where the plot lies in it; ``time_s`` and ``reach_ms``:
    the times at its sides and the gap at its top, the negative of which is at its bottom."""

    rgb: ByteArray
    box: Box
    time_s: tuple[float, float]
    reach_ms: float

    def place_of(self, time_s: float, gap_ms: float) -> tuple[int, int]:
        """The pixel of a time and a gap; what lies beyond the plot is at its edge."""
        x, y = _places(self, np.array([time_s]), np.array([gap_ms]))
        return int(x[0]), int(y[0])

    def with_present(self, time_s: float, gap_ms: float | None) -> ByteArray:
        """A copy with one frame marked; ``gap_ms`` is None where it is not known."""
        rgb = self.rgb.copy()
        x, y = self.place_of(time_s, 0.0 if gap_ms is None else gap_ms)
        cv2.line(rgb, (x, self.box.top), (x, self.box.bottom - 1), INK, 1)
        if gap_ms is not None:
            _ring(rgb, (x, y))
        return rgb


def gaps_picture(
    time_s: FloatArray,
    gap_ms: FloatArray,
    paired: BoolArray,
    *,
    period_ms: float,
    max_gap_ms: float,
    width_px: int,
    height_px: int,
) -> GapsPicture:
    """Draw the n images of a recording, each array (n,), as dots, those without a scan near enough
    as crosses; one that lies beyond the plot is drawn at its edge.

    ``period_ms``: time between two scans, half of which a steady pair never exceeds; NaN where it
    is not known. ``max_gap_ms``: what is near enough. Raises ValueError for too small a picture.
    """
    rgb = paper.blank_sheet(width_px, height_px)
    legend = paper.legend_lines(
        _legend(paired, period_ms=period_ms, max_gap_ms=max_gap_ms), width_px - 2 * MARGIN_PX
    )
    bottom = height_px - _BELOW_PX - len(legend) * LINE_PX
    box = paper.room(_LEFT_PX, MARGIN_PX + 4, width_px - MARGIN_PX - 6, bottom)
    box.frame(rgb)
    ends_s = (float(time_s.min()), float(time_s.max())) if time_s.size else (0.0, 1.0)
    drawn = GapsPicture(
        rgb=rgb, box=box, time_s=paper.wide_limits(*ends_s), reach_ms=_reach_ms(gap_ms, paired)
    )
    _axes(drawn)
    if np.isfinite(period_ms):
        for gap in (-0.5 * period_ms, 0.5 * period_ms):
            _dashes(drawn, gap)
    x, y = _places(drawn, time_s, np.nan_to_num(gap_ms, nan=np.inf))
    _dots(rgb, x[paired], y[paired])
    for place in zip(x[~paired].tolist(), y[~paired].tolist(), strict=True):
        _cross(rgb, place)
    paper.draw_legend(rgb, legend, MARGIN_PX, bottom + _BELOW_PX - 4)
    return drawn


def _reach_ms(gap_ms: FloatArray, paired: BoolArray) -> float:
    """All pairs are inside; without any, all that there is."""
    known = np.abs(gap_ms[paired if paired.any() else np.isfinite(gap_ms)])
    farthest = float(known.max()) if known.size else 0.0
    return max((1.0 + _MARGIN_SHARE) * farthest, _LEAST_REACH_MS)


def _places(
    picture: GapsPicture, time_s: FloatArray, gap_ms: FloatArray
) -> tuple[IntArray, IntArray]:
    box, (first_s, last_s) = picture.box, picture.time_s
    x = box.left + (time_s - first_s) / (last_s - first_s) * (box.width - 1)
    inside_ms = np.clip(gap_ms, -picture.reach_ms, picture.reach_ms)
    y = box.top + (0.5 - 0.5 * inside_ms / picture.reach_ms) * (box.height - 1)
    return (
        np.rint(np.clip(x, box.left, box.right - 1)).astype(np.int64),
        np.rint(y).astype(np.int64),
    )


def _axes(picture: GapsPicture) -> None:
    rgb, box, reach_ms = picture.rgb, picture.box, picture.reach_ms
    for time_s in paper.ticks_between(*picture.time_s, max(2, box.width // 60)):
        paper.tick_below(rgb, box, picture.place_of(time_s, 0.0)[0], paper.number(time_s))
    for gap_ms in paper.ticks_between(-reach_ms, reach_ms, max(2, box.height // 30)):
        y = picture.place_of(picture.time_s[0], gap_ms)[1]
        paper.tick_left(rgb, box, y, paper.number(gap_ms))
        if gap_ms == 0.0:
            cv2.line(rgb, (box.left, y), (box.right - 1, y), FAINT, 1)
    middle = box.left + 0.5 * box.width
    write(rgb, "time since the first frame (s)", middle, box.bottom + 27, align="middle")
    write(rgb, "image − scan (ms)", 12, box.top + 0.5 * box.height, align="middle", turned=True)


def _dashes(picture: GapsPicture, gap_ms: float) -> None:
    if abs(gap_ms) > picture.reach_ms:
        return
    box, y = picture.box, picture.place_of(picture.time_s[0], gap_ms)[1]
    for left in range(box.left, box.right, 2 * _DASH_PX):
        right = min(left + _DASH_PX, box.right) - 1
        cv2.line(picture.rgb, (left, y), (right, y), FAINT, 1)


def _dots(rgb: ByteArray, x: IntArray, y: IntArray) -> None:
    """Squares of three pixels; there may be as many as a recording has images."""
    for right in (-1, 0, 1):
        for down in (-1, 0, 1):
            rgb[y + down, x + right] = color_of("depth")


def _cross(rgb: ByteArray, place: tuple[int, int]) -> None:
    x, y = place
    for sign in (-1, 1):
        start, end = (
            (x - _CROSS_PX, y - sign * _CROSS_PX),
            (x + _CROSS_PX, y + sign * _CROSS_PX),
        )
        cv2.line(rgb, start, end, INK, 1, cv2.LINE_AA)


def _ring(rgb: ByteArray, place: tuple[int, int]) -> None:
    cv2.circle(rgb, place, _RING_PX, _LIGHT, 3, cv2.LINE_AA)
    cv2.circle(rgb, place, _RING_PX, INK, 1, cv2.LINE_AA)


def _legend(paired: BoolArray, *, period_ms: float, max_gap_ms: float) -> list[LegendEntry]:
    middle = (10, LINE_PX // 2)

    def dot(part: ByteArray) -> None:
        _dots(part, np.array([middle[0]]), np.array([middle[1]]))

    entries = [LegendEntry(dot, "depth image")]
    if not paired.all():
        words = f"no scan within {max_gap_ms:g} ms: {int((~paired).sum())}"
        entries.append(LegendEntry(_on(_cross, middle), words))
    if np.isfinite(period_ms):
        entries.append(LegendEntry(_dash_symbol, f"half of {period_ms:.1f} ms between scans"))
    entries.append(LegendEntry(_on(_ring, middle), "this frame"))
    return entries


def _on(
    draw: Callable[[ByteArray, tuple[int, int]], None], place: tuple[int, int]
) -> Callable[[ByteArray], None]:
    return lambda part: draw(part, place)


def _dash_symbol(part: ByteArray) -> None:
    for left in (2, 12):
        cv2.line(part, (left, LINE_PX // 2), (left + _DASH_PX, LINE_PX // 2), FAINT, 1)
