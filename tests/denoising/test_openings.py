"""What stands in an opening between walls: the counts against plain loops and another library's
tail, and closed scenes in which the beams are lost on a sunlit wall, or on a pane."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from fusion_core.denoising.nearby_returns import nearby_returns
from fusion_core.denoising.openings import ReturnsInOpening, find_openings, returns_in_openings
from fusion_core.model.classes import RepairSource
from tests.denoising.seen_scans import seen
from tests.denoising.test_nearby_returns import BEAMS, SETTINGS, repaired, scan_of, window_of

NEIGHBOURS = RepairSource.NEIGHBOURS
TRIALS = 200
OPENING = np.arange(24, 56)
# The outer beams may be filled from the wall beside them.
INNER = slice(28, 52)


def wall(away_m=3.0):
    """(BEAMS,) ranges of a straight wall."""
    azimuth_rad = scan_of(np.zeros(BEAMS)).angles_rad
    return away_m / np.cos(azimuth_rad - azimuth_rad.mean())


@given(
    seed=st.integers(0, 10_000),
    scans=st.tuples(st.booleans(), st.booleans()),
    reach_beams=st.integers(0, 30),
)
@settings(max_examples=60)
def test_counts_equal_a_loop_over_the_beams(seed, scans, reach_beams):
    rng = np.random.default_rng(seed)
    lidar, before, after = np.where(
        rng.random((3, BEAMS)) < 0.4, np.nan, rng.choice([1.0, 1.1, 2.0], (3, BEAMS))
    )
    before, after = (
        seen(scan, np.isfinite(scan) | (rng.random(BEAMS) < 0.6)) if is_there else None
        for scan, is_there in zip((before, after), scans, strict=True)
    )
    window = window_of(lidar, before=before, after=after)
    across_m = np.where(rng.random(BEAMS) < 0.1, np.nan, 1.05)
    # A hundredth of a step more, so that the reach is a number of beams.
    counts = returns_in_openings(
        window, across_m, np.full(BEAMS, 0.07), np.deg2rad(0.5 * reach_beams + 0.005)
    )
    for i in range(BEAMS):
        expected = np.zeros((3, 3), dtype=int)
        for near in range(max(0, i - reach_beams), min(BEAMS, i + reach_beams + 1)):
            sides = range(near - 2, near + 3)
            if any(side not in range(BEAMS) or np.isnan(across_m[side]) for side in sides):
                continue
            for place, scan in enumerate([before, seen(lidar), after]):
                if scan is None or not scan.looked[near]:
                    continue
                value = scan.ranges_m[near]
                expected[0, place] += 1
                expected[1, place] += bool(np.isfinite(value))
                expected[2, place] += bool(abs(value - 1.05) <= 0.07)
        np.testing.assert_array_equal(
            [counts.looked[i], counts.returned[i], counts.on_line[i]], expected
        )


@given(
    looked=st.integers(2, 60),
    data=st.data(),
    passed=st.floats(0.01, 0.9),
    doubt=st.floats(1e-4, 0.5),
)
def test_a_surface_returns_more_than_a_pane_would_pass(looked, data, passed, doubt):
    on_line = data.draw(st.integers(2, looked))
    tail = binomtest(on_line, looked, passed, alternative="greater").pvalue
    if abs(tail - doubt) < 1e-9:
        return
    assert surface_of([looked, 0, 0], [on_line - 1, 0, 1], passed, doubt) == (tail <= doubt)


def surface_of(looked, on_line, passed=0.17, doubt=0.005, returned=None):
    counts = ReturnsInOpening(
        looked=np.array([looked]),
        returned=np.array([on_line if returned is None else returned]),
        on_line=np.array([on_line]),
    )
    return counts.is_surface(passed, doubt, 0.8)[0]


def test_a_surface_is_seen_in_both_scans_and_little_beside_it():
    assert surface_of([20, 20, 20], [8, 8, 8])
    assert not surface_of([20, 20, 20], [20, 20, 0])
    assert not surface_of([20, 20, 20], [0, 20, 20])
    assert surface_of([20, 20, 20], [8, 8, 8], returned=[10, 10, 10])
    assert not surface_of([20, 20, 20], [8, 8, 8], returned=[10, 10, 11])
    assert not surface_of([0, 0, 0], [0, 0, 0])


@pytest.mark.parametrize("right_m", [3.0, 5.0], ids=["straight", "stepped"])
def test_an_opening_lies_between_what_lasts(right_m):
    """A stepped wall has no line across; what returns once belongs to the opening."""
    surface = np.where(np.arange(BEAMS) < 40, wall(), wall(right_m))
    lost = surface.copy()
    lost[OPENING] = np.nan
    once = lost.copy()
    once[40] = 6.0
    window = window_of(once, before=lost, after=lost)
    found = find_openings(window, nearby_returns(window), np.full(BEAMS, 0.1), 0.5, 0.25)
    if right_m == 3.0:
        np.testing.assert_allclose(found.across_m[OPENING], surface[OPENING], atol=1e-3)
        np.testing.assert_allclose(found.wall_m[OPENING], surface[OPENING], atol=1e-3)
    else:
        assert np.isnan(found.across_m).all()
        np.testing.assert_array_equal(found.wall_m[OPENING], surface[56])
    assert np.isnan(found.across_m[:24]).all()
    np.testing.assert_array_equal(found.wall_m[:24], surface[:24])


# Closed scenes: scans before, at and after an instant through an opening in a wall at 3 m.


def filled_fraction(returned, away_m, settings_=SETTINGS):
    """The opening's beams return with a probability, from a wall so far away, and with a sunlit
    one's noise.

    Fraction of the lost beams well inside the opening that were filled, and the filled values'
    greatest distance from that wall.
    """
    rng = np.random.default_rng(1)
    lost = filled = 0
    off_m = 0.0
    for _ in range(TRIALS):
        scans = wall() + rng.normal(0.0, 0.01, (3, BEAMS))
        back = rng.random((3, OPENING.size)) < returned
        beyond_m = wall(away_m)[OPENING] + rng.normal(0.0, 0.03, (3, OPENING.size))
        scans[:, OPENING] = np.where(back, beyond_m, np.nan)
        before, lidar, after = scans
        value, source = repaired(window_of(lidar, before=before, after=after), settings_)
        is_lost = np.isnan(lidar[INNER])
        is_filled = is_lost & (source[INNER] == NEIGHBOURS)
        lost += is_lost.sum()
        filled += is_filled.sum()
        errors_m = np.abs(value[INNER] - wall(away_m)[INNER])[is_filled]
        off_m = max(off_m, errors_m.max(initial=0.0))
    return filled / lost, off_m


def without_openings():
    return SETTINGS.model_copy(update={"pane_doubt": 0.0})


@pytest.mark.parametrize(("returned", "least"), [(0.3, 0.15), (0.4, 0.45)])
def test_a_sunlit_wall_is_filled(returned, least):
    """Three or four in ten of its beams return, in each scan others."""
    fraction, off_m = filled_fraction(returned, 3.0)
    assert fraction > least
    assert fraction > filled_fraction(returned, 3.0, without_openings())[0] + 0.1
    assert off_m < 0.15


@pytest.mark.parametrize("returned", [0.0, 0.17], ids=["none", "few"])
def test_a_window_with_sill_and_lintel_is_not_filled(returned):
    """All the LiDAR knows of it are the wall on both sides and returns from the yard, at 5 m."""
    fraction, _ = filled_fraction(returned, 5.0)
    assert fraction < 0.01
    assert fraction == filled_fraction(returned, 5.0, without_openings())[0]


@pytest.mark.parametrize("returned", [0.05, 0.15])
def test_behind_a_pane_before_the_wall_next_to_nothing_is_filled(returned):
    fraction, _ = filled_fraction(returned, 3.0)
    assert fraction < 0.01
    assert fraction < filled_fraction(returned, 3.0, without_openings())[0] + 0.005


def test_an_opening_that_a_wall_enters_as_the_robot_moves_is_not_filled():
    """The wall at its left has covered half of the opening in the scan before."""
    lost = wall()
    lost[OPENING] = np.nan
    before = lost.copy()
    before[OPENING[:16]] = 3.0
    _, source = repaired(window_of(lost, before=before, after=lost))
    assert not (source[INNER] == NEIGHBOURS).any()


def test_a_line_between_returns_that_are_not_of_the_wall_is_not_taken_for_the_wall():
    """A sunlit wall returns two beams in five; two of the scan are 0.2 m too near."""
    scans = np.tile(wall(), (3, 1))
    for scan, back in zip(scans, ((0, 2), (1, 3), (2, 4)), strict=True):
        scan[OPENING[~np.isin(OPENING % 5, back)]] = np.nan
    scans[1, 39:42] = 2.8, np.nan, 2.8
    value, source = repaired(window_of(scans[1], before=scans[0], after=scans[2]))
    assert np.isnan(value[40])
    assert source[45] == NEIGHBOURS
    assert value[45] == pytest.approx(wall()[45], abs=1e-3)
