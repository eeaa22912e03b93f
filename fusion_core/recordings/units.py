"""Ranges and depths of files to metres, with NaN for every way in which a file says "missing".

Ranges and depths are converted here alone: 0, infinities, values out of limits and 65535 end here.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from fusion_core.model.conventions import Float32Array, FloatArray

MILLIMETRES_PER_METRE = 1000.0
# Kinect drivers and 7-Scenes write the largest value where they saw nothing.
SATURATED_DEPTH = 65535
_SMALLEST_M = float(np.finfo(np.float64).smallest_subnormal)


def ranges_m(
    ranges: npt.NDArray[np.floating[Any]], range_min_m: float, range_max_m: float
) -> FloatArray:
    """(N,) ranges with NaN where the beam gave nothing.

    Drivers report "no return" as a range of ``range_max`` or more; REP 117 as an infinity.
    """
    # The copy first: in a message the ranges may be unaligned, which slows every operation.
    found_m = ranges.astype(np.float64)
    # Not above zero means below the smallest positive number. NaN compares false, and stays.
    missing = found_m < max(range_min_m, _SMALLEST_M)
    missing |= found_m >= range_max_m
    np.putmask(found_m, missing, np.nan)
    return found_m


def depth_m_from_units(depth: np.ndarray[Any, Any], units_per_metre: float) -> Float32Array:
    """(H, W) uint16 in parts of a metre to float32 metres, NaN for 0 and 65535."""
    depth_m = depth.astype(np.float32)
    depth_m /= np.float32(units_per_metre)
    # One mask at a time: an image may have tens of millions of pixels. Dividing by the mask of the
    # holes makes them 0 / 0 = NaN; assigning NaN by the mask would take up to ten times as long.
    with np.errstate(invalid="ignore"):
        depth_m /= depth != 0
    if depth.max(initial=0) == SATURATED_DEPTH:
        depth_m[depth == SATURATED_DEPTH] = np.nan
    return depth_m


def depth_m_from_millimetres(depth_mm: np.ndarray[Any, Any]) -> Float32Array:
    """(H, W) uint16 millimetres to float32 metres, NaN for 0 and 65535."""
    return depth_m_from_units(depth_mm, MILLIMETRES_PER_METRE)


def millimetres_from_depth_m(depth_m: Float32Array) -> np.ndarray[Any, np.dtype[np.uint16]]:
    """(H, W) metres to uint16 millimetres; 0 for NaN and for what does not fit."""
    depth_mm = np.rint(depth_m.astype(np.float64) * MILLIMETRES_PER_METRE)
    fits = (depth_mm > 0) & (depth_mm < SATURATED_DEPTH)
    return np.where(fits, depth_mm, 0).astype(np.uint16)


def depth_m_from_metres(depth: np.ndarray[Any, Any]) -> Float32Array:
    """(H, W) floating metres to float32, NaN for what is not positive and finite."""
    valid = np.isfinite(depth) & (depth > 0.0)
    return np.where(valid, depth, np.nan).astype(np.float32, copy=False)
