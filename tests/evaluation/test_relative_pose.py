"""Pairs that are one step apart, against all pairs looked at one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.relative_pose import STEP_TOLERANCE, Step, pairs_of_step
from fusion_core.model.errors import ScanLoomError, SettingsError


def one_by_one(place: list[int], delta: int) -> list[tuple[int, int]]:
    """For each place the nearest to a step after it, the first of equally near ones."""
    pairs = []
    for first, here in enumerate(place):
        off = [abs(there - here - delta) for there in place[first + 1 :]]
        if off and min(off) <= STEP_TOLERANCE * delta:
            pairs.append((first, first + 1 + off.index(min(off))))
    return pairs


# Binary fractions: every distance and its comparison is exact.
PLACES = st.lists(st.integers(0, 60), min_size=1, max_size=25).map(sorted)


@given(PLACES, st.integers(1, 40))
def test_distances(place: list[int], delta: int) -> None:
    stamps_ns = np.arange(len(place), dtype=np.int64)
    expected = one_by_one(place, delta)
    step, path_m = Step(delta=delta / 8, unit="m"), np.array(place) / 8
    if not expected:
        with pytest.raises(ScanLoomError, match=f"poses compared are {step} apart"):
            pairs_of_step(stamps_ns, path_m, step)
        return
    first, second = pairs_of_step(stamps_ns, path_m, step)
    assert list(zip(first.tolist(), second.tolist(), strict=True)) == expected


def test_times_are_counted_in_nanoseconds() -> None:
    stamps_ns = 1_700_000_000_000_000_001 + np.array([0, 500, 1000, 1590, 2000]) * 1_000_000
    first, second = pairs_of_step(stamps_ns, np.zeros(5), Step())
    assert list(zip(first.tolist(), second.tolist(), strict=True)) == [(0, 2), (1, 3), (2, 4)]


def test_frames_are_counted_whatever_their_time() -> None:
    stamps_ns = np.array([0, 1, 1000, 1001])
    first, second = pairs_of_step(stamps_ns, np.zeros(4), Step(delta=3, unit="frames"))
    assert (first.tolist(), second.tolist()) == ([0], [3])
    for delta in (4, 1e300):
        with pytest.raises(ScanLoomError, match="No two of the 4 poses"):
            pairs_of_step(stamps_ns, np.zeros(4), Step(delta=delta, unit="frames"))


@pytest.mark.parametrize(
    ("delta", "unit", "words"),
    [
        (0.0, "s", "positive"),
        (-1.0, "m", "got -1"),
        (float("nan"), "s", "positive"),
        (float("inf"), "frames", "finite"),
        (1.5, "frames", "whole number, got 1.5"),
    ],
)
def test_an_invalid_step_is_refused(delta: float, unit: str, words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        Step(delta=delta, unit=unit)  # type: ignore[arg-type]
