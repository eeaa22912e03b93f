"""Runs of samples that are not good, against a walk sample by sample."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.runs import run_bounds


@given(st.lists(st.booleans(), min_size=1, max_size=40))
def test_bounds_equal_those_of_a_scan_in_both_directions(in_gap: list[bool]) -> None:
    first, last = run_bounds(np.array(in_gap))
    for position, gap in enumerate(in_gap):
        if not gap:
            assert last[position] - first[position] + 1 < 0
            continue
        low = high = position
        while low > 0 and in_gap[low - 1]:
            low -= 1
        while high + 1 < len(in_gap) and in_gap[high + 1]:
            high += 1
        assert (first[position], last[position]) == (low, high)


def test_lines_are_independent() -> None:
    first, last = run_bounds(np.array([[False, True, True], [True, True, False]]))
    assert first[0].tolist()[1:] == [1, 1]
    assert last[0].tolist()[1:] == [2, 2]
    assert first[1].tolist()[:2] == [0, 0]
    assert last[1].tolist()[:2] == [1, 1]
