"""Upright depth images as pictures in which pixels can be picked, with the pairs marked."""

from collections.abc import Collection
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray, Float32Array, IntArray
from scanloom.plots.axes import ABOVE_PX, BELOW_PX, LEFT_PX, Axes, image_axes
from scanloom.plots.canvas import BLACK, MARGIN_PX, WHITE, Box, blank_canvas, box_between
from scanloom.plots.class_marks import class_symbol
from scanloom.plots.color_scale import COLOR_BAR_PX, ColorScale
from scanloom.plots.dock_layout import DockLayout, draw_close_axes
from scanloom.plots.label_overlay import draw_labels
from scanloom.plots.legend import Legend, LegendEntry, hatch_symbol, padded
from scanloom.plots.lidar_curve import curve_symbol, draw_lidar_curve
from scanloom.plots.pair_pixels import PairPixels
from scanloom.plots.palette import color_map
from scanloom.plots.theme import LIGHT, Theme
from scanloom.plots.ticks import distinct_limits
from scanloom.state.review_overlay import ReviewOverlay

# The scale ends beyond nearly all depths: a few stray pixels must not take its colours.
_BEYOND_FRACTION = 0.005


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthPicture:
    """``rgb``: (h, w, 3) uint8. ``axes``: columns to the right, rows downwards, of an image of
    ``shape``; ``limits_m``: depths of the first and the last colour, None without any depth."""

    rgb: ByteArray
    axes: Axes
    shape: tuple[int, int]
    limits_m: tuple[float, float] | None

    def pixel_at(self, x_px: float, y_px: float) -> tuple[int, int] | None:
        """Row and column of the depth pixel under a point, None outside of the image."""
        place = self.axes.to_data(x_px, y_px)
        if place is None:
            return None
        column, row = (int(value + 0.5) for value in place)
        return min(row, self.shape[0] - 1), min(column, self.shape[1] - 1)

    def place_of(self, row: int, column: int) -> tuple[float, float] | None:
        """x, y in the picture of a depth pixel's centre, None outside of the image."""
        if not (0 <= row < self.shape[0] and 0 <= column < self.shape[1]):
            return None
        return self.axes.to_pixel(column, row)


@dataclass(frozen=True, slots=True, kw_only=True)
class PairOverlay:
    """The pairs that are drawn: the pixels of ``classes``, and a ring around that of ``beam``, an
    index in the scan."""

    pixels: PairPixels
    classes: Collection[NoiseClass] = frozenset(NoiseClass)
    beam: int | None = None

    @property
    def visible(self) -> BoolArray:
        """(B,) of the pairs."""
        return self.pixels.shown(self.classes)

    @property
    def beam_places(self) -> IntArray:
        """Where in the arrays the beam is, if it has a pixel."""
        return np.flatnonzero((self.pixels.beam == self.beam) & (self.pixels.row >= 0))


def depth_limits_m(depth_m: Float32Array) -> tuple[float, float] | None:
    """The scale of a depth image: nearly all of its depths, None without any."""
    valid = depth_m[np.isfinite(depth_m)]
    if not valid.size:
        return None
    last = valid.size - 1
    ends = [round(_BEYOND_FRACTION * last), round((1.0 - _BEYOND_FRACTION) * last)]
    low, high = np.partition(valid, ends)[ends]
    return distinct_limits(float(low), float(high))


def depth_picture(
    title: str,
    depth_m: Float32Array,
    overlay: PairOverlay | None = None,
    *,
    width_px: int,
    height_px: int,
    limits_m: tuple[float, float] | None = None,
    theme: Theme = LIGHT,
) -> DepthPicture:
    """Draw an image, (H, W) float32 metres, NaN where missing.

    ``limits_m``: depths of the first and the last colour, for pictures that are compared, else the
    image's own. The image keeps its proportions, so that the picture may be lower than
    ``height_px``. Raises ValueError for too small a picture.
    """
    scale = _scale_of(depth_m, limits_m, theme)
    legend = Legend.of(_legend(overlay), width_px - 2 * MARGIN_PX)
    shape = (depth_m.shape[0], depth_m.shape[1])
    below = BELOW_PX + legend.height_px + MARGIN_PX // 2
    box = _box_of(shape, width_px, height_px - below)
    rgb = blank_canvas(width_px, box.bottom + below, theme)
    axes = image_axes(rgb, box, shape, theme=theme)
    scale.paint(axes.inside, depth_m)
    axes.draw_frame()
    axes.draw_title(title)
    axes.draw_x_axis("column (px)", axes.x_ticks(whole=True))
    axes.draw_y_axis("row (px)", axes.y_ticks(whole=True))
    if overlay is not None:
        _draw_overlay(axes, shape, overlay)
    scale.draw_bar(rgb, box, "depth (m)", beyond=_beyond(depth_m, scale))
    legend.draw(rgb, MARGIN_PX, box.bottom + BELOW_PX, theme)
    return DepthPicture(rgb=rgb, axes=axes, shape=shape, limits_m=scale.limits)


