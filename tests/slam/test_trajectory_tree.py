"""Paths along the lines of descent against a full history of each particle."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.slam.trajectory_tree import TrajectoryTree

PARTICLES = 5


@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.floats(0.0, 1.0))
def test_a_path_is_that_of_the_ancestors(seed, steps, often):
    rng = np.random.default_rng(seed)
    paths = TrajectoryTree(PARTICLES, 2)
    plain = [[] for _ in range(PARTICLES)]
    for _ in range(steps):
        values = rng.normal(size=(PARTICLES, 2))
        paths.add(values)
        for path, value in zip(plain, values, strict=True):
            path.append(value)
        # Twice at one step, too.
        while rng.random() < 0.5 * often:
            parents = np.sort(rng.integers(0, PARTICLES, PARTICLES))
            paths.resample(parents)
            plain = [list(plain[parent]) for parent in parents]
    for particle in range(PARTICLES):
        np.testing.assert_array_equal(paths.path(particle), np.array(plain[particle]))


def test_what_all_have_in_common_is_kept_once():
    rng = np.random.default_rng(1)
    paths = TrajectoryTree(PARTICLES, 3)
    longest = 0
    for _ in range(2000):
        paths.add(rng.normal(size=(PARTICLES, 3)))
        if rng.random() < 0.2:
            paths.resample(np.sort(rng.integers(0, PARTICLES, PARTICLES)))
        longest = max(longest, paths.branching)
    assert longest < 300
    assert paths.path(0).shape == (2000, 3)


def test_nothing_is_dropped_where_nothing_is_resampled():
    paths = TrajectoryTree(2, 1)
    for step in range(200):
        paths.add(np.array([[step], [-step]], dtype=np.float64))
    np.testing.assert_array_equal(paths.path(1)[:, 0], -np.arange(200.0))
    assert paths.branching == 200
