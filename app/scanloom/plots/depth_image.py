"""Upright depth images as pictures in which pixels can be picked, with the pairs marked."""

from collections.abc import Collection
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray, Float32Array, IntArray
from scanloom.plots.axes import ABOVE_PX, BELOW_PX, LEFT_PX, Axes, image_axes
from scanloom.plots.canvas import BLACK, MARGIN_PX, WHITE, Box, blank_canvas, box_between
from scanloom.plots.color_scale import COLOR_BAR_PX, ColorScale
from scanloom.plots.legend import Legend, LegendEntry, hatch_symbol, padded, swatch
from scanloom.plots.pair_pixels import PairPixels
from scanloom.plots.palette import Color, class_color, color_map, color_of
from scanloom.plots.ticks import distinct_limits

# Images wider than this get larger dots.
_LARGE_PX = 480
# The scale ends beyond nearly all depths: a few stray pixels must not take its colours.
_BEYOND_FRACTION = 0.005
# Burrs and holes on top.
_DRAWING_ORDER = (NoiseClass.GOOD, NoiseClass.CONFLICT, NoiseClass.HOLE, NoiseClass.BURR)


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
) -> DepthPicture:
    """Draw an image, (H, W) float32 metres, NaN where missing.

    ``limits_m``: depths of the first and the last colour, for pictures that are compared, else the
    image's own. The image keeps its proportions, so that the picture may be lower than
    ``height_px``. Raises ValueError for too small a picture.
    """
    own = depth_limits_m(depth_m)
    scale = ColorScale(
        colors=color_map("cividis"),
        limits=own if limits_m is None or own is None else distinct_limits(*limits_m),
    )
    legend = Legend.of(_legend(overlay), width_px - 2 * MARGIN_PX)
    shape = (depth_m.shape[0], depth_m.shape[1])
    below = BELOW_PX + legend.height_px + MARGIN_PX // 2
    box = _box_of(shape, width_px, height_px - below)
    rgb = blank_canvas(width_px, box.bottom + below)
    axes = image_axes(rgb, box, shape)
    scale.paint(axes.inside, depth_m)
    axes.draw_frame()
    axes.draw_title(title)
    axes.draw_x_axis("column (px)", axes.x_ticks(whole=True))
    axes.draw_y_axis("row (px)", axes.y_ticks(whole=True))
    if overlay is not None:
        _draw_pairs(axes, shape, overlay)
        _draw_beam(axes, overlay)
    if scale.limits is not None:
        low, high = scale.limits
        beyond = float(np.nanmin(depth_m)) < low, float(np.nanmax(depth_m)) > high
        scale.draw_bar(rgb, box, "depth (m)", beyond=beyond)
    legend.draw(rgb, MARGIN_PX, box.bottom + BELOW_PX)
    return DepthPicture(rgb=rgb, axes=axes, shape=shape, limits_m=scale.limits)


def _box_of(shape: tuple[int, int], width_px: int, bottom: int) -> Box:
    """The largest box of an image's proportions, in the middle of the width."""
    space = box_between(LEFT_PX, ABOVE_PX, width_px - COLOR_BAR_PX, bottom)
    zoom = min(space.width / shape[1], space.height / shape[0])
    width, height = max(1, int(zoom * shape[1])), max(1, int(zoom * shape[0]))
    return Box(space.left + (space.width - width) // 2, space.top, width, height)


def _draw_pairs(axes: Axes, shape: tuple[int, int], overlay: PairOverlay) -> None:
    """A square for each pixel, dark around it, light where it was repaired."""
    box, pairs, visible = axes.box, overlay.pixels, overlay.visible
    y = (2 * pairs.row + 1) * box.height // (2 * shape[0])
    x = (2 * pairs.column + 1) * box.width // (2 * shape[1])
    size_px = 3 if box.width < _LARGE_PX else 5

    def draw(chosen: BoolArray, color: Color, size_px: int) -> None:
        _draw_squares(axes.inside, x[chosen], y[chosen], color, size_px)

    draw(visible, BLACK, size_px + 2)
    draw(visible & pairs.repaired, WHITE, size_px + 4)
    draw(visible & (pairs.noise_class < 0), color_of("lidar"), size_px)
    for noise in _DRAWING_ORDER:
        draw(visible & (pairs.noise_class == noise), class_color(noise), size_px)


def _draw_squares(part: ByteArray, x: IntArray, y: IntArray, color: Color, size_px: int) -> None:
    """Squares around points inside ``part``, cut at its edges; there may be thousands."""
    around = np.arange(size_px) - size_px // 2
    rows = np.clip(y[:, np.newaxis] + around, 0, part.shape[0] - 1)
    columns = np.clip(x[:, np.newaxis] + around, 0, part.shape[1] - 1)
    part[rows[:, :, np.newaxis], columns[:, np.newaxis, :]] = color


def _draw_beam(axes: Axes, overlay: PairOverlay) -> None:
    """A ring around the pixel of the selected beam."""
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
                entries.append(LegendEntry(swatch(class_color(noise)), label))
            label = counted("repaired", visible & pairs.repaired)
            entries.append(LegendEntry(_repaired_symbol, label))
        else:
            entries.append(LegendEntry(swatch(color_of("lidar")), counted("pair", visible)))
        if beam is not None:
            in_image = overlay.beam_places.size > 0
            label = f"beam {beam}" if in_image else f"beam {beam}: not in the image"
            entries.append(LegendEntry(_beam_symbol, label))
    return [*entries, LegendEntry(hatch_symbol, "no depth")]


def _repaired_symbol(part: ByteArray) -> None:
    middle = part.shape[1] // 2, part.shape[0] // 2
    for radius_px, color in ((5, BLACK), (4, WHITE), (2, class_color(NoiseClass.HOLE))):
        start, end = (m - radius_px for m in middle), (m + radius_px for m in middle)
        cv2.rectangle(part, tuple(start), tuple(end), color, -1)


def _beam_symbol(part: ByteArray) -> None:
    _draw_ring(part, (part.shape[1] // 2, part.shape[0] // 2), 5)
