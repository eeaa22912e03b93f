"""Painted surfaces: what a camera and a LiDAR of 905 nm see of posters, bricks, books and wood.

A texture is drawn as an image of indices into a palette. Each entry of the palette has a visible
colour and a reflectance at 905 nm that is related to its brightness and not given by it: many dyes
that look dark are bright in the near infrared.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, read_only

# Rec. 601: the brightness of a colour.
_LUMA = np.array([0.299, 0.587, 0.114])
_INFRARED_WEIGHT = 0.65
_LETTERS = "ABCDEFGHJKLMNPRSTUVXYZ2345678"


@dataclass(frozen=True, slots=True)
class Texture:
    """A painted rectangle, its first row at the end of the second edge.

    ``rgb``: (H, W, 3) uint8. ``infrared``: (H, W) float32 in [0, 1], reflectance at 905 nm.
    """

    rgb: ByteArray
    infrared: Float32Array

    def __post_init__(self) -> None:
        if self.rgb.shape != (*self.infrared.shape, 3):
            raise ValueError(f"rgb must be {(*self.infrared.shape, 3)}, got {self.rgb.shape}")
        read_only(self.rgb)
        read_only(self.infrared)


@dataclass(frozen=True, slots=True)
class _Painting:
    indices: ByteArray
    rgb: FloatArray
    infrared: FloatArray


Painter = Callable[[tuple[int, int], np.random.Generator], _Painting]
"""Paints a rectangle of (H, W) texels."""


def paint(painter: Painter, shape: tuple[int, int], rng: np.random.Generator) -> Texture:
    """A texture of (H, W) texels."""
    return _finish(painter(shape, rng), rng)


def hang(
    wall: Texture, pictures: list[tuple[int, int, Texture]], rng: np.random.Generator
) -> Texture:
    """A wall with pictures on it, each at its (row, column) with a thin dark frame or none."""
    rgb, infrared = wall.rgb.copy(), wall.infrared.copy()
    for row, column, picture in pictures:
        height, width = picture.infrared.shape
        place = np.s_[row : row + height, column : column + width]
        rgb[place], infrared[place] = picture.rgb, picture.infrared
        if rng.random() < 0.6:
            corners = (column, row), (column + width - 1, row + height - 1)
            dark = float(rng.uniform(0.05, 0.35))
            cv2.rectangle(rgb, *corners, (30, 28, 26), 6)
            cv2.rectangle(infrared, *corners, dark, 6)
    return Texture(rgb, infrared)


def stand_on_skirting(wall: Texture, height: int) -> Texture:
    """A wall with a dark skirting board of ``height`` texels along its foot."""
    rgb, infrared = wall.rgb.copy(), wall.infrared.copy()
    rgb[-height:], infrared[-height:] = (70, 62, 55), 0.3
    rgb[-height : -height + 2] = (30, 28, 26)
    return Texture(rgb, infrared)


def mirrored(texture: Texture) -> Texture:
    """The same from left to right, for a surface that is seen from its other side."""
    return Texture(texture.rgb[:, ::-1].copy(), texture.infrared[:, ::-1].copy())


def poster(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """Shapes, lines and letters of many sizes."""
    height, width = shape
    size = min(height, width)
    image = np.zeros(shape, dtype=np.uint8)
    colors = 24
    for _ in range(int(rng.integers(14, 26))):
        color = int(rng.integers(1, colors))
        x, y = int(rng.integers(width)), int(rng.integers(height))
        reach = int(size * rng.uniform(0.03, 0.25)) + 2
        kind = int(rng.integers(4))
        if kind == 0:
            w, h = int(reach * rng.uniform(0.4, 2.0)), int(reach * rng.uniform(0.4, 2.0))
            cv2.rectangle(image, (x, y), (x + w, y + h), color, -1)
        elif kind == 1:
            axes = (reach, max(2, int(reach * rng.uniform(0.4, 1.0))))
            cv2.ellipse(image, (x, y), axes, float(rng.uniform(0, 180)), 0, 360, color, -1)
        elif kind == 2:
            corners = np.array([x, y]) + rng.integers(-reach, reach + 1, (3, 2))
            cv2.fillPoly(image, [corners.astype(np.int32)], color)
        else:
            other = int(rng.integers(width)), int(rng.integers(height))
            cv2.line(image, (x, y), other, color, int(rng.integers(3, 12)))
    for _ in range(int(rng.integers(8, 16))):
        count = int(rng.integers(2, 7))
        text = "".join(_LETTERS[int(i)] for i in rng.integers(len(_LETTERS), size=count))
        scale = float(rng.uniform(0.8, 4.0))
        place = int(rng.integers(-20, width)), int(rng.integers(height))
        thick = max(2, int(scale * 2.0))
        color = int(rng.integers(1, colors))
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, scale, color, thick)
    return _with_palette(image, rng.uniform(10, 245, (colors, 3)), rng)


def picture(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """Blotches of all sizes, like a photograph or a painting."""
    levels = 14
    height = sum(
        _smooth_noise(shape, cell, rng) * weight
        for cell, weight in ((120, 1.0), (48, 0.7), (20, 0.5), (9, 0.3))
    )
    ranks = np.searchsorted(np.quantile(height, np.linspace(0, 1, levels + 1)[1:-1]), height)
    ends = rng.uniform(0, 255, (4, 3))
    steps = np.linspace(0, 3, levels)
    palette = np.stack([np.interp(steps, np.arange(4), ends[:, c]) for c in range(3)], axis=1)
    palette = np.clip(palette + rng.normal(0.0, 22.0, palette.shape), 5, 250)
    return _with_palette(np.asarray(ranks, dtype=np.uint8), palette, rng)


def bricks(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """Courses of bricks of differing lengths, colours and heights, with light joints."""
    image = np.zeros(shape, dtype=np.uint8)
    row, joint = 0, 4
    while row < shape[0]:
        height = int(rng.integers(24, 40))
        column = -int(rng.integers(60))
        while column < shape[1]:
            width = int(rng.integers(50, 110))
            left, top = max(column, 0), row + joint
            color = int(rng.integers(1, 16))
            image[top : row + height, left : max(column + width - joint, 0)] = color
            column += width
        row += height
    palette = np.array([170, 95, 75]) * rng.uniform(0.35, 1.35, (16, 1))
    palette += rng.normal(0, 12, (16, 3))
    palette[0] = 200
    return _with_palette(image, np.clip(palette, 5, 250), rng)


def books(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """Shelves of spines of differing widths and heights, with bands and labels."""
    image = np.zeros(shape, dtype=np.uint8)
    shelves = max(1, round(shape[0] / 140))
    edges = np.linspace(0, shape[0], shelves + 1).astype(int)
    for top, bottom in pairwise(edges):
        image[top : top + 8] = 1
        column = 0
        while column < shape[1]:
            width = int(rng.integers(9, 30))
            head = top + 8 + int(rng.integers(4, 35))
            image[head:bottom, column : column + width] = int(rng.integers(2, 28))
            for _ in range(int(rng.integers(0, 4))):
                at, high = int(rng.integers(head, bottom)), int(rng.integers(3, 16))
                band = np.s_[at : min(at + high, bottom), column : column + width]
                image[band] = int(rng.integers(2, 28))
            column += width + int(rng.random() < 0.15) * 12
    palette = rng.uniform(15, 240, (28, 3))
    palette[0], palette[1] = 25, (150, 110, 70)
    return _with_palette(image, palette, rng)


def checkerboard(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """A board of 8 by 6 squares with a white rim."""
    rows, columns = 6, 8
    if shape[0] > shape[1]:
        rows, columns = columns, rows
    rim = round(0.06 * min(shape))
    inner = shape[0] - 2 * rim, shape[1] - 2 * rim
    row = np.arange(inner[0]) * rows // inner[0]
    column = np.arange(inner[1]) * columns // inner[1]
    image = np.ones(shape, dtype=np.uint8)
    image[rim : rim + inner[0], rim : rim + inner[1]] = (row[:, None] + column) % 2
    return _Painting(image, np.array([[18.0] * 3, [238.0] * 3]), np.array([0.08, 0.85]))


def wood(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """Grain and the joints of doors and drawers."""
    wide = _smooth_noise((shape[0], max(4, shape[1] // 16)), 14, rng)
    grain = cv2.resize(wide, shape[::-1], interpolation=cv2.INTER_LINEAR)
    image = np.clip(np.rint(5.0 + 2.5 * grain), 1, 10).astype(np.uint8)
    for cut in np.sort(rng.integers(20, max(21, shape[0] - 20), int(rng.integers(1, 4)))):
        image[cut : cut + 4] = 0
        middle = int(rng.integers(shape[1] // 4, max(shape[1] // 4 + 1, 3 * shape[1] // 4)))
        image[cut + 16 : cut + 26, middle : middle + 34] = 11
    base = np.array([165, 120, 75]) * rng.uniform(0.6, 1.1)
    palette = np.outer(np.linspace(0.62, 1.2, 12), base)
    palette[0], palette[11] = 30, 215
    return _with_palette(image, np.clip(palette, 5, 250), rng)


def plaster(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """A bright wall with faint stains."""
    stains = sum(_smooth_noise(shape, cell, rng) for cell in (300, 90))
    image = np.clip(np.rint(4.0 + 1.2 * stains), 0, 8).astype(np.uint8)
    base = rng.uniform(185, 215, 3)
    return _with_palette(image, np.outer(np.linspace(0.94, 1.04, 9), base), rng, spread=0.02)


def tiles(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """A floor of tiles, each of its own shade."""
    side = 110
    rows, columns = -(-shape[0] // side), -(-shape[1] // side)
    shades = rng.integers(1, 12, (rows, columns)).astype(np.uint8)
    image = np.kron(shades, np.ones((side, side), dtype=np.uint8))[: shape[0], : shape[1]].copy()
    image[::side], image[:, ::side] = 0, 0
    palette = np.outer(np.linspace(0.5, 1.1, 12), (125, 105, 90))
    palette[0] = 60
    return _with_palette(image, np.clip(palette, 5, 250), rng)


def carpet(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """A floor of carpet tiles, each of its own shade, with light and dark flecks."""
    side = 165
    rows, columns = -(-shape[0] // side), -(-shape[1] // side)
    shades = np.kron(rng.normal(0.0, 0.8, (rows, columns)), np.ones((side, side)))
    threads = _smooth_noise(shape, 2, rng) + 0.8 * _smooth_noise(shape, 7, rng)
    image = np.clip(np.rint(7.5 + 1.5 * threads + shades[: shape[0], : shape[1]]), 0, 15)
    flecks = _smooth_noise(shape, 3, rng)
    image[flecks > 2.0], image[flecks < -2.0] = 15, 0
    palette = np.outer(np.linspace(0.6, 1.4, 16), rng.uniform(0.8, 1.2, 3) * (105, 110, 120))
    return _with_palette(image.astype(np.uint8), np.clip(palette, 5, 250), rng)


def cloth(shape: tuple[int, int], rng: np.random.Generator) -> _Painting:
    """A weave with stains and a seam."""
    row, column = np.indices(shape)
    weave = ((row // 3 + column // 3) % 2).astype(np.float64)
    image = np.clip(np.rint(4.0 + weave + 1.5 * _smooth_noise(shape, 24, rng)), 0, 9)
    image[shape[0] // 3 :: max(4, shape[0] // 2)] = 0
    palette = np.outer(np.linspace(0.7, 1.25, 10), rng.uniform(40, 170, 3))
    return _with_palette(image.astype(np.uint8), np.clip(palette, 5, 250), rng)


def _with_palette(
    image: ByteArray, palette: FloatArray, rng: np.random.Generator, *, spread: float = 1.0
) -> _Painting:
    brightness = palette @ _LUMA / 255.0
    own = rng.uniform(0.05, 0.95, len(palette))
    weight = 1.0 - spread * (1.0 - _INFRARED_WEIGHT)
    return _Painting(image, palette, np.clip(weight * brightness + (1 - weight) * own, 0.03, 0.97))


def _finish(painting: _Painting, rng: np.random.Generator) -> Texture:
    """Colours for indices, with a fine grain that both sensors see."""
    shape = painting.indices.shape
    grain = 1.0 + 0.05 * _smooth_noise(shape, 5, rng).astype(np.float32)
    rgb = painting.rgb.astype(np.float32)[painting.indices] * grain[..., np.newaxis]
    infrared = painting.infrared.astype(np.float32)[painting.indices] * grain
    return Texture(
        np.clip(np.rint(rgb), 0, 255).astype(np.uint8), np.clip(infrared, 0.0, 1.0).astype("f4")
    )


def _smooth_noise(shape: tuple[int, int], cell: int, rng: np.random.Generator) -> FloatArray:
    """Noise of standard deviation near 1 whose waves are some ``cell`` texels long."""
    coarse = (shape[0] // cell + 3, shape[1] // cell + 3)
    fine = cv2.resize(
        rng.standard_normal(coarse),
        (coarse[1] * cell, coarse[0] * cell),
        interpolation=cv2.INTER_CUBIC,
    )
    top, left = (int(i) for i in rng.integers(cell, size=2))
    return fine[top : top + shape[0], left : left + shape[1]].astype(np.float64)
