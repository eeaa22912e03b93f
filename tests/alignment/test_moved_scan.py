"""Scans seen from another place: against the closed form of a room, and of things on their own."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.moved_scan import move_scan
from fusion_core.model.sensors import LaserScan
from tests.alignment.polygon_room import scan_at

SAME_M = 0.15
BEAMS = 200
STEP_RAD = 0.01


def scan_of(ranges_m):
    """BEAMS beams about straight ahead, of which 100 looks at 0.005 rad."""
    return LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=-0.5 * (BEAMS - 1) * STEP_RAD,
        angle_increment_rad=STEP_RAD,
        range_min_m=0.05,
        range_max_m=30.0,
        ranges_m=np.array(ranges_m, dtype=np.float64),
    )


def mirrored(scan):
    """The same scan with its beams counted from the other end."""
    return replace(
        scan,
        angle_min_rad=scan.angle_min_rad + (scan.ranges_m.size - 1) * scan.angle_increment_rad,
        angle_increment_rad=-scan.angle_increment_rad,
        ranges_m=scan.ranges_m[::-1],
    )


@given(
    x=st.floats(-0.2, 0.2),
    y=st.floats(-0.2, 0.2),
    turned=st.floats(-3.0, 3.0),
    beams=st.sampled_from([480, 720]),
)
def test_a_room_looks_as_it_does_from_there(x, y, turned, beams):
    scan = scan_at(0.4, beams=beams)
    c, s = np.cos(0.4), np.sin(0.4)
    there = {"x": 2.6 + c * x - s * y, "y": 1.9 + s * x + c * y}
    moved = move_scan(scan, np.array([x, y, turned]), SAME_M)
    true_m = scan_at(0.4 + turned, beams=beams, **there).ranges_m
    np.testing.assert_array_equal(moved.looked, np.isfinite(moved.ranges_m))
    off_m = np.abs(moved.ranges_m - true_m)[moved.looked]
    # Corners are cut by less than a beam's width.
    assert np.mean(off_m < 0.003) > 0.95
    assert off_m.max() < 0.1
    # Beyond the ends of the scan nothing is known; a full circle has none.
    share = 1.0 if beams == 720 else 1.0 - np.ceil(abs(turned) / np.deg2rad(0.5) + 50) / beams
    assert moved.looked.mean() >= share
    other_way = move_scan(mirrored(scan), np.array([x, y, turned]), SAME_M)
    np.testing.assert_allclose(other_way.ranges_m[::-1], moved.ranges_m, atol=1e-9)


@given(seed=st.integers(0, 1_000), beams=st.integers(-20, 20))
def test_a_turn_by_whole_beams_counts_them_anew(seed, beams):
    rng = np.random.default_rng(seed)
    ranges_m = rng.uniform(0.5, 5.0, BEAMS)
    ranges_m[rng.random(BEAMS) < 0.3] = np.nan
    moved = move_scan(scan_of(ranges_m), np.array([0.0, 0.0, beams * STEP_RAD]), 0.0)
    expected = np.full(BEAMS, np.nan)
    old = np.arange(BEAMS) + beams
    inside = (old >= 0) & (old < BEAMS)
    expected[inside] = ranges_m[old[inside]]
    np.testing.assert_allclose(moved.ranges_m, expected, rtol=1e-12)
    np.testing.assert_array_equal(moved.looked, inside)


def test_what_a_return_hid_is_not_known():
    """A post at 1 m before a wall at 3 m: from 20 cm to the left, it stands before another part of
    the wall, and the part that it hid is bare."""
    wall_m = 3.0 / np.cos(scan_of(np.zeros(BEAMS)).angles_rad)
    ranges_m = wall_m.copy()
    ranges_m[90:110] = wall_m[90:110] / 3.0
    moved = move_scan(scan_of(ranges_m), np.array([0.0, 0.2, 0.0]), SAME_M)
    half_m = np.tan(9.5 * STEP_RAD)

    def beam_at(left_m, away_m):
        return 99.5 + np.arctan((left_m - 0.2) / away_m) / STEP_RAD

    post = np.flatnonzero(moved.ranges_m < 1.5)
    assert abs(post[0] - beam_at(-half_m, 1.0)) <= 1.0
    assert abs(post[-1] - beam_at(half_m, 1.0)) <= 1.0
    np.testing.assert_array_equal(post, np.arange(post[0], post[-1] + 1))
    bare = np.flatnonzero(~moved.looked & (np.abs(np.arange(BEAMS) - 99.5) < 60.0))
    np.testing.assert_array_equal(bare, np.arange(post[-1] + 1, bare[-1] + 1))
    assert abs(bare[-1] - beam_at(3.0 * half_m, 3.0)) <= 1.5
    np.testing.assert_array_equal(moved.looked, np.isfinite(moved.ranges_m))
    seen = np.isfinite(moved.ranges_m) & (moved.ranges_m > 1.5)
    # A scan ends with a return for half a beam.
    np.testing.assert_allclose(moved.ranges_m[seen], wall_m[seen], atol=0.005)


def test_a_lost_beam_looked_where_those_beside_it_did():
    ranges_m = np.full(BEAMS, 2.0)
    ranges_m[50:60] = np.nan
    moved = move_scan(scan_of(ranges_m), np.array([0.0, 0.0, 5.3 * STEP_RAD]), SAME_M)
    lost = np.flatnonzero(moved.looked & np.isnan(moved.ranges_m))
    # Those on either side now look at 43.7 and 54.7.
    np.testing.assert_array_equal(lost, np.arange(45, 55))
    assert not moved.looked[-5:].any()


def test_a_scan_without_a_return_tells_nothing():
    moved = move_scan(scan_of(np.full(BEAMS, np.nan)), np.zeros(3), SAME_M)
    assert np.isnan(moved.ranges_m).all()
    assert not moved.looked.any()


@pytest.mark.parametrize("near_beam", [120, 80])
def test_of_two_in_one_direction_the_nearer_is_seen(near_beam):
    """A post at 1 m before one at 2 m, once the LiDAR has moved to the line through both."""
    ranges_m = np.full(BEAMS, np.nan)
    azimuth_rad = scan_of(ranges_m).angles_rad
    far_beam = 99 if near_beam == 120 else 100
    ranges_m[near_beam], ranges_m[far_beam] = 1.0, 2.0
    near, far = (
        ranges_m[beam] * np.array([np.cos(azimuth_rad[beam]), np.sin(azimuth_rad[beam])])
        for beam in (near_beam, far_beam)
    )
    along = (far - near) / np.linalg.norm(far - near)
    # Beam 100 looks along the line, to 0.3 of a beam.
    heading_rad = np.arctan2(along[1], along[0]) - 0.2 * STEP_RAD
    pose = np.append(near - 0.8 * along, heading_rad)
    moved = move_scan(scan_of(ranges_m), pose, SAME_M)
    found = np.flatnonzero(np.isfinite(moved.ranges_m))
    assert found.tolist() == [100]
    assert moved.ranges_m[100] == pytest.approx(0.8)