def dock_depth_picture(
    depth_m: Float32Array,
    overlay: PairOverlay | None = None,
    *,
    width_px: int,
    height_px: int,
    limits_m: tuple[float, float] | None = None,
    review: ReviewOverlay | None = None,
    theme: Theme = LIGHT,
) -> DepthPicture:
    """Draw an image, (H, W) float32 metres, NaN where missing, for a dock or a phone: as large as
    the width allows, without a title.

    ``overlay``: the frame's pairs, None while there are none. ``review``: its labels, below them.
    ``limits_m``, size and errors are
    those of ``depth_picture``. The size depends on the shape of the image alone.
    """
    scale = _scale_of(depth_m, limits_m, theme)
    layout = DockLayout.of(_dock_legend(), width_px, height_px)
    shape = (depth_m.shape[0], depth_m.shape[1])
    box = _fit(shape, layout.space)
    rgb = blank_canvas(width_px, layout.height_px(box), theme)
    axes = image_axes(rgb, box, shape, theme=theme)
    scale.paint(axes.inside, depth_m)
    draw_close_axes(axes, "column", "row")
    if review is not None:
        draw_labels(axes, review)
    if overlay is not None:
        _draw_overlay(axes, shape, overlay)
        layout.draw_legend(axes)
    ends = _ends(scale, _beyond(depth_m, scale))
    layout.draw_scale(rgb, scale, "depth", ends, none="no depth")
    return DepthPicture(rgb=rgb, axes=axes, shape=shape, limits_m=scale.limits)


def _scale_of(
    depth_m: Float32Array, limits_m: tuple[float, float] | None, theme: Theme
) -> ColorScale:
    own = depth_limits_m(depth_m)
    return ColorScale(
        colors=color_map("cividis"),
        limits=own if limits_m is None or own is None else distinct_limits(*limits_m),
        theme=theme,
    )


def _beyond(depth_m: Float32Array, scale: ColorScale) -> tuple[bool, bool]:
    """Whether there are depths below and above the limits of the scale."""
    if scale.limits is None:
        return False, False
    low, high = scale.limits
    return float(np.nanmin(depth_m)) < low, float(np.nanmax(depth_m)) > high


def _ends(scale: ColorScale, beyond: tuple[bool, bool]) -> tuple[str, str]:
    """The ends of the scale in text; beyond them the colours stay the same."""
    if scale.limits is None:
        return "", ""
    low, high = scale.limits
    below, above = "≤ " if beyond[0] else "", "≥ " if beyond[1] else ""
    return f"{below}{low:.1f}", f"{above}{high:.1f} m"


def _box_of(shape: tuple[int, int], width_px: int, bottom: int) -> Box:
    """The largest box of an image's proportions, in the middle of the width."""
    return _fit(shape, box_between(LEFT_PX, ABOVE_PX, width_px - COLOR_BAR_PX, bottom))


def _fit(shape: tuple[int, int], space: Box) -> Box:
    zoom = min(space.width / shape[1], space.height / shape[0])
    width, height = max(1, int(zoom * shape[1])), max(1, int(zoom * shape[0]))
    return Box(space.left + (space.width - width) // 2, space.top, width, height)


def _draw_overlay(axes: Axes, shape: tuple[int, int], overlay: PairOverlay) -> None:
    """The LiDAR's curve with its marks, and a ring around the pixel of the selected beam."""
    draw_lidar_curve(axes, shape, overlay.pixels, overlay.visible)
    for place in overlay.beam_places[:1]:
        pairs = overlay.pixels
        x, y = axes.to_pixel(pairs.column[place], pairs.row[place])
        _draw_ring(axes.inside, (round(x) - axes.box.left, round(y) - axes.box.top), 9)


def _draw_ring(part: ByteArray, place: tuple[int, int], radius_px: int) -> None:
    cv2.circle(part, place, radius_px, BLACK, 4, cv2.LINE_AA)
    cv2.circle(part, place, radius_px, WHITE, 2, cv2.LINE_AA)


def _legend(overlay: PairOverlay | None) -> list[LegendEntry]:
    """What the colours mean, with the number of pixels of each class."""
    entries = []

    def counted(label: str, chosen: BoolArray) -> str:
        return f"{label} {padded(str(int(chosen.sum())), 3)}"

    if overlay is not None:
        pairs, visible, beam = overlay.pixels, overlay.visible, overlay.beam
        if (pairs.noise_class >= 0).any():
            for noise in sorted(overlay.classes):
                label = counted(noise.name.lower(), visible & (pairs.noise_class == noise))
                symbol = curve_symbol if noise == NoiseClass.GOOD else class_symbol(noise)
                entries.append(LegendEntry(symbol, label))
            label = counted("repaired", visible & pairs.repaired)
            entries.append(LegendEntry(_REPAIRED_SYMBOL, label))
        else:
            entries.append(LegendEntry(curve_symbol, counted("pair", visible)))
        if beam is not None:
            in_image = overlay.beam_places.size > 0
            label = f"beam {beam}" if in_image else f"beam {beam}: not in the image"
            entries.append(LegendEntry(_beam_symbol, label))
    return [*entries, LegendEntry(hatch_symbol, "no depth")]


def _dock_legend() -> list[LegendEntry]:
    """The same for every frame, without numbers."""
    marks = [
        LegendEntry(class_symbol(noise), noise.name.lower())
        for noise in NoiseClass
        if noise != NoiseClass.GOOD
    ]
    return [
        LegendEntry(curve_symbol, "LiDAR, good"),
        *marks,
        LegendEntry(_REPAIRED_SYMBOL, "repaired"),
    ]


_REPAIRED_SYMBOL = class_symbol(NoiseClass.HOLE, is_repaired=True)


def _beam_symbol(part: ByteArray, _theme: Theme) -> None:
    _draw_ring(part, (part.shape[1] // 2, part.shape[0] // 2), 5)
