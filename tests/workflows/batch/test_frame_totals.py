"""Shares over the images of a recording, and how far they vary along it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.workflows.batch.frame_totals import FrameTotals

COLUMNS = ("hole", "good")


def totals_of(numbers: IntArray, block: int = 1000) -> FrameTotals:
    totals = FrameTotals(COLUMNS)
    for start in range(0, len(numbers), block):
        totals.add(numbers[start : start + block])
    return totals


def varying(seed: int, images: int) -> IntArray:
    """(images, 2) holes and good beams of 300; images share what is in view for some 20 more."""
    rng = np.random.default_rng(seed)
    seen: FloatArray = lfilter([1.0], [1.0, -0.95], rng.normal(size=images + 200))[200:]
    holes = rng.binomial(300, 1.0 / (1.0 + np.exp(2.0 - 0.3 * seen)))
    return np.stack([holes, 300 - holes], axis=1)


@given(st.integers(1, 300), st.integers(1, 60), st.integers(0, 99))
def test_the_share_is_of_all_images_whatever_the_blocks(images: int, block: int, seed: int) -> None:
    numbers = varying(seed, images)
    totals = totals_of(numbers, block)
    assert totals.total("hole") == numbers[:, 0].sum()
    share, sd = totals.share("hole", COLUMNS)
    assert share == pytest.approx(numbers[:, 0].sum() / numbers.sum())
    assert (share, sd) == totals_of(numbers).share("hole", COLUMNS)


@pytest.mark.parametrize(("images", "length"), [(10, 1), (16, 1), (17, 2), (33, 4), (1000, 64)])
def test_the_deviation_is_that_of_a_ratio_over_stretches(images: int, length: int) -> None:
    numbers = varying(3, images)
    part, whole = [], []
    for start in range(0, images, length):
        part.append(int(numbers[start : start + length, 0].sum()))
        whole.append(int(numbers[start : start + length].sum()))
    share = sum(part) / sum(whole)
    count = len(part)
    variance = sum((p - share * w) ** 2 for p, w in zip(part, whole, strict=True))
    variance *= count / (count - 1) / sum(whole) ** 2
    assert totals_of(numbers).share("hole", COLUMNS)[1] == pytest.approx(np.sqrt(variance))


def test_the_deviation_tells_how_far_another_such_recording_would_be() -> None:
    found = [totals_of(varying(seed, 600)).share("hole", COLUMNS) for seed in range(200)]
    shares, sds = np.array(found, dtype=np.float64).T
    by_counting = np.sqrt(shares.mean() * (1.0 - shares.mean()) / (600 * 300))
    assert np.sqrt(np.mean(sds**2)) == pytest.approx(shares.std(), rel=0.25)
    assert shares.std() > 5.0 * by_counting


def test_what_is_not_known_is_none() -> None:
    assert totals_of(np.zeros((50, 2), dtype=np.int64)).share("hole", COLUMNS) == (None, None)
    few = np.array([[1, 9], [0, 0], [2, 8], [3, 7]])
    assert totals_of(few).share("hole", COLUMNS) == (0.2, None)
