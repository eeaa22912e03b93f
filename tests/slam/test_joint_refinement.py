"""Poses and map refined together, in a simulated room: what moves, what stays, and by how much."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fusion_core.model.conventions import wrap_angle
from fusion_core.slam.joint_refinement import RefinementSettings, _split_into_squares, refine
from fusion_core.slam.scan_points import scan_points
from fusion_core.slam.submaps import SubmapSettings
from tests.benchmarks.scan_matching_room import WALLS as ROOM
from tests.slam.ring import scan_of

COUNT = 60
SUBMAPS = SubmapSettings()
SETTINGS = RefinementSettings(rounds=2)
JOINED = np.ones(COUNT, dtype=np.bool_)


@pytest.fixture(scope="module")
def room():
    """Truth of a round through the room, (60, 3), and the points of each scan."""
    rng = np.random.default_rng(6)
    angle = 2.0 * np.pi * np.arange(COUNT) / COUNT
    truth = np.stack(
        [5.6 + 1.6 * np.cos(angle), 4.0 + 1.2 * np.sin(angle), wrap_angle(angle + 0.5 * np.pi)],
        axis=1,
    )
    scans = [scan_of(pose, number, rng, ROOM, 12.0) for number, pose in enumerate(truth)]
    return truth, [scan_points(scan, SUBMAPS.max_range_m, 360) for scan in scans]


@pytest.fixture(scope="module")
def off(room):
    """Poses that are off by a centimetre and a half and a quarter of a degree."""
    truth, _ = room
    poses = truth + np.random.default_rng(7).normal(0.0, [0.015, 0.015, 0.0044], truth.shape)
    poses[0] = truth[0]
    return poses


def spread_m(poses, truth):
    """Root mean square distance about the mean one: the map as a whole may lie anywhere."""
    away_m = (poses - truth)[:, :2]
    return float(np.sqrt(((away_m - away_m.mean(axis=0)) ** 2).sum(axis=1).mean()))


def test_poses_come_nearer_to_the_truth(room, off):
    truth, points_m = room
    refined = refine(off, points_m, JOINED, SUBMAPS, SETTINGS)
    assert spread_m(refined, truth) < 0.65 * spread_m(off, truth)
    assert np.std(refined[:, 2] - truth[:, 2]) < 0.65 * np.std(off[:, 2] - truth[:, 2])


def test_the_first_pose_stays_and_the_same_input_gives_the_same_bytes(room, off):
    _, points_m = room
    refined = refine(off, points_m, JOINED, SUBMAPS, SETTINGS)
    np.testing.assert_array_equal(refined[0], off[0])
    again = refine(off, points_m, JOINED, SUBMAPS, SETTINGS)
    assert refined.tobytes() == again.tobytes()


def test_without_a_round_nothing_moves(room, off):
    _, points_m = room
    none = RefinementSettings(rounds=0)
    np.testing.assert_array_equal(refine(off, points_m, JOINED, SUBMAPS, none), off)


def test_unconnected_scans_neither_move_nor_affect_others(room, off):
    _, points_m = room
    joined = JOINED.copy()
    joined[40:] = False
    elsewhere = off.copy()
    elsewhere[40:, :2] += 0.1
    refined = refine(elsewhere, points_m, joined, SUBMAPS, SETTINGS)
    np.testing.assert_array_equal(refined[40:], elsewhere[40:])
    alone = refine(off[:40], points_m[:40], joined[:40], SUBMAPS, SETTINGS)
    np.testing.assert_array_equal(refined[:40], alone)


def test_a_scan_without_points_stays(room, off):
    _, points_m = room
    blind = [*points_m[:-1], np.zeros((0, 2))]
    refined = refine(off, blind, JOINED, SUBMAPS, SETTINGS)
    np.testing.assert_array_equal(refined[-1], off[-1])
    assert (refined[1:-1] != off[1:-1]).any(axis=1).all()


def test_distant_places_are_independent(room, off):
    """A second room beyond the first one's range, in a separate square."""
    _, points_m = room
    # A whole number of cells, so that both lie on the lattice in the same position.
    shift = np.array([400.0, 0.0, 0.0])
    away = off + shift
    both = refine(np.concatenate([off, away]), points_m * 2, np.tile(JOINED, 2), SUBMAPS, SETTINGS)
    alone = refine(off, points_m, JOINED, SUBMAPS, SETTINGS)
    np.testing.assert_allclose(both[:COUNT], alone, atol=1e-9)
    np.testing.assert_allclose(both[COUNT + 1 :] - shift, alone[1:], atol=2e-3)


def test_progress_is_reported(room, off):
    _, points_m = room
    said = []
    refine(off, points_m, JOINED, SUBMAPS, SETTINGS, lambda *state: said.append(state))
    assert said[0] == (0, 2 * COUNT, "refining")
    assert [done for done, _, _ in said] == list(range(2 * COUNT))


@given(arrays(np.float64, st.tuples(st.integers(0, 30), st.just(2)), elements=st.floats(-500, 500)))
def test_squares_hold_each_place_once_with_all_within_range(places_m):
    seen = []
    for inside, about in _split_into_squares(places_m, 30.0):
        seen += inside.tolist()
        for place in inside:
            away_m = np.abs(places_m - places_m[place]).max(axis=1)
            assert set(np.flatnonzero(away_m < 29.999)) <= set(about.tolist())
        spread_m = np.ptp(places_m[about], axis=0)
        assert (spread_m <= 160.0).all()
    assert sorted(seen) == list(range(len(places_m)))
