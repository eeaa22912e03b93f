"""Which beam counts and angles are plausible for a scanner."""

from math import inf, nan, pi, radians, tau

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.sensors import LaserScan
from fusion_core.model.sweep import MAX_BEAMS, ImplausibleSweep, require_plausible_sweep

# Beams, first angle and step of scanners, some of them as recordings have them.
SCANNERS = {
    "Hokuyo URG-04LX": (681, -2.086214, 0.00613592),
    "Hokuyo UTM-30LX": (1081, radians(-135), radians(0.25)),
    "SICK LMS 200": (361, -pi / 2, 0.00872665),
    "SICK NAV, clockwise from zero": (1440, 0.0, -0.00436332),
    "RPLIDAR, which ends where it begins": (360, -pi, tau / 359),
    "a full turn and a step": (362, 0.0, radians(1.0)),
    "a step rounded to two digits": (1440, 0.0, 0.0044),
    "R2000, the finest": (25_200, -pi, tau / 25_200),
    "angles from -360 degrees": (720, -tau, radians(0.5)),
    "a rangefinder": (1, 0.0, 0.01),
}


def scan_of(beams: int, angle_min_rad: float, angle_increment_rad: float) -> LaserScan:
    return LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=angle_min_rad,
        angle_increment_rad=angle_increment_rad,
        range_min_m=0.1,
        range_max_m=10.0,
        ranges_m=np.ones(beams),
    )


@pytest.mark.parametrize("sweep", SCANNERS.values(), ids=SCANNERS.keys())
def test_real_scanners_sweeps_are_accepted(sweep: tuple[int, float, float]) -> None:
    assert scan_of(*sweep).angles_rad.size == sweep[0]


@pytest.mark.parametrize(
    ("sweep", "named"),
    [
        ((0, 0.0, 0.01), "no ranges"),
        ((MAX_BEAMS + 1, 0.0, 1e-5), f"claims {MAX_BEAMS + 1} beams"),
        ((360, -pi, 100.0), "angle_increment 100 rad over 360 beams spans 5714 turns"),
        ((360, -180.0, 1.0), "angle_increment 1 rad over 360 beams spans 57.14 turns"),
        ((720, -pi, radians(1.0)), "spans 1.997 turns"),
        ((1, 0.0, 7.0), "angle_increment 7 rad over 1 beams"),
        ((360, 0.0, 0.0), "angle_increment 0.0 give no angles"),
        ((360, 0.0, nan), "angle_increment nan"),
        ((360, 0.0, -inf), "angle_increment -inf"),
        ((360, 0.0, 5e-324), "finer than any scanner's"),
        ((360, nan, 0.01), "angle_min nan"),
        ((360, 1e30, 0.01), r"angle_min 1e\+30 rad is beyond a turn"),
    ],
)
def test_implausible_sweeps_are_named(sweep: tuple[int, float, float], named: str) -> None:
    with pytest.raises(ImplausibleSweep, match=named) as caught:
        scan_of(*sweep)
    assert caught.value.advice


@given(st.integers(-5, 2 * MAX_BEAMS), st.floats(), st.floats())
def test_accepted_sweeps_are_bounded(beams: int, first_rad: float, step_rad: float) -> None:
    try:
        require_plausible_sweep(beams, first_rad, step_rad)
    except ImplausibleSweep:
        return
    assert 1 <= beams <= MAX_BEAMS
    assert 0.0 < abs(step_rad) <= 1.1 * tau
    assert (beams - 1) * abs(step_rad) <= 1.1 * tau
    assert abs(first_rad) <= 1.1 * tau
