"""Upright depth images as pictures to look at and pick in, with the pixels of the pairs on them.

One image, or several of one camera side by side on one scale: raw and repaired.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray, Float32Array, IntArray
from scanloom.plots import sheet as paper
from scanloom.plots.lettering import shortened, write
from scanloom.plots.palette import Color, class_color, color_map, color_of
from scanloom.plots.sheet import LINE_PX, MARGIN_PX, Box, LegendEntry
from scanloom.scene.pair_pixels import PairPixels

_LEFT_PX = 54
_BELOW_PX = 40
_BETWEEN_PX = 14
# Images wider than this get larger dots.
_LARGE_PX = 480
_LIGHT: Color = (255, 255, 255)
_DARK: Color = (0, 0, 0)
# The scale ends beyond nearly all depths: a few stray pixels must not take its colours.
_BEYOND_SHARE = 0.005
# What is looked for goes on top.
_DRAWN_IN_ORDER = (NoiseClass.GOOD, NoiseClass.CONFLICT, NoiseClass.HOLE, NoiseClass.BURR)


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthPicture:
    """``rgb``: (h, w, 3) uint8. ``boxes``: where each image lies in it; ``shape``: rows and columns
    of an image; ``limits_m``: depths of the first and the last colour, None without any depth."""

    rgb: ByteArray
    boxes: tuple[Box, ...]
    shape: tuple[int, int]
    limits_m: tuple[float, float] | None

    def pixel_at(self, x_px: float, y_px: float) -> tuple[int, int] | None:
        """Row and column of the depth pixel under a point, None outside of the images."""
        for box in self.boxes:
            if box.holds(x_px, y_px):
                row = int((y_px - box.top + 0.5) * self.shape[0] / box.height)
                column = int((x_px - box.left + 0.5) * self.shape[1] / box.width)
                return min(row, self.shape[0] - 1), min(column, self.shape[1] - 1)
        return None

    def place_of(self, row: float, column: float, *, image: int = 0) -> tuple[float, float]:
        """Where the centre of a depth pixel lies in the picture, in the image of that number."""
        box = self.boxes[image]
        x = box.left + (column + 0.5) * box.width / self.shape[1] - 0.5
        y = box.top + (row + 0.5) * box.height / self.shape[0] - 0.5
        return x, y


def depth_limits_m(depth_m: Float32Array) -> tuple[float, float] | None:
    """The scale of a depth image: nearly all of its depths, None without any."""
    valid = depth_m[np.isfinite(depth_m)]
    if not valid.size:
        return None
    last = valid.size - 1
    ends = [round(_BEYOND_SHARE * last), round((1.0 - _BEYOND_SHARE) * last)]
    low, high = np.partition(valid, ends)[ends]
    return paper.wide_limits(float(low), float(high))


def depth_picture(
    images: Mapping[str, Float32Array],
    pairs: PairPixels | None = None,
    *,
    width_px: int,
    height_px: int,
    classes: Collection[NoiseClass] = frozenset(NoiseClass),
    beam: int | None = None,
    limits_m: tuple[float, float] | None = None,
) -> DepthPicture:
    """Draw images of one size, (H, W) float32 metres, NaN where missing, by title from left to
    right.

    ``classes``: those whose pixels are drawn, the repaired ones marked in the last image;
    ``beam``: index in the scan of the one to point at; ``limits_m``: depths of the first and the
    last colour, for pictures that are compared, else those of the first image. The images keep
    their proportions, so that the picture may be lower than ``height_px``.

    Raises ValueError for no image, images of different sizes, or too small a picture.
    """
    shapes = {depth_m.shape for depth_m in images.values()}
    if len(shapes) != 1 or any(len(shape) != 2 for shape in shapes):
        raise ValueError(f"need (H, W) images of one size, got {sorted(shapes)}")
    first_m = next(iter(images.values()))
    own = depth_limits_m(first_m)
    limits = own if limits_m is None or own is None else paper.wide_limits(*limits_m)
    legend = paper.legend_lines(_legend(pairs, classes, beam), width_px - 2 * MARGIN_PX)
    boxes, needed_px = _layout(len(images), first_m.shape, width_px, height_px, len(legend))
    rgb = paper.blank_sheet(width_px, needed_px)
    shape = (first_m.shape[0], first_m.shape[1])
    picture = DepthPicture(rgb=rgb, boxes=boxes, shape=shape, limits_m=limits)
    for place, (title, depth_m) in enumerate(images.items()):
        box = boxes[place]
        paper.paint_values(box.view(rgb), depth_m, limits, color_map("cividis"))
        box.frame(rgb)
        words = shortened(title, box.width, size_px=paper.TITLE_PX)
        write(rgb, words, box.left, box.top - 13, size_px=paper.TITLE_PX)
        _draw_axes(picture, place)
        if pairs is not None:
            _draw_pairs(picture, place, pairs, pairs.shown(classes))
            _draw_beam(picture, place, pairs, beam)
    if limits is not None:
        beyond = float(np.nanmin(first_m)) < limits[0], float(np.nanmax(first_m)) > limits[1]
        paper.color_bar(
            rgb, boxes[-1], limits, color_map("cividis"), words="depth (m)", beyond=beyond
        )
    paper.draw_legend(rgb, legend, MARGIN_PX, boxes[0].bottom + _BELOW_PX)
    return picture


def _layout(
    count: int, shape: tuple[int, ...], width_px: int, height_px: int, legend_lines: int
) -> tuple[tuple[Box, ...], int]:
    """Boxes of the images' proportions, and the height of the picture around them."""
    top = MARGIN_PX + LINE_PX + 2
    under = _BELOW_PX + legend_lines * LINE_PX + MARGIN_PX // 2
    space = paper.room(_LEFT_PX, top, width_px - paper.COLOR_BAR_PX, height_px - under)
    between = (count - 1) * _BETWEEN_PX
    zoom = min((space.width - between) / (count * shape[1]), space.height / shape[0])
    width, height = max(1, int(zoom * shape[1])), max(1, int(zoom * shape[0]))
    left = space.left + (space.width - between - count * width) // 2
    boxes = tuple(Box(left + i * (width + _BETWEEN_PX), top, width, height) for i in range(count))
    return boxes, top + height + under


