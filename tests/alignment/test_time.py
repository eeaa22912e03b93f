"""The turn rate of a LiDAR in polygon rooms whose ranges have a closed form."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.time import (
    ScanWindow,
    TimeSettings,
    estimate_turn_rate_rad_s,
    parabola_offset,
)
from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.sensors import LaserScan

PERIOD_NS = 100_000_000
SETTINGS = TimeSettings()
# A room with two oblique walls and a bay, counter-clockwise, in metres.
ROOM = np.array([[0, 0], [6, 0], [6, 2.5], [4.8, 3], [4.8, 4.2], [1.5, 4.2], [0, 3]], dtype=float)


def range_to_walls_m(x: float, y: float, azimuths: np.ndarray) -> np.ndarray:
    """Nearest crossing of each ray with the polygon's sides, by Cramer's rule."""
    nearest = np.full(azimuths.shape, np.inf)
    dx, dy = np.cos(azimuths), np.sin(azimuths)
    for (ax, ay), (bx, by) in zip(ROOM, np.roll(ROOM, -1, axis=0), strict=True):
        ex, ey = bx - ax, by - ay
        det = dy * ex - dx * ey
        with np.errstate(divide="ignore", invalid="ignore"):
            length = ((ay - y) * ex - (ax - x) * ey) / det
            fraction = (dx * (ay - y) - dy * (ax - x)) / det
        hit = (length > 0.0) & (fraction >= 0.0) & (fraction <= 1.0)
        nearest = np.where(hit & (length < nearest), length, nearest)
    return nearest


def scan_at(
    yaw: float,
    stamp_ns: int = 0,
    *,
    increment_deg: float = 0.5,
    beams: int = 480,
    noise_m: float = 0.0,
    holes: float = 0.0,
    seed: int = 0,
) -> LaserScan:
    increment = float(np.deg2rad(increment_deg))
    first = -0.5 * (beams - 1) * increment
    ranges_m = range_to_walls_m(2.6, 1.9, yaw + first + increment * np.arange(beams))
    rng = np.random.default_rng(seed)
    ranges_m = ranges_m + noise_m * rng.normal(size=beams)
    ranges_m[rng.random(beams) < holes] = np.nan
    return LaserScan(
        stamp_ns=stamp_ns,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=first,
        angle_increment_rad=increment,
        range_min_m=0.05,
        range_max_m=30.0,
        ranges_m=ranges_m,
    )


def turning(rate_rad_s: float, **values: float) -> ScanWindow:
    """Three scans of a LiDAR that turns at a constant rate."""
    step_rad = rate_rad_s * PERIOD_NS / NS_PER_S
    before, scan, after = (
        scan_at(0.4 + k * step_rad, k * PERIOD_NS, seed=k, **values) for k in range(3)
    )
    return ScanWindow(before=before, scan=scan, after=after)


@pytest.mark.parametrize("increment_deg", [0.5, -0.5, 0.25])
@pytest.mark.parametrize("rate_rad_s", [-1.3, -0.4, -0.05, 0.0, 0.05, 0.4, 1.3])
def test_turn_rate_is_that_of_the_lidar(rate_rad_s: float, increment_deg: float) -> None:
    beams = round(240 / abs(increment_deg))
    window = turning(rate_rad_s, increment_deg=increment_deg, beams=beams)
    # A tenth of a beam within a scan period.
    tolerance = 0.1 * np.deg2rad(0.5) * NS_PER_S / PERIOD_NS
    assert estimate_turn_rate_rad_s(window, SETTINGS) == pytest.approx(rate_rad_s, abs=tolerance)


@pytest.mark.parametrize("rate_rad_s", [-0.7, 0.25, 0.7])
def test_turn_rate_is_robust_to_noise_and_holes(rate_rad_s: float) -> None:
    window = turning(rate_rad_s, noise_m=0.02, holes=0.15)
    assert estimate_turn_rate_rad_s(window, SETTINGS) == pytest.approx(rate_rad_s, abs=0.04)


def test_counter_clockwise_turns_are_positive() -> None:
    left = ScanWindow(before=None, scan=scan_at(0.0, 0), after=scan_at(0.05, PERIOD_NS))
    right = ScanWindow(before=scan_at(0.05, 0), scan=scan_at(0.0, PERIOD_NS), after=None)
    assert estimate_turn_rate_rad_s(left, SETTINGS) == pytest.approx(0.5, abs=0.02)
    assert estimate_turn_rate_rad_s(right, SETTINGS) == pytest.approx(-0.5, abs=0.02)


def test_turn_rate_is_the_mean_over_both_neighbours() -> None:
    before, scan, after = scan_at(0.0, 0), scan_at(0.02, PERIOD_NS), scan_at(0.08, 2 * PERIOD_NS)
    both = estimate_turn_rate_rad_s(ScanWindow(before=before, scan=scan, after=after), SETTINGS)
    halves = [
        estimate_turn_rate_rad_s(ScanWindow(before=before, scan=scan, after=None), SETTINGS),
        estimate_turn_rate_rad_s(ScanWindow(before=None, scan=scan, after=after), SETTINGS),
    ]
    assert halves == pytest.approx([0.2, 0.6], abs=0.02)
    assert both == pytest.approx(np.mean(halves), abs=1e-12)


def test_unknown_without_a_neighbour_to_compare() -> None:
    scan = scan_at(0.0, PERIOD_NS)
    empty = LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=scan.angle_min_rad,
        angle_increment_rad=scan.angle_increment_rad,
        range_min_m=0.05,
        range_max_m=30.0,
        ranges_m=np.full(scan.ranges_m.size, np.nan),
    )
    neighbours = {
        "none": None,
        "no returns": empty,
        "same stamp": scan_at(0.0, PERIOD_NS),
        "a second away": scan_at(0.0, PERIOD_NS - NS_PER_S),
        "other beams": scan_at(0.0, 0, beams=479),
        "other increment": scan_at(0.0, 0, increment_deg=0.4),
    }
    for name, before in neighbours.items():
        window = ScanWindow(before=before, scan=scan, after=None)
        assert np.isnan(estimate_turn_rate_rad_s(window, SETTINGS)), name


@given(
    peak=st.floats(-0.49, 0.49), curvature=st.floats(0.01, 100.0), height=st.floats(-100.0, 100.0)
)
def test_parabola_offset_is_exact_on_parabolas(
    peak: float, curvature: float, height: float
) -> None:
    places = np.arange(5.0) - 2.0 - peak
    low = height + curvature * places**2
    assert parabola_offset(low, 2) == pytest.approx(peak, abs=1e-6)
    assert parabola_offset(-low, 2) == pytest.approx(peak, abs=1e-6)


@pytest.mark.parametrize(
    ("values", "best"),
    [
        ([3.0, 2.0, 1.0], 0),
        ([1.0, 2.0, 3.0], 2),
        ([np.nan, 2.0, 1.0], 1),
        ([1.0, 2.0, np.nan], 1),
        ([2.0, 2.0, 2.0], 1),
        ([1.0, 2.0, 4.0], 1),
        ([4.0, 2.0, 1.0], 1),
    ],
)
def test_parabola_offset_is_zero_where_there_is_no_parabola(values: list[float], best: int) -> None:
    assert parabola_offset(np.array(values), best) == 0.0
