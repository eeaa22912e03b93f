"""The jump tables against a search through all points."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.registration.polar_correspondence import find_nearest, make_polar_scan


@given(seed=st.integers(0, 2**32 - 1))
def test_the_jump_tables_find_the_nearest_point(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 120))
    fraction = rng.choice([1.0, rng.uniform(0.02, 1.0)])
    step = fraction * 2.0 * np.pi / count * rng.choice([-1.0, 1.0])
    # Few distinct ranges make ties, many make jumps.
    ranges = rng.choice(rng.uniform(0.2, 5.0, int(rng.integers(1, 40))), count)
    ranges[rng.random(count) < rng.uniform(0.0, 0.7)] = rng.choice([np.nan, np.inf, 0.0, -1.0])
    start = float(rng.uniform(-7.0, 7.0))
    scan = make_polar_scan(ranges, start, step)
    valid = np.flatnonzero(np.isfinite(ranges) & (ranges > 0.0))
    assert sorted(scan.beam) == list(valid)
    angles = start + step * scan.beam
    points = ranges[scan.beam, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    np.testing.assert_allclose(
        scan.range_m[:, None] * np.stack([scan.cos, scan.sin], axis=1), points, atol=1e-12
    )
    # Places beside points, those at the seam of the circle among them.
    near = points[rng.integers(-3, 4, 40) % len(points)] if len(points) else np.empty((0, 2))
    near = near + rng.normal(0.0, 0.1, near.shape)
    for place in np.vstack([rng.normal(0.0, 3.0, (20, 2)), near]):
        squared = ((points - place) ** 2).sum(axis=1)
        limit = float(rng.choice([0.5, 4.0, 1e3]))
        found, distance = find_nearest(scan, place[0], place[1], limit)
        if squared.size == 0 or squared.min() >= limit:
            assert found == -1
        else:
            assert squared[found] == pytest.approx(squared.min(), abs=1e-12)
            assert distance == pytest.approx(squared.min(), abs=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_beams_past_a_full_turn_are_left_out(sign):
    """A driver that rounds the increment up reports a turn of more than 360 degrees."""
    beams = 370
    ranges = np.linspace(1.0, 2.0, beams)
    scan = make_polar_scan(ranges, -np.pi, sign * np.radians(1.0))
    assert sorted(scan.beam) == list(range(361))
    angles = -np.pi + sign * np.radians(1.0) * scan.beam
    np.testing.assert_allclose(scan.cos, np.cos(angles), atol=1e-12)
    np.testing.assert_allclose(scan.range_m, ranges[scan.beam])


@pytest.mark.parametrize(
    ("shape", "start", "step", "text"),
    [
        ((3, 3), 0.0, 0.1, r"must be \(N,\)"),
        ((10,), 0.0, 0.0, "non-zero"),
        ((10,), np.nan, 0.1, "finite"),
        ((10,), 0.0, 1.0, "exceed a full turn"),
    ],
)
def test_what_is_no_sweep_is_refused(shape, start, step, text):
    with pytest.raises(ValueError, match=text):
        make_polar_scan(np.ones(shape), start, step)
