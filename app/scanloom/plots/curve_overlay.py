"""The LiDAR's points over a camera's image, coloured by range: solid where the camera sees the same
surface there, hollow where it sees another."""

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, IntArray
from fusion_core.workflows.fuse.curve_in_image import CurveInImage
from scanloom.plots.axes import FRACTION_BITS, image_axes
from scanloom.plots.canvas import BLACK, WHITE, Box, blank_canvas
from scanloom.plots.color_scale import ColorScale
from scanloom.plots.dock_layout import DockLayout, draw_close_axes
from scanloom.plots.legend import LegendEntry, Symbol
from scanloom.plots.palette import color_map
from scanloom.plots.text import draw_text
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import distinct_limits

# Of the picture's width; points of a dense scanner overlap to a line.
_RADIUS_FRACTION = 0.0052
_LEAST_RADIUS_PX = 2.0
_TITLE_ROOM_PX = 22


def curve_overlay_picture(
    depth_m: Float32Array,
    color: ByteArray | None,
    curve: CurveInImage | None,
    *,
    title: str,
    width_px: int,
    height_px: int,
    opacity: float,
    limits_m: tuple[float, float] | None,
    theme: Theme = LIGHT,
) -> ByteArray:
    """Draw points over an image and return the picture, (h, w, 3) uint8.

    ``depth_m``: (H, W) upright, in whose pixels the curve is; drawn in grey unless there is
    ``color``, (H', W', 3) of the same view. ``limits_m``: ranges of the first and the last
    colour. Raises ValueError for too small a picture.
    """
    shape = depth_m.shape[0], depth_m.shape[1]
    layout = DockLayout.of(_legend(), width_px, height_px - _TITLE_ROOM_PX)
    zoom = min(layout.space.width / shape[1], layout.space.height / shape[0])
    width, height = max(1, int(zoom * shape[1])), max(1, int(zoom * shape[0]))
    left = layout.space.left + (layout.space.width - width) // 2
    box = Box(left, layout.space.top + _TITLE_ROOM_PX, width, height)
    rgb = blank_canvas(width_px, layout.height_px(box), theme)
    axes = image_axes(rgb, box, shape, theme=theme)
    if color is not None:
        way = cv2.INTER_AREA if color.shape[1] > width else cv2.INTER_LINEAR
        axes.inside[:] = cv2.resize(color, (width, height), interpolation=way)
    else:
        _grey_scale(depth_m, theme).paint(axes.inside, depth_m)
    scale = ColorScale(colors=color_map("viridis"), limits=limits_m, theme=theme)
    if curve is not None and limits_m is not None:
        drawn = axes.inside.copy()
        _draw_points(drawn, axes.to_fixed(curve.pixels), curve, scale.colors, limits_m)
        axes.inside[:] = cv2.addWeighted(drawn, opacity, axes.inside, 1.0 - opacity, 0.0)
    draw_close_axes(axes, "column", "row")
    draw_text(rgb, title, (layout.space.left, layout.space.top + 10), color=theme.ink)
    ends = ("", "") if limits_m is None else (f"{limits_m[0]:.1f}", f"{limits_m[1]:.1f} m")
    layout.draw_scale(rgb, scale, "range", ends, none="no depth")
    layout.draw_legend(axes)
    return rgb


def range_limits_m(*curves: CurveInImage | None) -> tuple[float, float] | None:
    """One scale for the ranges of several curves, None where they have no point."""
    ranges_m = np.concatenate([np.empty(0), *(one.range_m for one in curves if one is not None)])
    if not ranges_m.size:
        return None
    return distinct_limits(float(ranges_m.min()), float(ranges_m.max()))


def _grey_scale(depth_m: Float32Array, theme: Theme) -> ColorScale:
    """Dark where near, as in the 3D scene; no black or white, which are the points' edges."""
    shades = np.linspace(70, 225, 256).round().astype(np.uint8)
    known = depth_m[np.isfinite(depth_m)]
    limits = None
    if known.size:
        low, high = np.percentile(known, [1.0, 99.0])
        limits = distinct_limits(float(low), float(high))
    return ColorScale(
        colors=np.repeat(shades[:, np.newaxis], 3, axis=1), limits=limits, theme=theme
    )


def _draw_points(
    part: ByteArray,
    places: IntArray,
    curve: CurveInImage,
    colors: ByteArray,
    limits_m: tuple[float, float],
) -> None:
    """Far points first: near ones hide them."""
    low, high = limits_m
    step = np.clip((curve.range_m - low) / (high - low), 0.0, 1.0)
    shades = colors[(255.0 * step).astype(np.uint8)]
    radius = max(_LEAST_RADIUS_PX, _RADIUS_FRACTION * part.shape[1])
    for index in np.argsort(-curve.range_m):
        color = tuple(map(int, shades[index]))
        _draw_point(part, places[index], color, radius, is_solid=bool(curve.agrees[index]))


def _draw_point(
    part: ByteArray, place: IntArray, color: tuple[int, ...], radius: float, *, is_solid: bool
) -> None:
    def circle(r: float, shade: tuple[int, ...], thickness: int) -> None:
        fixed = round(r * (1 << FRACTION_BITS))
        center = int(place[0]), int(place[1])
        cv2.circle(part, center, fixed, shade, thickness, cv2.LINE_AA, FRACTION_BITS)

    if is_solid:
        circle(radius + 1.0, BLACK, cv2.FILLED)
        circle(radius, color, cv2.FILLED)
    else:
        circle(radius, WHITE, 3)
        circle(radius, color, 1)


def _legend() -> list[LegendEntry]:
    middle = color_map("viridis")[128]
    color = tuple(map(int, middle))

    def symbol(*, is_solid: bool) -> Symbol:
        def draw(part: ByteArray, _theme: Theme) -> None:
            half = np.array([part.shape[1] // 2, part.shape[0] // 2]) << FRACTION_BITS
            _draw_point(part, half, color, 4.0, is_solid=is_solid)

        return draw

    return [
        LegendEntry(symbol(is_solid=True), "on the surface that the camera sees"),
        LegendEntry(symbol(is_solid=False), "before, behind, or no depth"),
    ]
