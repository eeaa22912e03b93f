"""Segments of a sweep: against walls whose place is known."""

import numpy as np
import pytest

from fusion_core.calibration.board.laser_segments import find_segments

ANGLES = np.radians(np.arange(-90.0, 90.0, 0.5))


def wall(normal_deg, distance_m):
    """(N,) ranges of a wall, inf where a beam does not meet it."""
    along = np.cos(ANGLES - np.radians(normal_deg))
    return np.where(along > 1e-3, distance_m / np.maximum(along, 1e-3), np.inf)


def test_a_wall_is_one_segment_on_its_line():
    ranges = np.where(np.abs(ANGLES) < 0.4, wall(20.0, 2.0), np.nan)
    (segment,) = find_segments(ranges, ANGLES)
    normal = np.array([np.cos(np.radians(20.0)), np.sin(np.radians(20.0))])
    np.testing.assert_allclose(segment.ends_m @ normal, 2.0, atol=1e-9)
    assert abs(segment.normal @ normal) == pytest.approx(1.0)
    assert segment.count == np.isfinite(ranges).sum() - 2


def test_a_corner_and_a_gap_part_segments():
    corner = np.minimum(wall(45.0, 2.0), wall(-45.0, 2.0))
    assert len(find_segments(corner, ANGLES)) == 2
    before = np.where(np.abs(ANGLES) < 0.2, 1.5, np.nan) / np.cos(ANGLES)
    scene = np.where(np.isfinite(before), before, wall(0.0, 3.0))
    found = find_segments(scene, ANGLES)
    assert len(found) == 3
    assert sorted(round(float(one.ends_m[:, 0].mean()), 6) for one in found) == [1.5, 3.0, 3.0]


def test_turning_the_sensor_turns_the_segments():
    rng = np.random.default_rng(0)
    ranges = wall(10.0, 1.7) + rng.normal(0.0, 0.01, ANGLES.size)
    ranges[np.abs(ANGLES) > 0.5] = np.nan
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    (one,), (other,) = find_segments(ranges, ANGLES), find_segments(ranges, ANGLES + 0.3)
    ends = one.ends_m @ turn.T
    assert (
        np.abs(other.ends_m - ends).max() < 1e-9 or np.abs(other.ends_m[::-1] - ends).max() < 1e-9
    )
    assert one.sd_m == pytest.approx(other.sd_m)


def test_the_deviation_is_what_noise_does():
    rng = np.random.default_rng(1)
    inside = np.abs(ANGLES) < 0.4
    errors = []
    for _ in range(200):
        ranges = np.where(inside, wall(0.0, 2.0), np.nan) + rng.normal(0.0, 0.01, ANGLES.size)
        (segment,) = find_segments(ranges, ANGLES)
        errors.append((segment.ends_m[:, 0] - 2.0) / segment.sd_m)
    assert 0.9 < np.sqrt(np.mean(np.square(errors))) < 1.2
    # The errors of the two ends are independent.
    assert abs(np.mean(np.prod(errors, axis=1))) < 0.25


@pytest.mark.parametrize("ranges", [np.full(ANGLES.size, np.nan), np.full(ANGLES.size, 1e-6)])
def test_a_sweep_without_walls_has_no_segments(ranges):
    assert find_segments(ranges, ANGLES) == []
