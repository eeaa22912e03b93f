"""The radius filter, against counting every pair."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from fusion_core.registration.radius_filter import has_neighbours


@given(
    st.integers(0, 10_000),
    st.integers(1, 120),
    st.sampled_from([0.05, 0.3, 2.0]),
    st.integers(0, 8),
)
def test_neighbours_are_those_within_the_radius(seed, count, radius, least):
    rng = np.random.default_rng(seed)
    # On a raster many distances are exactly the radius, and many points coincide.
    cloud = rng.integers(-8, 8, (count, 3)) * 0.15 if seed % 2 else rng.normal(size=(count, 3))
    points = cloud[: max(1, count // 2)]
    distance = np.sqrt(((points[:, None] - cloud[None]) ** 2).sum(axis=2))
    clear = np.abs(distance - radius).min(axis=1) > 1e-9
    expected = (distance <= radius).sum(axis=1) - 1 >= least
    found = has_neighbours(points, cloud, radius, least)
    np.testing.assert_array_equal(found[clear], expected[clear])


def test_a_large_cloud_agrees_with_a_tree():
    cloud = np.random.default_rng(1).uniform(-3.0, 3.0, (6000, 3))
    expected = cKDTree(cloud).query_ball_point(cloud, 0.25, return_length=True) - 1 >= 3
    assert 0.05 < expected.mean() < 0.95
    np.testing.assert_array_equal(has_neighbours(cloud, cloud, 0.25, 3), expected)


def test_no_points_give_an_empty_result():
    assert has_neighbours(np.empty((0, 3)), np.empty((0, 3)), 0.1, 3).shape == (0,)


def test_points_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="finite"):
        has_neighbours(np.full((2, 3), np.nan), np.full((2, 3), np.nan), 0.1, 1)
