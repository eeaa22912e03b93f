"""Pairs of LiDAR and depth points in the plane, before and after A (Xu 2024, Fig. 5)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import shortened, write
from scanloom.plots.palette import Color, color_of
from scanloom.plots.sheet import LINE_PX, MARGIN_PX, Box, LegendEntry

_LEFT_PX = 50
_BELOW_PX = 40
_DARK: Color = (0, 0, 0)
_LIGHT: Color = (255, 255, 255)
_JOIN: Color = (134, 142, 150)
_GRID: Color = (241, 243, 245)
# Points are placed to a sixteenth of a pixel.
_FRACTION_BITS = 4
_RADIUS_PX = 2.0
_ALONE_PX = 1.0
_CROSS_PX = 3.0
_RING_PX = 5.5
# The plot ends where single points stray: so far beyond the middle 96 % of the points.
_MIDDLE = (0.02, 0.98)
_BEYOND_SHARE = 0.3
_LEAST_SPAN_M = 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairsPlot:
    """(m, 2) points of both sensors, x to the right and z ahead in metres, NaN where missing.

    ``agree``: (m,) the inliers, None before any A is known. ``drawn``: indices of the pairs to
    point at.
    """

    title: str
    lidar_m: FloatArray
    depth_m: FloatArray
    agree: BoolArray | None = None
    drawn: IntArray | None = None

    @property
    def paired(self) -> BoolArray:
        """(m,): both points are there."""
        return _given(self.lidar_m) & _given(self.depth_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class PairsPicture:
    """``rgb``: (H, W, 3) uint8. ``boxes``: of each plot; all have one scale, ``px_per_m``, and
    ``middle_m``, the point (x, z) in the middle of each box."""

    rgb: ByteArray
    boxes: tuple[Box, ...]
    middle_m: tuple[float, float]
    px_per_m: float

    def place_of(self, x_m: float, z_m: float, *, plot: int = 0) -> tuple[float, float]:
        """Where a point lies in the picture; pixel centres are integers."""
        box = self.boxes[plot]
        x = box.left + 0.5 * box.width - 0.5 + (x_m - self.middle_m[0]) * self.px_per_m
        y = box.top + 0.5 * box.height - 0.5 - (z_m - self.middle_m[1]) * self.px_per_m
        return x, y


def pairs_picture(
    plots: Sequence[PairsPlot],
    *,
    width_px: int,
    height_px: int,
    axis_names: tuple[str, str] = ("x to the right (m)", "z ahead (m)"),
) -> PairsPicture:
    """Draw plots one above the other, on one scale around the points of the first.

    Inliers are dots joined by a line, other pairs crosses, points without a partner small dots.
    Raises ValueError for no plot or too small a picture.
    """
    if not plots:
        raise ValueError("need a plot")
    legend = paper.legend_lines(_legend(plots[0]), width_px - 2 * MARGIN_PX)
    boxes = _boxes(len(plots), width_px, height_px, len(legend))
    middle_m, px_per_m = _scale(plots[0], boxes[0])
    picture = PairsPicture(
        rgb=paper.blank_sheet(width_px, height_px),
        boxes=boxes,
        middle_m=middle_m,
        px_per_m=px_per_m,
    )
    for place, plot in enumerate(plots):
        _draw_axes(picture, place, axis_names)
        _draw_title(picture, place, plot)
        _draw_pairs(picture, place, plot)
    paper.draw_legend(picture.rgb, legend, MARGIN_PX, boxes[-1].bottom + _BELOW_PX)
    return picture


def _boxes(count: int, width_px: int, height_px: int, legend_lines: int) -> tuple[Box, ...]:
    for_legend = legend_lines * LINE_PX + MARGIN_PX // 2
    each = (height_px - for_legend) // count
    return tuple(
        paper.room(
            _LEFT_PX,
            i * each + MARGIN_PX + LINE_PX + 2,
            width_px - MARGIN_PX,
            (i + 1) * each - _BELOW_PX,
        )
        for i in range(count)
    )


def _scale(plot: PairsPlot, box: Box) -> tuple[tuple[float, float], float]:
    """The point in the middle and the pixels of a metre, alike along both axes."""
    points_m = np.concatenate([plot.lidar_m, plot.depth_m])
    points_m = points_m[_given(points_m)]
    if not points_m.size:
        return (0.0, 0.0), box.height / 2.0
    inner_low, inner_high = np.quantile(points_m, _MIDDLE, axis=0)
    reach = _BEYOND_SHARE * (inner_high - inner_low) + _LEAST_SPAN_M
    low = np.maximum(points_m.min(axis=0), inner_low - reach)
    high = np.minimum(points_m.max(axis=0), inner_high + reach)
    span_x, span_z = np.maximum(high - low, _LEAST_SPAN_M)
    room_px = np.array([box.width, box.height]) - 4.0 * _RING_PX
    middle = 0.5 * (low + high)
    return (float(middle[0]), float(middle[1])), float(min(room_px / (span_x, span_z)))


def _draw_axes(picture: PairsPicture, place: int, names: tuple[str, str]) -> None:
    rgb, box = picture.rgb, picture.boxes[place]
    half_x = 0.5 * box.width / picture.px_per_m
    half_z = 0.5 * box.height / picture.px_per_m
    middle_x, middle_z = picture.middle_m
    inside = box.view(rgb)
    for x_m in paper.ticks_between(middle_x - half_x, middle_x + half_x, max(2, box.width // 52)):
        x = picture.place_of(x_m, 0.0, plot=place)[0]
        paper.tick_below(rgb, box, x, paper.number(x_m))
        cv2.line(inside, (round(x) - box.left, 0), (round(x) - box.left, box.height), _GRID)
    for z_m in paper.ticks_between(middle_z - half_z, middle_z + half_z, max(2, box.height // 34)):
        y = picture.place_of(0.0, z_m, plot=place)[1]
        paper.tick_left(rgb, box, y, paper.number(z_m))
        cv2.line(inside, (0, round(y) - box.top), (box.width, round(y) - box.top), _GRID)
    box.frame(rgb)
    write(rgb, names[0], box.left + 0.5 * box.width, box.bottom + 28, align="middle")
    write(rgb, names[1], 13, box.top + 0.5 * box.height, align="middle", turned=True)


def _draw_title(picture: PairsPicture, place: int, plot: PairsPlot) -> None:
    box = picture.boxes[place]
    words = shortened(plot.title, box.width, size_px=paper.TITLE_PX)
    write(picture.rgb, words, box.left, box.top - 13, size_px=paper.TITLE_PX)


def _draw_pairs(picture: PairsPicture, place: int, plot: PairsPlot) -> None:
    inside = picture.boxes[place].view(picture.rgb)
    lidar = _fixed(_in_box(picture, place, plot.lidar_m))
    depth = _fixed(_in_box(picture, place, plot.depth_m))
    paired = plot.paired
    agree = paired if plot.agree is None else paired & plot.agree
    joins = np.stack([lidar[agree], depth[agree]], axis=1)
    cv2.polylines(inside, list(joins), False, _JOIN, 1, cv2.LINE_AA, _FRACTION_BITS)
    for points, name in ((depth, "depth"), (lidar, "lidar")):
        color = color_of(name)
        own = plot.depth_m if name == "depth" else plot.lidar_m
        _dots(inside, points[_given(own) & ~paired], color, _ALONE_PX)
        _crosses(inside, points[paired & ~agree], color)
        _dots(inside, points[agree], color, _RADIUS_PX)
    if plot.drawn is not None:
        for index in plot.drawn[paired[plot.drawn]]:
            _point_at(inside, lidar[index], depth[index])


def _given(points_m: FloatArray) -> BoolArray:
    """(m,): points that are there."""
    given: BoolArray = np.logical_and.reduce(np.isfinite(points_m), axis=1)
    return given


def _in_box(picture: PairsPicture, place: int, points_m: FloatArray) -> FloatArray:
    """(m, 2) places in the box's part of the picture."""
    box = picture.boxes[place]
    x, y = picture.place_of(0.0, 0.0, plot=place)
    origin = np.array([x - box.left, y - box.top])
    in_box: FloatArray = origin + points_m * (picture.px_per_m, -picture.px_per_m)
    return in_box


