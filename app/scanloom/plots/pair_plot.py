"""Pairs of LiDAR and depth points in the plane, before and after A (Xu 2024, Fig. 5)."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray
from scanloom.plots.axes import (
    ABOVE_PX,
    BELOW_PX,
    FRACTION_BITS,
    LEFT_PX,
    Axes,
    draw_crosses,
    draw_dot,
    draw_ring,
    metric_axes,
)
from scanloom.plots.canvas import BLACK, MARGIN_PX, WHITE, blank_canvas, box_between
from scanloom.plots.legend import SYMBOL_PX, Legend, LegendEntry, Symbol, padded
from scanloom.plots.palette import Color, color_of
from scanloom.plots.theme import LIGHT, Theme

_DOT_PX, _UNPAIRED_PX, _CROSS_PX, _RING_PX = 2.0, 1.0, 3.0, 5.5
# The plot ends where single points stray: so far beyond the middle 96 % of the points.
_MIDDLE = (0.02, 0.98)
_BEYOND_FRACTION = 0.3
_LEAST_SPAN_M = 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairPlot:
    """(m, 2) points of both sensors, x to the right and z ahead in metres, NaN where missing.

    ``is_inlier``: (m,), None before any A is known. ``sample``: indices of the pairs that RANSAC
    drew, to be ringed.
    """

    title: str
    lidar_m: FloatArray
    depth_m: FloatArray
    is_inlier: BoolArray | None = None
    sample: IntArray | None = None

    @property
    def is_paired(self) -> BoolArray:
        """(m,): both points exist."""
        return _exists(self.lidar_m) & _exists(self.depth_m)

    @property
    def is_joined(self) -> BoolArray:
        """(m,): the inliers, or all pairs before any A is known."""
        return self.is_paired if self.is_inlier is None else self.is_paired & self.is_inlier


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairPicture:
    """``rgb``: (H, W, 3) uint8. ``axes``: of each plot; all have the same limits."""

    rgb: ByteArray
    axes: tuple[Axes, ...]


def pair_picture(
    plots: Sequence[PairPlot],
    *,
    width_px: int,
    height_px: int,
    axis_labels: tuple[str, str] = ("x to the right (m)", "z ahead (m)"),
    theme: Theme = LIGHT,
) -> PairPicture:
    """Draw plots one above the other, on one scale around the points of the first.

    Inliers are dots joined by a line, other pairs crosses, points without a partner small dots.
    Raises ValueError for no plot or too small a picture.
    """
    if not plots:
        raise ValueError("need a plot")
    legend = Legend.of(_legend(plots[0]), width_px - 2 * MARGIN_PX)
    each_px = (height_px - legend.height_px - MARGIN_PX // 2) // len(plots)
    right = width_px - MARGIN_PX
    boxes = [
        box_between(LEFT_PX, i * each_px + ABOVE_PX, right, (i + 1) * each_px - BELOW_PX)
        for i in range(len(plots))
    ]
    rgb = blank_canvas(width_px, height_px, theme)
    middle_m, span_m = _window(plots[0])
    # Marks at the edge of the window stay whole.
    room_px = np.array([boxes[0].width, boxes[0].height]) - 4.0 * _RING_PX
    px_per_m = float((room_px / span_m).min())
    every = tuple(metric_axes(rgb, box, middle_m, px_per_m, theme=theme) for box in boxes)
    for axes, plot in zip(every, plots, strict=True):
        x_ticks, z_ticks = axes.x_ticks(), axes.y_ticks()
        axes.draw_grid(x_ticks, z_ticks)
        axes.draw_frame()
        axes.draw_x_axis(axis_labels[0], x_ticks)
        axes.draw_y_axis(axis_labels[1], z_ticks)
        axes.draw_title(plot.title)
        _draw_pairs(axes, plot)
    legend.draw(rgb, MARGIN_PX, boxes[-1].bottom + BELOW_PX, theme)
    return PairPicture(rgb=rgb, axes=every)


def _window(plot: PairPlot) -> tuple[FloatArray, FloatArray]:
    """(2,) the middle and (2,) the least lengths of x and z that are shown, in metres."""
    points_m = np.concatenate([plot.lidar_m, plot.depth_m])
    points_m = points_m[_exists(points_m)]
    if not points_m.size:
        return np.zeros(2), np.full(2, 2.0)
    inner_low, inner_high = np.quantile(points_m, _MIDDLE, axis=0)
    beyond = _BEYOND_FRACTION * (inner_high - inner_low) + _LEAST_SPAN_M
    low = np.maximum(points_m.min(axis=0), inner_low - beyond)
    high = np.minimum(points_m.max(axis=0), inner_high + beyond)
    return 0.5 * (low + high), np.maximum(high - low, _LEAST_SPAN_M)


def _draw_pairs(axes: Axes, plot: PairPlot) -> None:
    paired, joined = plot.is_paired, plot.is_joined
    axes.draw_segments(plot.lidar_m[joined], plot.depth_m[joined], axes.theme.grey)
    for points_m, color in (
        (plot.depth_m, color_of("depth")),
        (plot.lidar_m, color_of("lidar")),
    ):
        axes.draw_dots(points_m[_exists(points_m) & ~paired], color, _UNPAIRED_PX)
        axes.draw_crosses(points_m[paired & ~joined], color, _CROSS_PX)
        axes.draw_dots(points_m[joined], color, _DOT_PX)
    if plot.sample is not None:
        sample = plot.sample[paired[plot.sample]]
        lidar, depth = (axes.to_fixed(points[sample]) for points in (plot.lidar_m, plot.depth_m))
        for start, end in zip(lidar.tolist(), depth.tolist(), strict=True):
            _draw_rings(axes.inside, start, end)


def _exists(points_m: FloatArray) -> BoolArray:
    """(m,): points that are finite."""
    exists: BoolArray = np.logical_and.reduce(np.isfinite(points_m), axis=1)
    return exists


def _draw_rings(part: ByteArray, start: list[int], end: list[int]) -> None:
    """Rings around a pair's points and a strong line between them."""
    for color, thickness in ((WHITE, 3), (BLACK, 1)):
        cv2.line(part, start, end, color, thickness, cv2.LINE_AA, FRACTION_BITS)
        for place in (start, end):
            draw_ring(part, place, color, _RING_PX, thickness)


