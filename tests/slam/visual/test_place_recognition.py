"""Votes of words, against the formula in plain loops and against matching by brute force."""

import math

import cv2
import numpy as np
import pytest

from fusion_core.slam.visual.place_recognition import PlaceIndex, PlaceSettings
from tests.slam.visual.feature_world import hall, observe, round_trip


def images(count=12, features=60, seed=1):
    """Images of which neighbours share half of their descriptors, some bits changed."""
    rng = np.random.default_rng(seed)
    pool = rng.integers(256, size=(count * features // 2 + features, 32), dtype=np.uint8)
    found = []
    for image in range(count):
        own = pool[image * features // 2 :][:features]
        bits = (rng.random((features, 256)) < 0.03).astype(np.uint8)
        found.append(own ^ np.packbits(bits, axis=1))
    return found


def words_of(index, descriptors):
    """The words of an image, bit by bit."""
    words = set()
    for descriptor in descriptors:
        for table, chosen in enumerate(index._bits):
            value = [descriptor[bit // 8] >> (7 - bit % 8) & 1 for bit in chosen]
            words.add((table, *value))
    return words


def test_scores_are_those_of_the_formula():
    settings = PlaceSettings(tables=3, word_bits=8)
    index, described = PlaceIndex(settings), images()
    for number, descriptors in enumerate(described):
        index.add(number, descriptors)
    known = [words_of(index, descriptors) for descriptors in described]
    query = words_of(index, described[4])
    weight = {
        word: math.log1p(len(known) / max(sum(word in other for other in known), 1))
        for word in query
    }
    expected = [sum(weight[word] for word in query & other) for other in known]
    found = index.query(described[4])
    scores = dict(zip(found.images.tolist(), found.scores.tolist(), strict=True))
    for number, votes in enumerate(expected):
        assert scores.get(number, 0.0) == pytest.approx(votes / sum(weight.values()))
    assert scores[4] == pytest.approx(1.0)
    assert (np.diff(found.scores) <= 0.0).all()


def test_a_removed_image_is_not_found_and_leaves_no_words():
    settings = PlaceSettings(tables=3, word_bits=8)
    described = images(count=60)
    index, kept = PlaceIndex(settings), PlaceIndex(settings)
    for number, descriptors in enumerate(described):
        index.add(number, descriptors)
        if number >= 4:
            index.remove(number - 2)
            assert number - 2 not in index.query(described[number - 2]).images
    assert index.images == {0, 1, 58, 59}
    for number in (0, 1, 58, 59):
        kept.add(number, described[number])
    # The words of what was removed lately may wait for the next merge.
    postings = [sum(len(run) for run in which._runs) for which in (index, kept)]
    assert postings[0] < 3 * postings[1]


def test_a_place_is_found_as_brute_force_finds_it():
    world, rng = hall(), np.random.default_rng(2)
    poses = round_trip(count=40, turns=0.95)
    stored = [observe(world, pose, rng)[0].descriptors for pose in poses]
    index = PlaceIndex()
    for number, descriptors in enumerate(stored):
        index.add(number, descriptors)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    for place in (3, 17, 31):
        seen = observe(world, poses[place], rng)[0].descriptors
        counts = [
            sum(match.distance <= 50 for match in matcher.match(seen, other)) for other in stored
        ]
        found = index.query(seen)
        assert found.images[0] == np.argmax(counts) == place
        # The next ones too are those that share features, but for those that share a handful.
        sharing = np.flatnonzero(np.array(counts) > 50)
        assert set(found.images[: len(sharing)].tolist()) == set(sharing.tolist())


def test_the_number_of_runs_and_the_order_of_adding_change_nothing():
    described = images(count=33)
    index, backwards = PlaceIndex(), PlaceIndex()
    for number, descriptors in enumerate(described):
        index.add(number, descriptors)
    for number, descriptors in reversed(list(enumerate(described))):
        backwards.add(number, descriptors)
    assert len(index._runs) <= 1 + math.log2(len(described))
    for descriptors in described[::8]:
        a, b = index.query(descriptors), backwards.query(descriptors)
        np.testing.assert_array_equal(a.images, b.images)
        np.testing.assert_allclose(a.scores, b.scores)


def test_a_word_that_all_have_is_looked_up_in_the_oldest_only():
    index = PlaceIndex(PlaceSettings(postings_max=5))
    same = images(count=1)[0]
    for number in range(20):
        index.add(number, same)
    np.testing.assert_array_equal(index.query(same).images, np.arange(5))


def test_what_shares_no_word_is_not_found():
    index = PlaceIndex()
    assert index.query(images(1)[0]).images.size == 0
    index.add(0, np.zeros((5, 32), np.uint8))
    assert index.query(np.full((5, 32), 255, np.uint8)).images.size == 0


def test_a_number_is_given_once():
    index = PlaceIndex()
    index.add(3, images(1)[0])
    with pytest.raises(ValueError, match="image 3"):
        index.add(3, images(1)[0])
