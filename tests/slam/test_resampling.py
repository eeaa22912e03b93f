"""Weights and resampling against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.slam.particle_filter import effective_number, systematic_resample

WEIGHTS = st.lists(st.floats(0.0, 1.0), min_size=1, max_size=40).filter(lambda w: sum(w) > 1e-3)


def normalised(weights):
    weights = np.array(weights)
    return weights / weights.sum()


@pytest.mark.parametrize("count", [1, 2, 30])
def test_equal_weights_are_all_effective(count):
    assert effective_number(np.full(count, 1.0 / count)) == pytest.approx(count)


def test_one_weight_is_one_particle():
    assert effective_number(np.array([0.0, 1.0, 0.0])) == 1.0


@given(WEIGHTS)
def test_the_effective_number_follows_the_spread_of_weights(weights):
    weights = normalised(weights)
    # 1 / N_eff = (1 + c²) / P, c being the weights' coefficient of variation.
    count = weights.size
    expected = count / (1.0 + (weights.std() * count) ** 2)
    assert effective_number(weights) == pytest.approx(expected)
    assert 1.0 - 1e-9 <= effective_number(weights) <= count + 1e-9


@given(WEIGHTS, st.floats(0.0, 1.0, exclude_max=True))
def test_each_particle_has_as_many_children_as_its_weight_says(weights, offset):
    weights = normalised(weights)
    parents = systematic_resample(weights, offset)
    assert parents.shape == weights.shape
    assert (np.diff(parents) >= 0).all()
    children = np.bincount(parents, minlength=weights.size)
    expected = weights * weights.size
    assert (children >= np.floor(expected - 1e-9)).all()
    assert (children <= np.ceil(expected + 1e-9)).all()


def test_children_are_right_on_average():
    weights = np.array([0.05, 0.45, 0.2, 0.3])
    offsets = (np.arange(1000) + 0.5) / 1000
    children = np.mean(
        [np.bincount(systematic_resample(weights, o), minlength=4) for o in offsets], axis=0
    )
    np.testing.assert_allclose(children, 4.0 * weights, atol=0.002)


def test_a_weight_of_nothing_has_no_child():
    parents = systematic_resample(np.array([0.0, 0.5, 0.0, 0.5, 0.0]), 0.0)
    assert set(parents) == {1, 3}
