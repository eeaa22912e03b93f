"""Outliers among stamps are removed alone, wherever they are; neighbours of an instant."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.stamps import (
    NO_STAMP,
    find_neighbours,
    longest_ascending,
    nearest_stamp,
    nearest_stamps,
    plausible_stamps,
    within_recording,
)

STEP_NS = NS_PER_S // 10
START_NS = 1_700_000_000 * NS_PER_S
YEAR_NS = 365 * 24 * 3600 * NS_PER_S


def regular(count):
    return START_NS + STEP_NS * np.arange(count, dtype=np.int64)


def ascends(values, strictly):
    steps = np.diff(values)
    return bool(np.all(steps > 0) if strictly else np.all(steps >= 0))


@given(
    st.lists(st.integers(0, 6), max_size=8).map(lambda found: np.array(found, dtype=np.int64)),
    st.booleans(),
)
@settings(deadline=None)
def test_it_is_the_longest_of_all_subsequences_and_the_first_of_these(stamps_ns, strictly):
    kept = longest_ascending(stamps_ns, strictly=strictly)
    longest = next(
        indices
        for size in range(stamps_ns.size, -1, -1)
        for indices in combinations(range(stamps_ns.size), size)
        if ascends(stamps_ns[list(indices)], strictly)
    )
    assert tuple(np.flatnonzero(kept)) == longest


@given(st.data())
@settings(deadline=None)
def test_outliers_among_ascending_stamps_are_lost_and_nothing_else(data):
    count = data.draw(st.integers(8, 40))
    stamps_ns = regular(count)
    # Fewer than the quarter that either end may lose.
    wrong = data.draw(st.lists(st.integers(0, count - 1), max_size=(count - 1) // 4, unique=True))
    for index in wrong:
        far = data.draw(st.integers(4 * count, 10**9)) * STEP_NS
        stamps_ns[index] += data.draw(st.sampled_from((-1, 1))) * far
    kept = plausible_stamps(stamps_ns, regular(count))
    assert set(np.flatnonzero(~kept)) == set(wrong)


@given(st.permutations(range(12)), st.booleans())
def test_what_is_kept_of_any_order_ascends(order, strictly):
    stamps_ns = regular(12)[order]
    kept = plausible_stamps(stamps_ns, regular(12), strictly=strictly)
    assert kept.any()
    assert ascends(stamps_ns[kept], strictly)


def test_backwards_keeps_one_and_equal_stamps_the_first():
    assert plausible_stamps(regular(20)[::-1], regular(20)).tolist() == [True] + [False] * 19
    same = np.full(5, START_NS)
    assert plausible_stamps(same, regular(5)).tolist() == [True] + [False] * 4
    assert plausible_stamps(same, regular(5), strictly=False).all()


@pytest.mark.parametrize("at", [0, 1, 10, 18, 19])
@pytest.mark.parametrize("by_ns", [-YEAR_NS, YEAR_NS])
def test_one_stamp_a_year_off_is_lost_alone(at, by_ns):
    stamps_ns = regular(20)
    stamps_ns[at] += by_ns
    assert np.flatnonzero(~plausible_stamps(stamps_ns, regular(20))).tolist() == [at]


def test_the_order_in_which_far_stamps_come_makes_no_difference():
    stamps_ns = regular(20)
    stamps_ns[7] += YEAR_NS
    order = np.random.default_rng(5).permutation(20)
    kept = within_recording(stamps_ns[order], regular(20)[order])
    assert order[~kept].tolist() == [7]


def test_a_jump_that_the_log_has_too_is_a_pause():
    """A pause of a night, a replay at ten times the speed, a clock that is years off."""
    paused = regular(20)
    paused[12:] += 8 * 3600 * NS_PER_S
    paused[19] += 24 * 3600 * NS_PER_S
    assert plausible_stamps(paused, paused + 3 * NS_PER_S).all()
    assert plausible_stamps(paused - 20 * YEAR_NS, paused).all()
    assert plausible_stamps(regular(20), START_NS + (regular(20) - START_NS) // 10).all()


def test_a_log_with_one_time_for_all_is_not_used():
    stamps_ns = regular(20)
    stamps_ns[19] += YEAR_NS
    assert plausible_stamps(stamps_ns, np.full(20, START_NS)).all()


def test_unreadable_messages_are_kept():
    stamps_ns = regular(6)
    stamps_ns[[1, 4]] = NO_STAMP
    stamps_ns[2] += YEAR_NS
    kept = plausible_stamps(stamps_ns, regular(6))
    assert kept.tolist() == [True, True, False, True, True, True]


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_stamps_that_ascend_are_kept(count):
    stamps_ns = regular(count)
    stamps_ns[2:] += YEAR_NS
    assert plausible_stamps(stamps_ns, regular(count)).all()


@given(st.lists(st.integers(-50, 50), min_size=1, unique=True), st.integers(-60, 60))
def test_the_nearest_stamp_is_that_of_a_search_of_all(stamps: list[int], at: int) -> None:
    ordered = sorted(stamps)
    best = min(range(len(ordered)), key=lambda index: abs(ordered[index] - at))
    assert nearest_stamp(ordered, at, 1000.0) == best
    gap = abs(ordered[best] - at)
    assert nearest_stamp(ordered, at, gap) == best
    assert nearest_stamp(ordered, at, gap - 1) is None
    assert nearest_stamps(np.array(ordered), np.array([at, at])).tolist() == [best, best]


def test_without_stamps_none_is_nearest() -> None:
    assert nearest_stamp([], 0, 1000.0) is None


@given(st.lists(st.integers(-50, 50), min_size=1, unique=True), st.integers(-60, 60))
def test_the_neighbours_are_those_of_a_search_of_all(stamps: list[int], at: int) -> None:
    ordered = sorted(stamps)
    found = find_neighbours(np.array(ordered), at)
    if not ordered[0] <= at <= ordered[-1]:
        assert found is None
        return
    assert found is not None
    assert ordered[found.before] == max(stamp for stamp in ordered if stamp <= at)
    assert ordered[found.after] == min(stamp for stamp in ordered if stamp >= at)
    assert found.gap_ns == ordered[found.after] - ordered[found.before]
    assert 0.0 <= found.fraction < 1.0
    assert ordered[found.before] + found.fraction * found.gap_ns == pytest.approx(at)


def test_without_stamps_there_are_no_neighbours() -> None:
    assert find_neighbours(np.empty(0, dtype=np.int64), 0) is None
