"""Marks of the noise classes: a shape for each, which is told apart without its colour, with a dark
and a light outline, which are seen on any ground: good is a dot, a hole a ring, a burr a cross, a
conflict a diamond.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, ByteArray, IntArray
from scanloom.plots.axes import FRACTION_BITS
from scanloom.plots.canvas import BLACK, WHITE
from scanloom.plots.legend import Symbol
from scanloom.plots.palette import Color, class_color

MARK_PX = 3
"""Radius of a mark on pictures of a dock's width, without its outlines."""

# Width of the strokes of cross and ring. Around all shapes are 1 px of dark and 1 px of light.
_STROKE_PX = 2
_ONE = 1 << FRACTION_BITS
# No mark with its outlines is larger.
_REACH_PX = 10


def draw_class_marks(
    part: ByteArray,
    places: IntArray,
    noise: NoiseClass,
    *,
    radius_px: int = MARK_PX,
    repaired: BoolArray | None = None,
) -> None:
    """Draw the mark of a class at (N, 2) x, y in pixels of ``part``, clipped to it.

    ``repaired``: (N,) marks whose sample was repaired, which are on a white disc; rings are filled
    with white then, and with black elsewhere. The light outlines lie below all marks, so that close
    ones do not cover each other. Quick for thousands of marks.
    """
    on_disc = np.zeros(len(places), dtype=np.bool_) if repaired is None else repaired
    kinds = [
        (places[on_disc == is_repaired], _sprite(noise, radius_px, is_repaired=is_repaired))
        for is_repaired in (False, True)
    ]
    for is_inner in (False, True):
        for marked, sprite in kinds:
            if len(marked):
                _stamp(part, marked, sprite, is_inner=is_inner)


def class_symbol(noise: NoiseClass, *, is_repaired: bool = False) -> Symbol:
    """The mark of a class in a legend."""

    def draw(part: ByteArray, _theme: object) -> None:
        middle = np.array([[part.shape[1] // 2, part.shape[0] // 2]])
        draw_class_marks(part, middle, noise, repaired=np.array([is_repaired]))

    return draw


def spread_out(places: IntArray, spacing_px: int) -> IntArray:
    """Indices of the first of (N, 2) places in each square of a lattice: where marks would cover
    each other, one of them says it."""
    cells = places // spacing_px
    _, first = np.unique(cells[:, 0] * (1 << 20) + cells[:, 1], return_index=True)
    return np.sort(first)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sprite:
    """A drawn mark: (K,) x and y of its pixels from its middle, and (K, 3) their colours; those of
    its light outline, and those within."""

    outline: tuple[IntArray, IntArray, ByteArray]
    inner: tuple[IntArray, IntArray, ByteArray]


def _stamp(part: ByteArray, places: IntArray, sprite: _Sprite, *, is_inner: bool) -> None:
    """Draw the pixels within, or outside of, the light outline of marks at (N, 2) places."""
    x_offsets, y_offsets, colors = sprite.inner if is_inner else sprite.outline
    x = places[:, :1] + x_offsets
    y = places[:, 1:] + y_offsets
    height, width = part.shape[:2]
    low_x, low_y = places.min(axis=0) - _REACH_PX
    high_x, high_y = places.max(axis=0) + _REACH_PX
    if low_x >= 0 and low_y >= 0 and high_x < width and high_y < height:
        part[y, x] = colors
        return
    is_inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    part[y[is_inside], x[is_inside]] = np.broadcast_to(colors, (*x.shape, 3))[is_inside]


@lru_cache(maxsize=32)
def _sprite(noise: NoiseClass, radius_px: int, *, is_repaired: bool) -> _Sprite:
    draw, half = _SHAPES[noise], _REACH_PX
    outline = _draw_disc if is_repaired else draw
    middle = [half * _ONE, half * _ONE]

    def drawn(grown: int) -> BoolArray:
        mask = np.zeros((2 * half + 1, 2 * half + 1, 3), dtype=np.uint8)
        outline(mask, middle, WHITE, radius_px, grown)
        return mask[:, :, 0] > 127

    rgb = np.full((2 * half + 1, 2 * half + 1, 3), 255, dtype=np.uint8)
    outline(rgb, middle, BLACK, radius_px, 2)
    if is_repaired:
        _draw_disc(rgb, middle, WHITE, radius_px, 1)
    draw(rgb, middle, class_color(noise), radius_px, 0)
    inner = drawn(2)
    outline_y, outline_x = np.nonzero(drawn(3) & ~inner)
    y, x = np.nonzero(inner)
    return _Sprite(
        outline=(outline_x - half, outline_y - half, rgb[outline_y, outline_x]),
        inner=(x - half, y - half, rgb[y, x]),
    )


_Draw = Callable[[ByteArray, list[int], Color, int, int], None]
"""Draws into a part, at x, y with FRACTION_BITS, a shape of a colour and a radius that is ``grown``
on all sides: 0 for the mark itself, more for its outlines."""


def _draw_dot(part: ByteArray, place: list[int], color: Color, radius: int, grown: int) -> None:
    cv2.circle(part, place, (radius + grown) * _ONE, color, cv2.FILLED, cv2.LINE_AA, FRACTION_BITS)


def _draw_disc(part: ByteArray, place: list[int], color: Color, radius: int, grown: int) -> None:
    _draw_dot(part, place, color, radius + 1, grown)


def _draw_ring(part: ByteArray, place: list[int], color: Color, radius: int, grown: int) -> None:
    if grown:
        # Its outline fills it: a hole is dark.
        _draw_disc(part, place, color, radius, grown)
    else:
        reach = (radius + 1) * _ONE
        cv2.circle(part, place, reach, color, _STROKE_PX, cv2.LINE_AA, FRACTION_BITS)


def _draw_cross(part: ByteArray, place: list[int], color: Color, radius: int, grown: int) -> None:
    x, y = place
    arm = (radius + 1) * _ONE
    width_px = _STROKE_PX + 2 * max(grown - 1, 0)
    for sign in (-1, 1):
        start, end = (x - arm, y - sign * arm), (x + arm, y + sign * arm)
        cv2.line(part, start, end, color, width_px, cv2.LINE_AA, FRACTION_BITS)


def _draw_diamond(part: ByteArray, place: list[int], color: Color, radius: int, grown: int) -> None:
    x, y = place
    # A diamond's sides are nearer to its middle than its corners.
    reach = round((radius + 1 + 1.4 * max(grown - 1, 0)) * _ONE)
    corners = np.array([(x - reach, y), (x, y - reach), (x + reach, y), (x, y + reach)])
    cv2.fillConvexPoly(part, corners.astype(np.int32), color, cv2.LINE_AA, FRACTION_BITS)


_SHAPES: dict[NoiseClass, _Draw] = {
    NoiseClass.GOOD: _draw_dot,
    NoiseClass.HOLE: _draw_ring,
    NoiseClass.BURR: _draw_cross,
    NoiseClass.CONFLICT: _draw_diamond,
}
