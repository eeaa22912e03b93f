"""The covariance against numerical derivatives by every range of both sweeps."""

import numpy as np
import pytest
from scipy.stats import truncnorm

from fusion_core.registration.line_pairs import find_pairs, make_empty_pairs
from fusion_core.registration.local_lines import fit_local_lines
from fusion_core.registration.match_covariance import match_covariance, trimmed_gaussian_variance
from fusion_core.registration.polar_correspondence import make_polar_scan
from tests.benchmarks.scan_matching_room import draw_pair

SIGMAS_M = (0.01, 0.02)
STEP_M = 1e-7


@pytest.mark.parametrize("sigmas", [1.0, 2.5, 3.0, 6.0])
def test_trimming_leaves_the_variance_of_a_truncated_gaussian(sigmas):
    assert trimmed_gaussian_variance(sigmas) == pytest.approx(truncnorm.var(-sigmas, sigmas))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_covariance_is_that_of_numerical_derivatives(seed):
    pair = draw_pair(np.random.default_rng(seed), 180, 0.3, 0.4, 0.005)
    angles = (pair.angle_min_rad, pair.angle_increment_rad)
    pose = pair.pose_first_second
    c, s = np.cos(pose[2]), np.sin(pose[2])

    reference, moving = (
        make_polar_scan(pair.first_m, *angles),
        make_polar_scan(pair.second_m, *angles),
    )
    lines = fit_local_lines(reference, SIGMAS_M[0])
    pairs = make_empty_pairs(180)
    find_pairs(pairs, reference, lines, moving, pose, SIGMAS_M, 0.3, 1)
    used = np.flatnonzero(pairs.partner >= 0)
    j, weight = pairs.partner[used], pairs.weight_per_m2[used]

    def residuals(first_m, second_m):
        lines = fit_local_lines(make_polar_scan(first_m, *angles), SIGMAS_M[0])
        scan = make_polar_scan(second_m, *angles)
        own = (scan.range_m[:, None] * np.stack([scan.cos, scan.sin], axis=1))[used]
        placed = own @ np.array([[c, s], [-s, c]]) + pose[:2]
        normal = np.stack([lines.normal_x[j], lines.normal_y[j]], axis=1)
        return (normal * placed).sum(axis=1) - lines.offset_m[j], normal, placed - pose[:2]

    at_rest, normal, arm = residuals(pair.first_m, pair.second_m)
    np.testing.assert_allclose(at_rest, pairs.residual_m[used], atol=1e-12)
    rows = np.column_stack([normal, normal[:, 1] * arm[:, 0] - normal[:, 0] * arm[:, 1]])
    information = rows.T @ (weight[:, None] * rows)
    spread = np.zeros((3, 3))
    for sweep, sigma_m in enumerate(SIGMAS_M):
        for beam in range(180):
            ranges = [pair.first_m.copy(), pair.second_m.copy()]
            ranges[sweep][beam] += STEP_M
            by_range = (residuals(*ranges)[0] - at_rest) / STEP_M
            gradient = rows.T @ (weight * by_range)
            spread += sigma_m**2 * np.outer(gradient, gradient)
    inverse = np.linalg.inv(information)
    misfit = (at_rest**2 / pairs.variance_m2[used]).sum() / (used.size - 3)
    expected = inverse @ spread @ inverse * max(misfit / 0.9, 0.5)

    stated, open_directions, _ = match_covariance(
        pairs, reference, lines, moving, pose, SIGMAS_M, 0.9
    )
    assert open_directions.shape == (0, 3)
    root = np.linalg.inv(np.linalg.cholesky(expected))
    ratio = np.linalg.eigvalsh(root @ stated @ root.T)
    # The stated one has a little more, for the normals' noise, and a floor for grazing beams.
    assert ratio.min() > 0.99
    assert ratio.max() < 1.05
