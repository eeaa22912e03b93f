"""The LiDAR's motion from its scans, in a room whose ranges have a closed form."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.alignment.scan_motion import (
    estimate_motion,
    motion_between,
    neighbour_seen_from,
)
from fusion_core.alignment.time import ScanWindow, TimeSettings
from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.planar_poses import compose_poses, pose_after
from fusion_core.model.sensors import LaserScan
from tests.alignment.polygon_room import PERIOD_NS, scan_at, turning

SETTINGS = TimeSettings()


def turn_rate_rad_s(window: ScanWindow) -> float:
    motion = estimate_motion(window, SETTINGS)
    assert motion is not None
    return motion.turn_rate_rad_s


def driving(velocity: tuple[float, float, float], **values: float) -> ScanWindow:
    """Three scans of a LiDAR that turns and drives at a constant velocity in its own frame."""
    start = np.array([2.6, 1.9, 0.4])
    scans = []
    for k in range(3):
        x, y, yaw = compose_poses(start, pose_after(np.array(velocity), 0.1 * k))
        scans.append(scan_at(yaw, k * PERIOD_NS, x=x, y=y, **({"seed": k} | values)))
    return ScanWindow(before=scans[0], scan=scans[1], after=scans[2])


@pytest.mark.parametrize("increment_deg", [0.5, -0.5, 0.25])
@pytest.mark.parametrize("turn_rad_s", [-1.3, 0.0, 0.05, 0.6])
@pytest.mark.parametrize("drive_m_s", [(0.0, 0.0), (0.7, 0.0), (-0.3, 0.2)])
def test_the_motion_is_that_of_the_lidar(
    drive_m_s: tuple[float, float], turn_rad_s: float, increment_deg: float
) -> None:
    beams = round(240 / abs(increment_deg))
    velocity = (*drive_m_s, turn_rad_s)
    found = estimate_motion(driving(velocity, increment_deg=increment_deg, beams=beams), SETTINGS)
    np.testing.assert_allclose(found.velocity, velocity, atol=0.01)


@pytest.mark.parametrize("which", ["before", "after"])
def test_a_neighbour_in_time_is_seen_from_the_place_of_the_scan(which: str) -> None:
    """Of a LiDAR that turns and drives: its neighbours show what it sees itself."""
    window = driving((0.8, 0.1, 0.5))
    motion = estimate_motion(window, SETTINGS)
    seen = neighbour_seen_from(window.scan, getattr(window, which), motion, SETTINGS)
    off_m = np.abs(seen.ranges_m - window.scan.ranges_m)[seen.looked]
    assert seen.looked.mean() > 0.95
    assert np.mean(off_m < 0.005) > 0.95
    standing_m = np.abs(getattr(window, which).ranges_m - window.scan.ranges_m)
    assert np.mean(standing_m < 0.005) < 0.1


def test_a_neighbour_whose_motion_is_not_known_tells_nothing() -> None:
    window = driving((0.8, 0.1, 0.5))
    motion = estimate_motion(window, SETTINGS)
    fewer = window.before.with_ranges(window.before.ranges_m[:-1], None)
    wider = replace(window.before, angle_increment_rad=1.01 * window.before.angle_increment_rad)
    cases = {
        "no neighbour": (None, motion),
        "motion not known": (window.before, None),
        "fewer beams": (fewer, motion),
        "other beams": (wider, motion),
    }
    for name, (neighbour, known) in cases.items():
        assert neighbour_seen_from(window.scan, neighbour, known, SETTINGS) is None, name


def test_the_doubt_of_the_turn_rate_is_that_of_noise() -> None:
    """Of two scans, over seeds."""
    errors = []
    for seed in range(0, 120, 3):
        window = driving((0.4, 0.0, 0.3), noise_m=0.02, holes=0.1, seed=seed)
        before = scan_at(0.4, 0, x=2.6, noise_m=0.02, holes=0.1, seed=seed + 1)
        found = motion_between(before, replace(window.scan), SETTINGS)
        errors.append((found.turn_rate_rad_s - 0.3) / found.turn_rate_sd_rad_s)
    # 95 % of chi^2 of 40 degrees of freedom.
    assert 0.61 < np.mean(np.square(errors)) < 1.48


@pytest.mark.parametrize("moving_m", [0.3, 1.5])
def test_who_walks_by_does_not_move_the_lidar(moving_m: float) -> None:
    """A tenth of the beams meet somebody who comes nearer at 1 m/s."""
    velocity = (0.3, 0.0, 0.2)
    window = driving(velocity, noise_m=0.01)
    scans = []
    for k, scan in enumerate((window.before, window.scan, window.after)):
        ranges_m = scan.ranges_m.copy()
        ranges_m[200:248] = moving_m - 0.1 * k + 0.3
        scans.append(scan.with_ranges(ranges_m, None))
    found = estimate_motion(ScanWindow(before=scans[0], scan=scans[1], after=scans[2]), SETTINGS)
    np.testing.assert_allclose(found.velocity, velocity, atol=0.05)


@pytest.mark.parametrize("noise_m", [0.0, 0.01])
def test_a_drive_along_a_corridor_is_not_seen(noise_m: float) -> None:
    """Across it and in its turn the LiDAR's motion is known; along it none is made up."""
    angles = scan_at(0.0).angles_rad
    rng = np.random.default_rng(1)
    scans = []
    for k in range(3):
        yaw, y = 0.03 * k, 0.02 * k
        side = np.sin(yaw + angles)
        with np.errstate(divide="ignore"):
            ranges_m = np.where(side > 0.0, (1.2 - y) / side, (-0.8 - y) / side)
        ranges_m += noise_m * rng.normal(size=angles.size)
        ranges_m[ranges_m > 6.0] = np.nan
        scans.append(scan_at(0.0, k * PERIOD_NS).with_ranges(ranges_m, None))
    found = estimate_motion(ScanWindow(before=scans[0], scan=scans[1], after=scans[2]), SETTINGS)
    assert found.velocity[0] == pytest.approx(0.0, abs=0.1)
    np.testing.assert_allclose(found.velocity[1:], [0.2, 0.3], atol=0.03)


