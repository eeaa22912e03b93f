"""Lines of a sweep's neighbourhoods, and the noise estimated from it."""

import numpy as np
import pytest

from fusion_core.registration.local_lines import (
    RANGE_SIGMA_MAX_M,
    RANGE_SIGMA_MIN_M,
    estimate_range_sigma_m,
    fit_local_lines,
)
from fusion_core.registration.polar_correspondence import make_polar_scan
from tests.benchmarks.scan_matching_room import WALLS, cast, full_turn


def scan_of(pose, sigma_m=0.0, seed=0):
    first, step = full_turn(720)
    ranges = cast(WALLS, np.asarray(pose, dtype=float), first + step * np.arange(720))[0]
    noise = np.random.default_rng(seed).normal(0.0, 1.0, 720)
    return make_polar_scan(ranges + sigma_m * noise, first, step)


@pytest.mark.parametrize("sigma_m", [0.003, 0.01, 0.03])
def test_the_noise_is_estimated_from_the_sweep(sigma_m):
    estimates = [
        estimate_range_sigma_m(scan_of((4.0 + 0.1 * k, 4.0, 0.3), sigma_m, k)) for k in range(20)
    ]
    assert np.mean(estimates) == pytest.approx(sigma_m, rel=0.05)
    assert np.std(estimates) < 0.1 * sigma_m


def test_no_noise_and_clutter_keep_their_limits():
    assert estimate_range_sigma_m(scan_of((5.0, 4.0, 0.0))) == RANGE_SIGMA_MIN_M
    clutter = np.random.default_rng(1).uniform(0.5, 8.0, 720)
    assert estimate_range_sigma_m(make_polar_scan(clutter, *full_turn(720))) == RANGE_SIGMA_MAX_M
    every_other = np.where(np.arange(720) % 2, 3.0, np.nan)
    assert (
        estimate_range_sigma_m(make_polar_scan(every_other, *full_turn(720))) == RANGE_SIGMA_MIN_M
    )


def test_lines_lie_on_the_walls():
    scan = scan_of((5.0, 4.0, 0.0))
    lines = fit_local_lines(scan, 1e-5)
    point = scan.range_m[:, None] * np.stack([scan.cos, scan.sin], axis=1)
    normal = np.stack([lines.normal_x, lines.normal_y], axis=1)
    has = np.isfinite(lines.offset_m)
    assert has.mean() > 0.97
    # Through the beam's own point, along one of the room's walls, the normal off the sensor.
    np.testing.assert_allclose((normal * point).sum(axis=1)[has], lines.offset_m[has], atol=1e-4)
    along = WALLS[:, 1] - WALLS[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    assert np.abs(normal[has] @ along.T).min(axis=1).max() < 1e-3
    assert (lines.offset_m[has] > 0.0).all()


def test_a_line_is_the_least_squares_line_of_its_run():
    scan = scan_of((5.0, 4.0, 0.0), 0.01)
    lines = fit_local_lines(scan, 0.01)
    point = scan.range_m[:, None] * np.stack([scan.cos, scan.sin], axis=1)
    for k in np.flatnonzero(np.isfinite(lines.offset_m)):
        run = (lines.first[k] + np.arange(lines.beams[k])) % 720
        assert k in run
        centred = point[run] - point[run].mean(axis=0)
        spread, axes = np.linalg.eigh(centred.T @ centred)
        normal = np.array([lines.normal_x[k], lines.normal_y[k]])
        assert abs(normal @ axes[:, 0]) == pytest.approx(1.0, abs=1e-9)
        assert lines.offset_m[k] == pytest.approx(normal @ point[run].mean(axis=0), abs=1e-9)
        assert lines.spread_m2[k] == pytest.approx(spread[1], rel=1e-6)
        places = point[run] @ [-normal[1], normal[0]]
        assert lines.centre_m[k] == pytest.approx(places.mean(), abs=1e-9)
        assert (lines.low_m[k], lines.high_m[k]) == pytest.approx(
            (min(places[0], places[-1]), max(places[0], places[-1])), abs=1e-9
        )


def test_scattered_points_have_no_line():
    ranges = np.tile([2.0, 3.0, 5.0], 40)
    assert np.isnan(fit_local_lines(make_polar_scan(ranges, *full_turn(120)), 0.01).offset_m).all()