def _legend(plot: PairPlot) -> list[LegendEntry]:
    """What the marks mean, with their numbers."""

    def counted(label: str, count: int) -> str:
        return f"{label} {padded(str(count), 3)}"

    pairs, joined = int(plot.is_paired.sum()), int(plot.is_joined.sum())
    entries = [
        LegendEntry(_dot_symbol(color_of("lidar")), "LiDAR"),
        LegendEntry(_dot_symbol(color_of("depth")), "depth"),
    ]
    if plot.is_inlier is None:
        entries.append(LegendEntry(_joined_symbol, counted("pair", pairs)))
    else:
        entries.append(LegendEntry(_joined_symbol, counted("inlier", joined)))
        entries.append(LegendEntry(_cross_symbol, counted("outlier", pairs - joined)))
    unpaired = int((_exists(plot.lidar_m) ^ _exists(plot.depth_m)).sum())
    entries.append(LegendEntry(_unpaired_symbol, counted("unpaired", unpaired)))
    if plot.sample is not None:
        entries.append(LegendEntry(_sample_symbol, counted("sample", plot.sample.size)))
    return entries


# Places in a symbol: in its middle, and one for each sensor.
_MIDDLE_PLACE = [SYMBOL_PX // 2 << FRACTION_BITS, 9 << FRACTION_BITS]
_TWO_PLACES = np.array([[6, 9], [14, 9]], dtype=np.int32) << FRACTION_BITS


def _dot_symbol(color: Color) -> Symbol:
    return lambda part, _theme: draw_dot(part, _MIDDLE_PLACE, color, 2.0 * _DOT_PX)


def _joined_symbol(part: ByteArray, theme: Theme) -> None:
    start, end = (
        [4 << FRACTION_BITS, 12 << FRACTION_BITS],
        [16 << FRACTION_BITS, 6 << FRACTION_BITS],
    )
    cv2.line(part, start, end, theme.grey, 1, cv2.LINE_AA, FRACTION_BITS)
    draw_dot(part, start, color_of("lidar"), _DOT_PX)
    draw_dot(part, end, color_of("depth"), _DOT_PX)


def _cross_symbol(part: ByteArray, _theme: Theme) -> None:
    draw_crosses(part, _TWO_PLACES[:1], color_of("lidar"), _CROSS_PX)
    draw_crosses(part, _TWO_PLACES[1:], color_of("depth"), _CROSS_PX)


def _unpaired_symbol(part: ByteArray, _theme: Theme) -> None:
    draw_dot(part, _TWO_PLACES[0].tolist(), color_of("lidar"), _UNPAIRED_PX)
    draw_dot(part, _TWO_PLACES[1].tolist(), color_of("depth"), _UNPAIRED_PX)


def _sample_symbol(part: ByteArray, _theme: Theme) -> None:
    _draw_rings(part, _MIDDLE_PLACE, _MIDDLE_PLACE)
