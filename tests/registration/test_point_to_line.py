"""The closed form against scipy's search for the minimum."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from fusion_core.registration.point_to_line import fit_point_to_line


def cost(motion, points, normals, offsets, weights):
    c, s = np.cos(motion[2]), np.sin(motion[2])
    placed = points @ np.array([[c, s], [-s, c]]) + motion[:2]
    return (weights * ((normals * placed).sum(axis=1) - offsets) ** 2).sum()


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(["exact", "noisy", "arbitrary"]))
def test_the_closed_form_is_the_global_minimum(seed, kind):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 30))
    points, angle = rng.normal(0.0, 3.0, (count, 2)), rng.uniform(0.0, 7.0, count)
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    weights = rng.uniform(0.1, 3.0, count)
    truth = np.append(rng.normal(0.0, 1.0, 2), rng.uniform(-3.1, 3.1))
    c, s = np.cos(truth[2]), np.sin(truth[2])
    offsets = (normals * (points @ np.array([[c, s], [-s, c]]) + truth[:2])).sum(axis=1)
    if kind == "exact":
        found = fit_point_to_line(points, normals, offsets, weights)
        assert cost(found, points, normals, offsets, weights) < 1e-18
        return
    offsets = offsets + rng.normal(0.0, 0.05, count) if kind == "noisy" else rng.normal(size=count)
    found = fit_point_to_line(points, normals, offsets, weights)
    problem = (points, normals, offsets, weights)
    least = min(
        minimize(cost, [0.0, 0.0, start], args=problem, tol=1e-12).fun
        for start in np.arange(-3.0, 3.1, 1.0)
    )
    assert cost(found, *problem) <= least * (1.0 + 1e-7) + 1e-12


def test_parallel_lines_leave_the_closed_form_open():
    normals = np.tile([[0.6, 0.8]], (5, 1))
    motion = fit_point_to_line(np.arange(10.0).reshape(5, 2), normals, np.ones(5), np.ones(5))
    assert np.isnan(motion).all()


@pytest.mark.parametrize("cosine", [-0.2, 0.5, 0.95])
def test_of_two_equally_good_rotations_one_is_found(cosine):
    """Points on the x axis and lines across it do not determine the sign of the rotation."""
    points = np.array([[1.0, 0.0], [2.0, 0.0], [4.0, 0.0], [0.0, 0.0]])
    normals = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    offsets = cosine * points[:, 0]
    motion = fit_point_to_line(points, normals, offsets, np.ones(4))
    np.testing.assert_allclose(motion[:2], 0.0, atol=1e-7)
    assert np.cos(motion[2]) == pytest.approx(cosine, abs=1e-7)
