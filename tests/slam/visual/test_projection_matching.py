"""Matching near a projection against a loop over all pairs."""

import numpy as np
import pytest

from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.projection_matching import (
    FeatureGrid,
    descriptor_words,
    hamming,
    predict_octaves,
)


def features(rng, count=300):
    return FrameFeatures(
        pixels=rng.uniform([-20.0, -20.0], [660.0, 500.0], (count, 2)),
        depths_m=np.full(count, 2.0),
        octaves=rng.integers(0, 8, count),
        angles_deg=np.zeros(count, np.float32),
        descriptors=rng.integers(0, 256, (count, 32), dtype=np.uint8),
    )


def bits(a, b):
    return int(np.unpackbits(a ^ b).sum())


def test_the_distance_is_the_number_of_bits():
    rng = np.random.default_rng(0)
    some = rng.integers(0, 256, (40, 32), dtype=np.uint8)
    words = descriptor_words(some)
    for i in range(39):
        assert hamming(words[i], words[i + 1]) == bits(some[i], some[i + 1])
    assert hamming(words[0], words[0]) == 0


@pytest.mark.parametrize("ratio_max", [1.0, 0.8])
def test_it_finds_what_a_loop_finds(ratio_max):
    rng = np.random.default_rng(1)
    there = features(rng)
    count = 120
    near = rng.integers(0, len(there), count)
    pixels = there.pixels[near] + rng.normal(0.0, 10.0, (count, 2))
    wanted = there.descriptors[near].copy()
    wanted[:, :8] ^= rng.integers(0, 256, (count, 8), dtype=np.uint8)
    radii = rng.uniform(5.0, 60.0, count)
    low = rng.integers(0, 4, count)
    high = low + rng.integers(0, 5, count)
    is_free = rng.uniform(size=len(there)) < 0.9
    found = FeatureGrid(there).match(
        pixels, radii, low, high, wanted, distance_max=110, ratio_max=ratio_max, is_free=is_free
    )
    best = {}
    for i in range(count):
        inside = [
            (bits(wanted[i], there.descriptors[j]), j)
            for j in range(len(there))
            if is_free[j]
            and low[i] <= there.octaves[j] <= high[i]
            and np.linalg.norm(there.pixels[j] - pixels[i]) <= radii[i]
        ]
        inside.sort()
        if not inside or inside[0][0] > 110:
            continue
        distance, j = inside[0]
        if len(inside) > 1 and there.octaves[j] == there.octaves[inside[1][1]]:
            is_clear = distance <= ratio_max * inside[1][0]
        else:
            is_clear = True
        if not is_clear:
            continue
        if j not in best or distance < best[j][0]:
            best[j] = (distance, i)
    expected = np.full(count, -1)
    for j, (_, i) in best.items():
        expected[i] = j
    assert (expected >= 0).sum() > 30
    np.testing.assert_array_equal(found, expected)


def test_nothing_is_found_among_nothing():
    none = features(np.random.default_rng(0), 0)
    found = FeatureGrid(none).match(
        np.zeros((3, 2)), np.ones(3), np.zeros(3, int), np.ones(3, int), np.zeros((3, 32), np.uint8)
    )
    np.testing.assert_array_equal(found, [-1, -1, -1])


def test_twice_as_near_is_four_levels_up():
    octaves = predict_octaves(np.array([2.0, 2.0, 2.0, 2.0]), np.array([2.0, 1.0, 8.0, 0.01]), 8)
    np.testing.assert_array_equal(octaves, [0, 4, 0, 7])
