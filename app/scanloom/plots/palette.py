"""Colours of the pictures and of the scene, as 8-bit RGB: one for each noise class and sensor, and
maps from values to colours whose order the colour-blind see too.
"""

from functools import cache
from typing import Literal

import cv2
import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import ByteArray
from scanloom.resources import palette

Color = tuple[int, int, int]
Named = Literal["good", "hole", "burr", "conflict", "lidar", "depth", "fused"]
ColorMap = Literal["cividis", "viridis"]

_COLOR_MAPS: dict[ColorMap, int] = {
    "cividis": cv2.COLORMAP_CIVIDIS,
    "viridis": cv2.COLORMAP_VIRIDIS,
}


@cache
def color_of(name: Named) -> Color:
    """The colour of a class, a sensor or the fused result."""
    value = palette()[name]
    return int(value[1:3], 16), int(value[3:5], 16), int(value[5:7], 16)


def class_color(noise: NoiseClass) -> Color:
    """The colour of a noise class."""
    names: dict[NoiseClass, Named] = {
        NoiseClass.GOOD: "good",
        NoiseClass.HOLE: "hole",
        NoiseClass.BURR: "burr",
        NoiseClass.CONFLICT: "conflict",
    }
    return color_of(names[noise])


@cache
def class_colors() -> ByteArray:
    """(4, 3) uint8: the classes' colours, by code. Not writable."""
    colors = np.array([class_color(noise) for noise in NoiseClass], dtype=np.uint8)
    colors.setflags(write=False)
    return colors


@cache
def color_map(name: ColorMap) -> ByteArray:
    """(256, 3) uint8: the colours from the least to the greatest value. Not writable."""
    steps = np.arange(256, dtype=np.uint8)[:, np.newaxis]
    bgr = cv2.applyColorMap(steps, _COLOR_MAPS[name])[:, 0]
    colors = np.ascontiguousarray(bgr[:, ::-1], dtype=np.uint8)
    colors.setflags(write=False)
    return colors
