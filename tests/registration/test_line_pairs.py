"""Which points are paired with which lines, how they weigh, and what is dropped."""

import numpy as np
import pytest

from fusion_core.registration.line_pairs import (
    drop_duplicates,
    find_pairs,
    make_empty_pairs,
    trim_pairs,
)
from fusion_core.registration.local_lines import fit_local_lines
from fusion_core.registration.polar_correspondence import make_polar_scan
from tests.benchmarks.scan_matching_room import cast

SIGMA_M = 0.01
# A wall from (2, -1) to (2, 1): seen within ± 0.46 rad.
WALL = np.array([[[2.0, -1.0], [2.0, 1.0]]])


def scan_of(beams, half_view_rad, pose=(0.0, 0.0, 0.0), walls=WALL):
    step = 2.0 * half_view_rad / (beams - 1)
    angles = -half_view_rad + step * np.arange(beams)
    ranges = cast(walls, np.asarray(pose, dtype=float), angles)[0]
    return make_polar_scan(ranges, -half_view_rad, step)


def paired(reference, moving, pose=(0.0, 0.0, 0.0), sigmas_m=(SIGMA_M, SIGMA_M), distance_m=0.3):
    pairs = make_empty_pairs(moving.range_m.size)
    lines = fit_local_lines(reference, sigmas_m[0])
    find_pairs(pairs, reference, lines, moving, np.array(pose), sigmas_m, distance_m, 1)
    return pairs


def points(scan, pose=(0.0, 0.0, 0.0)):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    own = scan.range_m[:, None] * np.stack([scan.cos, scan.sin], axis=1)
    return own @ np.array([[c, s], [-s, c]]) + pose[:2]


def test_the_residual_is_the_distance_from_the_wall():
    pose = np.array([0.05, 0.1, 0.02])
    reference, moving = scan_of(200, 0.4), scan_of(300, 0.3)
    pairs = paired(reference, moving, pose)
    used = pairs.partner >= 0
    assert used.mean() > 0.9
    np.testing.assert_allclose(
        pairs.residual_m[used], points(moving, pose)[used, 0] - 2.0, atol=1e-9
    )


def test_a_point_past_the_end_of_a_line_stays_unpaired():
    """The reference saw half of the wall; what the other saw beyond is no part of it."""
    reference, moving = scan_of(100, 0.2), scan_of(200, 0.4)
    pairs = paired(reference, moving)
    place = points(moving)[:, 1]
    end = points(reference)[:, 1].max()
    spacing = np.diff(points(reference)[:, 1]).max()
    assert (pairs.partner[np.abs(place) > end + 0.6 * spacing] == -1).all()
    assert (pairs.partner[np.abs(place) < end] >= 0).all()


def test_a_point_far_from_the_wall_stays_unpaired():
    reference, moving = scan_of(100, 0.4), scan_of(100, 0.3)
    assert (paired(reference, moving, (0.2, 0.0, 0.0), distance_m=0.3).partner >= 0).all()
    assert (paired(reference, moving, (0.4, 0.0, 0.0), distance_m=0.3).partner == -1).all()


@pytest.mark.parametrize(("first", "second"), [(200, 200), (200, 50), (50, 200)])
@pytest.mark.parametrize("sigmas_m", [(0.01, 0.01), (0.01, 0.03)])
def test_all_pairs_weigh_as_much_as_two_line_fits_of_a_wall(first, second, sigmas_m):
    """The sides' means differ by σ₁²/K + σ₂²/N, so the pairs weigh its inverse together."""
    pairs = paired(scan_of(first, 0.1), scan_of(second, 0.1), sigmas_m=sigmas_m)
    assert (pairs.partner >= 0).all()
    together = 1.0 / (sigmas_m[0] ** 2 / first + sigmas_m[1] ** 2 / second)
    assert pairs.weight_per_m2.sum() == pytest.approx(together, rel=0.02)


def test_the_variance_is_that_of_many_draws():
    rng = np.random.default_rng(1)
    half_view = 0.3
    clean = scan_of(60, half_view)
    step = 2.0 * half_view / 59
    residuals, variances = [], []
    for _ in range(400):
        scans = [
            make_polar_scan(clean.range_m + rng.normal(0.0, SIGMA_M, 60), -half_view, step)
            for _ in range(2)
        ]
        pairs = paired(*scans)
        used = pairs.partner >= 0
        residuals.append(np.where(used, pairs.residual_m, np.nan))
        variances.append(np.where(used, pairs.variance_m2, np.nan))
    drawn, stated = np.nanvar(residuals), np.nanmean(variances)
    assert drawn == pytest.approx(stated, rel=0.05)


def test_of_duplicates_the_nearest_stays():
    rng = np.random.default_rng(2)
    pairs = make_empty_pairs(60)
    pairs.partner[:] = rng.integers(-1, 12, 60)
    pairs.residual_m[:] = rng.normal(0.0, 1.0, 60)
    before = pairs.partner.copy()
    drop_duplicates(pairs, 12, 1)
    for j in range(12):
        sharing = np.flatnonzero(before == j)
        left = np.flatnonzero(pairs.partner == j)
        best = sharing[np.abs(pairs.residual_m[sharing]).argmin()]
        assert list(left) == [best]


def test_trimming_follows_the_robust_scale_and_falls_slowly():
    rng = np.random.default_rng(3)
    pairs = make_empty_pairs(1000)
    pairs.partner[:] = 0
    pairs.residual_m[:] = rng.normal(0.0, 2.0, 1000)
    pairs.residual_m[:100] = 1000.0
    size = np.abs(pairs.residual_m)
    left, limit, scale = trim_pairs(pairs, 3.0, 40.0, 1)
    assert scale == pytest.approx(np.median(size) * 1.4826, rel=1e-3)
    # 10, a quarter of the last limit, is more than three robust deviations.
    assert limit == 10.0
    assert left == (size <= 10.0).sum()
    left, limit, scale = trim_pairs(pairs, 3.0, limit, 1)
    assert limit == pytest.approx(3.0 * scale)
    assert left == (size <= limit).sum()
    np.testing.assert_array_equal(pairs.partner >= 0, size <= limit)
