"""Beams of a scan as points of its plane, and directions as beams."""

from typing import TypeVar

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray

_Value = TypeVar("_Value", float, FloatArray)


def unwrap_towards(values: _Value, about: float, turn: float = 2.0 * np.pi) -> _Value:
    """Azimuths in radians, or other values of which ``turn`` make a circle, moved by whole turns to
    within half a turn of ``about``."""
    unwrapped: _Value = values - turn * np.rint((values - about) / turn)
    return unwrapped


def points_from_polar(ranges_m: FloatArray, azimuths_rad: FloatArray) -> FloatArray:
    """(N, 2) points at (N,) ranges and azimuths, NaN where either is."""
    return np.stack([ranges_m * np.cos(azimuths_rad), ranges_m * np.sin(azimuths_rad)], axis=1)


def beams_towards(
    azimuths_rad: FloatArray, first_rad: float, step_rad: float, beams: int
) -> IntArray:
    """(N,) the beam nearest to each azimuth, -1 outside the field of view and for NaN.

    Beam k points at ``first_rad`` + k ``step_rad``; there are ``beams`` of them.
    """
    # Half a beam before the first still belongs to it.
    from_edge_rad = np.mod(
        (azimuths_rad - first_rad) * np.sign(step_rad) + 0.5 * abs(step_rad), 2.0 * np.pi
    )
    beam = np.floor(from_edge_rad / abs(step_rad))
    # NaN compares false.
    return np.where(beam < beams, beam, -1.0).astype(np.int64)
