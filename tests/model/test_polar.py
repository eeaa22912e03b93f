"""Beams as points, and directions as beams."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.polar import beams_towards, points_from_polar


@given(
    first_rad=st.floats(-np.pi, np.pi),
    step_deg=st.floats(0.2, 5.0),
    beams=st.integers(2, 60),
    is_clockwise=st.booleans(),
    azimuth_rad=st.floats(-10.0, 10.0),
)
def test_the_nearest_beam_is_that_of_a_search(
    first_rad: float, step_deg: float, beams: int, is_clockwise: bool, azimuth_rad: float
) -> None:
    step_rad = np.deg2rad(step_deg) * (-1.0 if is_clockwise else 1.0)
    away = np.angle(np.exp(1j * (azimuth_rad - first_rad - step_rad * np.arange(beams))))
    nearest = int(np.abs(away).argmin())
    off_rad = float(np.abs(away[nearest]))
    (found,) = beams_towards(np.array([azimuth_rad]), first_rad, step_rad, beams)
    # On the edge between two beams, rounding decides.
    if abs(off_rad - 0.5 * abs(step_rad)) > 1e-9:
        assert found == (nearest if off_rad < 0.5 * abs(step_rad) else -1)


def test_no_direction_has_no_beam() -> None:
    assert beams_towards(np.array([np.nan]), 0.0, 0.1, 10).tolist() == [-1]


def test_points_lie_at_their_range_and_azimuth() -> None:
    ranges_m, azimuths_rad = np.array([2.0, 1.0, np.nan]), np.array([0.0, 0.5 * np.pi, 0.0])
    points_m = points_from_polar(ranges_m, azimuths_rad)
    assert points_m[:2] == pytest.approx(np.array([[2.0, 0.0], [0.0, 1.0]]))
    assert np.isnan(points_m[2]).all()