@pytest.mark.parametrize("increment_deg", [0.5, -0.5, 0.25])
@pytest.mark.parametrize("rate_rad_s", [-1.3, -0.4, -0.05, 0.0, 0.05, 0.4, 1.3])
def test_turn_rate_is_that_of_the_lidar(rate_rad_s: float, increment_deg: float) -> None:
    beams = round(240 / abs(increment_deg))
    window = turning(rate_rad_s, increment_deg=increment_deg, beams=beams)
    # A tenth of a beam within a scan period.
    tolerance = 0.1 * np.deg2rad(0.5) * NS_PER_S / PERIOD_NS
    assert turn_rate_rad_s(window) == pytest.approx(rate_rad_s, abs=tolerance)


@pytest.mark.parametrize("rate_rad_s", [-0.7, 0.25, 0.7])
def test_turn_rate_is_robust_to_noise_and_holes(rate_rad_s: float) -> None:
    window = turning(rate_rad_s, noise_m=0.02, holes=0.15)
    assert turn_rate_rad_s(window) == pytest.approx(rate_rad_s, abs=0.04)


def test_counter_clockwise_turns_are_positive() -> None:
    left = ScanWindow(before=None, scan=scan_at(0.0, 0), after=scan_at(0.05, PERIOD_NS))
    right = ScanWindow(before=scan_at(0.05, 0), scan=scan_at(0.0, PERIOD_NS), after=None)
    assert turn_rate_rad_s(left) == pytest.approx(0.5, abs=0.02)
    assert turn_rate_rad_s(right) == pytest.approx(-0.5, abs=0.02)


def test_turn_rate_is_the_mean_over_both_neighbours() -> None:
    before, scan, after = scan_at(0.0, 0), scan_at(0.02, PERIOD_NS), scan_at(0.08, 2 * PERIOD_NS)
    both = turn_rate_rad_s(ScanWindow(before=before, scan=scan, after=after))
    halves = [
        turn_rate_rad_s(ScanWindow(before=before, scan=scan, after=None)),
        turn_rate_rad_s(ScanWindow(before=None, scan=scan, after=after)),
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
        assert estimate_motion(window, SETTINGS) is None, name


def test_turn_rate_of_a_full_circle_uses_all_of_it() -> None:
    """A wall that leaves the array at one end comes in at the other."""
    window = turning(0.7, increment_deg=0.5, beams=720)
    rolled = ScanWindow(
        before=None,
        scan=window.scan.with_ranges(np.roll(window.scan.ranges_m, 311), None),
        after=window.after.with_ranges(np.roll(window.after.ranges_m, 311), None),
    )
    rate = turn_rate_rad_s(replace(window, before=None))
    assert rate == pytest.approx(0.7, abs=0.02)
    assert turn_rate_rad_s(rolled) == pytest.approx(rate, abs=1e-9)
