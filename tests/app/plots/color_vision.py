"""Colours as they are seen: contrast by WCAG 2, and differences with deuteranopia."""

import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray

# Machado, Oliveira, Fernandes 2009: deuteranomaly of severity 1, for linear RGB.
_DEUTERANOPIA = np.array(
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)
# sRGB, IEC 61966-2-1.
_XYZ_OF_RGB = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)
_WHITE_XYZ = np.array([0.95047, 1.0, 1.08883])

AnyColor = tuple[int, int, int] | ByteArray


def contrast(first: AnyColor, second: AnyColor) -> float:
    """The contrast ratio of two colours by WCAG 2, from 1 to 21."""
    low, high = sorted(float(_linear(color) @ _XYZ_OF_RGB[1]) for color in (first, second))
    return (high + 0.05) / (low + 0.05)


def deuteranope(rgb: AnyColor) -> ByteArray:
    """(..., 3) uint8: what a reader with deuteranopia sees of 8-bit colours."""
    linear = np.clip(_linear(rgb) @ _DEUTERANOPIA.T, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round(255.0 * encoded).astype(np.uint8)


def difference(first: AnyColor, second: AnyColor) -> float:
    """The CIE 1976 difference of two colours; 2.3 is just noticeable side by side."""
    return float(np.linalg.norm(_lab(first) - _lab(second)))


def _linear(rgb: AnyColor) -> FloatArray:
    part = np.asarray(rgb, dtype=np.float64) / 255.0
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def _lab(rgb: AnyColor) -> FloatArray:
    relative = _linear(rgb) @ _XYZ_OF_RGB.T / _WHITE_XYZ
    x, y, z = np.where(relative > 0.008856, np.cbrt(relative), 7.787 * relative + 16 / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])