def _fixed(places: FloatArray) -> IntArray:
    """Places as OpenCV's integers; what is missing or far off lies outside of every picture."""
    # Beyond this OpenCV's integers overflow.
    bounded = np.clip(np.nan_to_num(places, nan=-1e4, posinf=1e4, neginf=-1e4), -1e4, 1e4)
    rounded: IntArray = np.rint(bounded * 2**_FRACTION_BITS).astype(np.int32)
    return rounded


def _dots(part: ByteArray, places: IntArray, color: Color, radius_px: float) -> None:
    radius = round(radius_px * 2**_FRACTION_BITS)
    for place in places.tolist():
        cv2.circle(part, place, radius, color, -1, cv2.LINE_AA, _FRACTION_BITS)


def _crosses(part: ByteArray, places: IntArray, color: Color) -> None:
    reach = round(_CROSS_PX * 2**_FRACTION_BITS)
    for sign in (-1, 1):
        arm = np.array([reach, sign * reach])
        lines = np.stack([places - arm, places + arm], axis=1)
        cv2.polylines(
            part, list(lines.astype(np.int32)), False, color, 1, cv2.LINE_AA, _FRACTION_BITS
        )


def _point_at(part: ByteArray, lidar: IntArray, depth: IntArray) -> None:
    """Rings around a pair's points and a strong line between them."""
    radius = round(_RING_PX * 2**_FRACTION_BITS)
    for color, thickness in ((_LIGHT, 3), (_DARK, 1)):
        start, end = lidar.tolist(), depth.tolist()
        cv2.line(part, start, end, color, thickness, cv2.LINE_AA, _FRACTION_BITS)
        for place in (start, end):
            cv2.circle(part, place, radius, color, thickness, cv2.LINE_AA, _FRACTION_BITS)


