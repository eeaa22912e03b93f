"""Walls through neighbouring beams, against a polynomial fit and against the truth."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.denoising.surfaces import smooth_ranges

STEP_RAD = np.deg2rad(0.35)
ANGLES_RAD = np.arange(41) * STEP_RAD - 20 * STEP_RAD


def wall(distance_m: float, slant_rad: float = 0.0) -> np.ndarray:
    """Ranges at which the beams meet a straight wall; ``slant_rad`` turns its normal."""
    return distance_m / np.cos(ANGLES_RAD - slant_rad)


@given(distance_m=st.floats(0.5, 20.0), slant_rad=st.floats(-1.0, 1.0))
def test_a_wall_without_noise_stays_where_it_is(distance_m: float, slant_rad: float) -> None:
    ranges = wall(distance_m, slant_rad)
    smooth = smooth_ranges(ANGLES_RAD, ranges, np.full(41, 0.02))
    # The inverse range is a cosine; over five beams beside one it is a line to this.
    np.testing.assert_allclose(smooth.range_m, ranges, rtol=2e-3)


@given(seed=st.integers(0, 1000))
def test_on_one_wall_it_is_the_line_through_the_inverse_ranges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = wall(3.0, 0.4) + np.clip(rng.normal(0.0, 0.01, 41), -0.015, 0.015)
    ranges[rng.random(41) < 0.2] = np.nan
    smooth = smooth_ranges(ANGLES_RAD, ranges, np.full(41, 0.02))
    np.testing.assert_array_equal(np.isnan(smooth.range_m), np.isnan(ranges))
    for beam in np.flatnonzero(np.isfinite(ranges)):
        window = np.arange(max(0, beam - 5), min(41, beam + 6))
        window = window[np.isfinite(ranges[window])]
        if window.size < 3:
            assert smooth.range_m[beam] == ranges[beam]
            continue
        line = np.polynomial.polynomial.polyfit(
            ANGLES_RAD[window] - ANGLES_RAD[beam], 1.0 / ranges[window], 1
        )
        design = np.stack([np.ones(window.size), ANGLES_RAD[window] - ANGLES_RAD[beam]], axis=1)
        spread = np.sqrt(np.linalg.inv(design.T @ design)[0, 0])
        assert np.isclose(smooth.range_m[beam], 1.0 / line[0], rtol=1e-9)
        assert np.isclose(smooth.error_m[beam], 0.02 * spread, rtol=1e-6)


def test_noise_shrinks_on_a_wall_and_an_edge_stays_sharp() -> None:
    rng = np.random.default_rng(5)
    truth = np.where(np.arange(41) < 20, wall(2.0), wall(3.5))
    sigma = np.full(41, 0.02)
    before, after = [], []
    for _ in range(200):
        noisy = truth + rng.normal(0.0, 0.02, 41)
        before.append(noisy - truth)
        after.append(smooth_ranges(ANGLES_RAD, noisy, sigma).range_m - truth)
    assert np.std(after) < 0.6 * np.std(before)
    # The wall behind does not influence the one in front: no error is as large as the step.
    assert np.abs(after).max() < 0.1
