"""Poses that jump away and back, and trajectories that only look like it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.conventions import NS_PER_MS
from fusion_core.model.isolated_poses import find_isolated_poses

STAMPS_NS = 50 * NS_PER_MS * np.arange(40, dtype=np.int64)


def track():
    """(40, 2) a drive at 0.5 m/s."""
    return np.stack([0.5 * STAMPS_NS / 1e9, np.zeros(40)], axis=1)


@given(st.sets(st.sampled_from(range(0, 40, 5)), max_size=4), st.floats(20.0, 1e308))
def test_isolated_jumps_are_found_and_nothing_else(wrong, away_m):
    positions_m = track()
    positions_m[list(wrong), 1] = away_m
    assert set(np.flatnonzero(find_isolated_poses(STAMPS_NS, positions_m))) == wrong


def test_the_last_pose_may_be_one():
    positions_m = track()
    positions_m[39] = 1e5
    assert np.flatnonzero(find_isolated_poses(STAMPS_NS, positions_m)).tolist() == [39]


def test_a_short_run_of_them_is_found_as_well():
    positions_m = track()
    positions_m[10:13] += 1e5
    assert np.flatnonzero(find_isolated_poses(STAMPS_NS, positions_m)).tolist() == [10, 11, 12]


@pytest.mark.parametrize("first", [10, 20, 30])
def test_a_track_that_jumps_and_stays_there_has_none(first):
    positions_m = track()
    positions_m[first:] += 1e5
    assert not find_isolated_poses(STAMPS_NS, positions_m).any()


def test_stamps_in_bursts_are_no_jumps():
    stamps_ns = STAMPS_NS.copy()
    stamps_ns[1::2] = stamps_ns[::2] + 1
    assert not find_isolated_poses(stamps_ns, track()).any()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_of_two_poses_neither_is_isolated(count):
    assert not find_isolated_poses(STAMPS_NS[:count], 1e6 * track()[:count]).any()