def _legend(plot: PairsPlot) -> list[LegendEntry]:
    """What the signs mean, with their numbers."""
    paired = plot.paired

    def counted(words: str, count: int) -> str:
        return f"{words} {paper.steady(str(count), 3)}"

    entries = [
        LegendEntry(_dot_symbol(color_of("lidar")), "LiDAR"),
        LegendEntry(_dot_symbol(color_of("depth")), "depth"),
    ]
    if plot.agree is None:
        entries.append(LegendEntry(_join_symbol, counted("pair", int(paired.sum()))))
    else:
        agree = int((paired & plot.agree).sum())
        entries.append(LegendEntry(_join_symbol, counted("inlier", agree)))
        outliers = int(paired.sum()) - agree
        entries.append(LegendEntry(_cross_symbol, counted("outlier", outliers)))
    alone = int((_given(plot.lidar_m) ^ _given(plot.depth_m)).sum())
    entries.append(LegendEntry(_alone_symbol, counted("alone", alone)))
    if plot.drawn is not None:
        entries.append(LegendEntry(_ring_symbol, counted("drawn", plot.drawn.size)))
    return entries


def _middle(part: ByteArray) -> IntArray:
    return _fixed(np.array([[0.5 * part.shape[1], 0.5 * part.shape[0]]]))


def _dot_symbol(color: Color) -> Callable[[ByteArray], None]:
    return lambda part: _dots(part, _middle(part), color, 2.0 * _RADIUS_PX)


def _join_symbol(part: ByteArray) -> None:
    ends = _fixed(np.array([[4.0, 12.0], [16.0, 6.0]]))
    cv2.line(part, ends[0].tolist(), ends[1].tolist(), _JOIN, 1, cv2.LINE_AA, _FRACTION_BITS)
    _dots(part, ends[:1], color_of("lidar"), _RADIUS_PX)
    _dots(part, ends[1:], color_of("depth"), _RADIUS_PX)


def _cross_symbol(part: ByteArray) -> None:
    ends = _fixed(np.array([[6.0, 9.0], [14.0, 9.0]]))
    _crosses(part, ends[:1], color_of("lidar"))
    _crosses(part, ends[1:], color_of("depth"))


def _alone_symbol(part: ByteArray) -> None:
    places = _fixed(np.array([[6.0, 9.0], [14.0, 9.0]]))
    _dots(part, places[:1], color_of("lidar"), _ALONE_PX)
    _dots(part, places[1:], color_of("depth"), _ALONE_PX)


def _ring_symbol(part: ByteArray) -> None:
    _point_at(part, _middle(part)[0], _middle(part)[0])
