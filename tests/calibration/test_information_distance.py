"""Information of label pairs, against loops over the formula and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.calibration.refinement.information_distance import (
    add_pairs,
    equal_groups,
    group_scale,
    joint_entropy,
    mutual_information,
    normalised_information_distance,
)

COUNTS = st.lists(st.lists(st.integers(0, 9), min_size=3, max_size=3), min_size=2, max_size=4)


def information_by_loop(joint):
    total = sum(map(sum, joint))
    result, entropy = 0.0, 0.0
    for a, row in enumerate(joint):
        for b, count in enumerate(row):
            if count:
                p_a = sum(joint[a]) / total
                p_b = sum(other[b] for other in joint) / total
                result += count / total * math.log(count / total / (p_a * p_b))
                entropy -= count / total * math.log(count / total)
    return result, entropy


@given(counts=COUNTS)
def test_information_agrees_with_a_loop(counts):
    joint = np.array(counts, dtype=np.float64)
    if joint.sum() == 0.0:
        assert mutual_information(joint) == 0.0
        assert normalised_information_distance(joint) == 1.0
        return
    information, entropy = information_by_loop(counts)
    assert mutual_information(joint) == pytest.approx(information, abs=1e-12)
    assert joint_entropy(joint) == pytest.approx(entropy, abs=1e-12)
    if entropy > 0.0:
        expected = (entropy - information) / entropy
        assert normalised_information_distance(joint) == pytest.approx(expected, abs=1e-12)


@given(counts=COUNTS)
def test_the_distance_is_symmetric_and_lies_between_0_and_1(counts):
    joint = np.array(counts, dtype=np.float64)
    distance = normalised_information_distance(joint)
    assert -1e-12 <= distance <= 1.0 + 1e-12
    assert normalised_information_distance(joint.T) == pytest.approx(distance, abs=1e-12)


def test_closed_forms():
    # Each tells the other: log 4 nats, distance 0. Independent: none, distance 1.
    assert mutual_information(3.0 * np.eye(4)) == pytest.approx(math.log(4.0))
    assert normalised_information_distance(3.0 * np.eye(4)) == pytest.approx(0.0, abs=1e-12)
    independent = np.outer([1.0, 2.0, 5.0], [4.0, 4.0])
    assert mutual_information(independent) == pytest.approx(0.0, abs=1e-12)
    assert normalised_information_distance(independent) == pytest.approx(1.0)
    # A binary channel with error 1/8 has the capacity log 2 - H(1/8).
    error = 1.0 / 8.0
    channel = np.array([[1.0 - error, error], [error, 1.0 - error]])
    entropy = -error * math.log(error) - (1.0 - error) * math.log(1.0 - error)
    assert mutual_information(channel) == pytest.approx(math.log(2.0) - entropy)


def test_no_monotone_change_alters_the_groups():
    values = np.random.default_rng(1).normal(size=500)
    labels = equal_groups(values, 8)
    assert np.array_equal(equal_groups(np.exp(3.0 * values), 8), labels)
    assert np.array_equal(equal_groups(values**3 - 7.0, 8), labels)
    counts = np.bincount(labels)
    assert counts.size == 8
    assert np.ptp(counts) <= 2


def test_no_monotone_change_of_the_grey_values_alters_their_scale():
    rng = np.random.default_rng(2)
    image = rng.choice(np.linspace(0.0, 1.0, 200), size=(30, 40)).astype(np.float32)
    samples = image.ravel().astype(np.float64)
    scale = group_scale(image, samples, 12)
    darker = np.sqrt(image.astype(np.float64)) * 200.0 + 9.0
    changed = group_scale(darker.astype(np.float32), darker.ravel(), 12)
    # The image's values themselves are knots or between the same ones.
    assert np.abs(scale - changed).max() < 0.2
    assert scale.min() >= 0.0
    assert scale.max() <= 11.0


def test_equal_values_are_in_one_group():
    assert set(equal_groups(np.array([1.0, 1.0, 1.0, 1.0]), 5)) == {0}
    labels = equal_groups(np.repeat([3.0, 1.0, 2.0], 4), 3)
    assert labels.tolist() == [2] * 4 + [0] * 4 + [1] * 4


def test_pairs_agree_with_a_loop_over_the_points():
    rng = np.random.default_rng(3)
    points = rng.uniform([-3.0, -2.0, -1.0], [3.0, 2.0, 6.0], (300, 3))
    labels, layers = rng.integers(0, 4, 300), rng.integers(0, 2, 300)
    image = rng.uniform(0.0, 4.0, (2, 20, 30)).astype(np.float32)
    image[0, 5:9, 5:9] = np.nan
    T = np.eye(4)
    T[:3, 3] = [0.1, -0.2, 0.5]
    pinhole = (15.0, 14.0, 14.5, 9.5)
    joint = np.zeros((4, 5))
    add_pairs(points, labels, layers, image, pinhole, T, joint)
    expected = np.zeros((4, 5))
    for point, label, layer in zip(points, labels, layers, strict=True):
        x, y, z = point + T[:3, 3]
        if z <= 0.0:
            continue
        u, v = pinhole[0] * x / z + pinhole[2], pinhole[1] * y / z + pinhole[3]
        if not (0 <= u < 29 and 0 <= v < 19):
            continue
        column, row = math.floor(u), math.floor(v)
        weights = np.outer([1 - (v - row), v - row], [1 - (u - column), u - column])
        value = float((image[layer, row : row + 2, column : column + 2] * weights).sum())
        if math.isnan(value):
            continue
        below = min(math.floor(value), 3)
        expected[label, below] += 1 - (value - below)
        expected[label, below + 1] += value - below
    assert expected.sum() > 50
    np.testing.assert_allclose(joint, expected, atol=1e-6)
