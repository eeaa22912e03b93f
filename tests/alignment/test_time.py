"""A LiDAR's turn rate and its interpolated scans, in rooms whose ranges have a closed form."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment import time
from fusion_core.alignment.time import (
    ScanWindow,
    TimeSettings,
    estimate_turn_rate_rad_s,
    parabola_offset,
    scan_at_image,
)
from fusion_core.model.conventions import NS_PER_MS, NS_PER_S
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
    x: float = 2.6,
) -> LaserScan:
    increment = float(np.deg2rad(increment_deg))
    first = -0.5 * (beams - 1) * increment
    ranges_m = range_to_walls_m(x, 1.9, yaw + first + increment * np.arange(beams))
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


def test_turn_rate_of_a_full_circle_uses_all_of_it() -> None:
    """A wall that leaves the array at one end comes in at the other."""
    window = turning(0.7, increment_deg=0.5, beams=720)
    rolled = ScanWindow(
        before=None,
        scan=window.scan.with_ranges(np.roll(window.scan.ranges_m, 311), None),
        after=window.after.with_ranges(np.roll(window.after.ranges_m, 311), None),
    )
    rate = estimate_turn_rate_rad_s(replace(window, before=None), SETTINGS)
    assert rate == pytest.approx(0.7, abs=0.02)
    assert estimate_turn_rate_rad_s(rolled, SETTINGS) == pytest.approx(rate, abs=1e-9)


INTERPOLATED = TimeSettings(pair_by="interpolated")


def driving_scan(seconds: float, rate_rad_s: float, **values: float) -> LaserScan:
    """A LiDAR that turns and drives at 0.5 m/s along the room, at an instant."""
    return scan_at(
        0.4 + rate_rad_s * seconds,
        round(seconds * NS_PER_S),
        x=2.2 + 0.5 * seconds,
        **values,
    )


def driving(rate_rad_s: float, **values: float) -> ScanWindow:
    before, scan, after = (driving_scan(0.1 * k, rate_rad_s, seed=k, **values) for k in range(3))
    return ScanWindow(before=before, scan=scan, after=after)


@pytest.mark.parametrize("beams", [480, 720])
@pytest.mark.parametrize("gap_ms", [-49, -30, -5, 5, 30, 49])
@pytest.mark.parametrize("rate_rad_s", [-0.8, 0.0, 0.4])
def test_an_interpolated_scan_is_that_of_its_instant(
    rate_rad_s: float, gap_ms: int, beams: int
) -> None:
    """Against the closed form of the room at that instant, and against the nearest scan."""
    window = driving(rate_rad_s, beams=beams)
    gap_ns = gap_ms * NS_PER_MS
    made = scan_at_image(window, gap_ns, INTERPOLATED)
    true_m = driving_scan(0.1 + gap_ms * 1e-3, rate_rad_s, beams=beams).ranges_m
    assert made.stamp_ns == window.scan.stamp_ns + gap_ns
    off_m = np.abs(made.ranges_m - true_m)
    nearest_m = np.abs(window.scan.ranges_m - true_m)
    # Corners are cut by less than a beam's width.
    assert np.nanmedian(off_m) < 0.003
    assert np.nanmean(off_m < 0.03) > 0.97
    if abs(gap_ms) >= 30:
        assert np.nanmean(off_m) < 0.4 * np.nanmean(nearest_m)
    # Beams that the turn brings in from beyond an end have no value.
    lost = round(abs(rate_rad_s * 0.1) / np.deg2rad(0.5)) + 1
    assert np.isnan(made.ranges_m).sum() <= (0 if beams == 720 else lost)


@pytest.mark.parametrize("gap_ms", [-40, 25])
def test_what_is_mixed_equals_a_loop_over_the_beams(gap_ms: int) -> None:
    """Of a LiDAR that stands still: means by time, except at edges and where one is missing."""
    rng = np.random.default_rng(8)
    window = turning(0.0)
    scans = []
    for scan in (window.before, window.scan, window.after):
        ranges_m = scan.ranges_m + 0.02 * rng.normal(size=480)
        ranges_m[rng.random(480) < 0.2] = np.nan
        moved = rng.random(480) < 0.1
        ranges_m[moved] -= 0.5
        scans.append(scan.with_ranges(ranges_m, None))
    window = ScanWindow(before=scans[0], scan=scans[1], after=scans[2])
    # A turn that is measured as none: the loop below knows of no turn.
    still = INTERPOLATED.model_copy(update={"max_turn_rate_rad_s": 1e-6})
    with patch.object(time, "_rate_between", lambda *_: 0.0):
        made = scan_at_image(window, gap_ms * NS_PER_MS, still).ranges_m
    own, other = scans[1].ranges_m, scans[0 if gap_ms < 0 else 2].ranges_m
    seen = set()
    for beam in range(480):
        if np.isnan(own[beam]) and np.isnan(other[beam]):
            seen.add("neither")
            assert np.isnan(made[beam])
        elif np.isnan(own[beam]):
            seen.add("other")
            assert made[beam] == other[beam]
        elif np.isnan(other[beam]) or abs(own[beam] - other[beam]) > 0.15:
            seen.add("own")
            assert made[beam] == own[beam]
        else:
            seen.add("mixed")
            late = abs(gap_ms) / 100.0
            assert made[beam] == pytest.approx((1.0 - late) * own[beam] + late * other[beam])
    assert seen == {"neither", "other", "own", "mixed"}


def test_nothing_is_mixed_across_an_edge() -> None:
    """Each range is one of the two surfaces', whatever the turn."""
    angles = scan_at(0.0).angles_rad
    scans = [
        scan_at(0.0, k * PERIOD_NS).with_ranges(
            np.where(np.sin(7.0 * (angles + 0.06 * k)) > 0.0, 1.0, 2.0), None
        )
        for k in range(3)
    ]
    window = ScanWindow(before=scans[0], scan=scans[1], after=scans[2])
    for gap_ms in (-45, -20, 20, 45):
        made = scan_at_image(window, gap_ms * NS_PER_MS, INTERPOLATED).ranges_m
        made = made[np.isfinite(made)]
        assert made.size > 450
        assert (np.isclose(made, 1.0) | np.isclose(made, 2.0)).all()


def test_the_paired_scan_is_kept_where_nothing_can_be_interpolated() -> None:
    window = driving(0.3)
    blind = window.after.with_ranges(np.full(480, np.nan), None)
    far = replace(window.after, stamp_ns=window.scan.stamp_ns + 130 * NS_PER_MS)
    gap_ns = 20 * NS_PER_MS
    cases = {
        "not asked for": (window, gap_ns, SETTINGS),
        "at its stamp": (window, 0, INTERPOLATED),
        "no scan after": (replace(window, after=None), gap_ns, INTERPOLATED),
        "no scan before": (replace(window, before=None), -gap_ns, INTERPOLATED),
        "no rate": (replace(window, after=blind), gap_ns, INTERPOLATED),
        "the next one lost": (replace(window, after=far), gap_ns, INTERPOLATED),
        "beyond the next": (window, 101 * NS_PER_MS, INTERPOLATED),
    }
    for name, (own, own_gap_ns, chosen) in cases.items():
        assert scan_at_image(own, own_gap_ns, chosen) is own.scan, name
    assert scan_at_image(window, gap_ns, INTERPOLATED) is not window.scan


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