def _draw_axes(picture: DepthPicture, place: int) -> None:
    rgb, box, (rows, columns) = picture.rgb, picture.boxes[place], picture.shape
    for column in paper.whole_ticks_between(0, columns - 1, max(2, box.width // 44)):
        paper.tick_below(rgb, box, picture.place_of(0, column, image=place)[0], str(column))
    write(rgb, "column (px)", box.left + 0.5 * box.width, box.bottom + 28, align="middle")
    if place == 0:
        for row in paper.whole_ticks_between(0, rows - 1, max(2, box.height // 34)):
            paper.tick_left(rgb, box, picture.place_of(row, 0)[1], str(row))
        middle = box.top + 0.5 * box.height
        write(rgb, "row (px)", box.left - 41, middle, align="middle", turned=True)


def _draw_pairs(picture: DepthPicture, place: int, pairs: PairPixels, shown: BoolArray) -> None:
    """A dot for each pixel, dark around it, in the last image light where it was repaired."""
    box, (rows, columns) = picture.boxes[place], picture.shape
    inside = box.view(picture.rgb)
    y = (2 * pairs.row + 1) * box.height // (2 * rows)
    x = (2 * pairs.column + 1) * box.width // (2 * columns)
    size_px = 3 if box.width < _LARGE_PX else 5
    _dots(inside, x[shown], y[shown], _DARK, size_px + 2)
    if place == len(picture.boxes) - 1:
        marked = shown & pairs.repaired
        _dots(inside, x[marked], y[marked], _LIGHT, size_px + 4)
    unjudged = shown & (pairs.noise_class < 0)
    _dots(inside, x[unjudged], y[unjudged], color_of("lidar"), size_px)
    for noise in _DRAWN_IN_ORDER:
        chosen = shown & (pairs.noise_class == noise)
        _dots(inside, x[chosen], y[chosen], class_color(noise), size_px)


def _dots(part: ByteArray, x: IntArray, y: IntArray, color: Color, size_px: int) -> None:
    """Squares around points inside ``part``, cut at its edges."""
    around = np.arange(size_px) - size_px // 2
    rows = np.clip(y[:, np.newaxis] + around, 0, part.shape[0] - 1)
    columns = np.clip(x[:, np.newaxis] + around, 0, part.shape[1] - 1)
    part[rows[:, :, np.newaxis], columns[:, np.newaxis, :]] = color


def _draw_beam(picture: DepthPicture, place: int, pairs: PairPixels, beam: int | None) -> None:
    """A ring around the pixel of the beam that is looked at."""
    found = np.flatnonzero((pairs.beam == beam) & (pairs.row >= 0))
    if beam is None or not found.size:
        return
    x, y = picture.place_of(pairs.row[found[0]], pairs.column[found[0]], image=place)
    box = picture.boxes[place]
    _ring(box.view(picture.rgb), (round(x) - box.left, round(y) - box.top), 9)


def _ring(part: ByteArray, at: tuple[int, int], radius_px: int) -> None:
    cv2.circle(part, at, radius_px, _DARK, 4, cv2.LINE_AA)
    cv2.circle(part, at, radius_px, _LIGHT, 2, cv2.LINE_AA)


def _legend(
    pairs: PairPixels | None, classes: Collection[NoiseClass], beam: int | None
) -> list[LegendEntry]:
    """What the signs mean, with the number of pixels of each class."""

    def counted(words: str, chosen: BoolArray) -> str:
        return f"{words} {paper.steady(str(int(chosen.sum())), 3)}"

    entries = []
    if pairs is not None:
        shown = pairs.shown(classes)
        if (pairs.noise_class >= 0).any():
            for noise in sorted(classes):
                words = counted(noise.name.lower(), shown & (pairs.noise_class == noise))
                entries.append(LegendEntry(paper.swatch(class_color(noise)), words))
            words = counted("repaired", shown & pairs.repaired)
            entries.append(LegendEntry(_repaired_symbol, words))
        else:
            entries.append(LegendEntry(paper.swatch(color_of("lidar")), counted("pair", shown)))
        if beam is not None:
            in_image = bool(((pairs.beam == beam) & (pairs.row >= 0)).any())
            words = f"beam {beam}" if in_image else f"beam {beam}: not in the image"
            entries.append(LegendEntry(_beam_symbol, words))
    return [*entries, LegendEntry(paper.hatched, "no depth")]


def _repaired_symbol(part: ByteArray) -> None:
    middle = part.shape[1] // 2, part.shape[0] // 2
    for radius_px, color in ((5, _DARK), (4, _LIGHT), (2, class_color(NoiseClass.HOLE))):
        start, end = (m - radius_px for m in middle), (m + radius_px for m in middle)
        cv2.rectangle(part, tuple(start), tuple(end), color, -1)


def _beam_symbol(part: ByteArray) -> None:
    _ring(part, (part.shape[1] // 2, part.shape[0] // 2), 5)
