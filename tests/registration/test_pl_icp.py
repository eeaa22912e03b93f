"""PL-ICP: its answers against the truth, and its covariance against what noise really does."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

from fusion_core.model.errors import RegistrationFailed
from fusion_core.registration.match_covariance import UNOBSERVABLE_SIGMA_M
from fusion_core.registration.pl_icp import (
    PlIcpSettings,
    ReferenceScan,
    match_scans,
    match_to_reference,
)
from tests.benchmarks.scan_matching_room import (
    WALLS,
    bound,
    cast,
    compose,
    draw_pair,
    full_turn,
    inverse,
)

CORRIDOR = np.array([[[-50.0, -1.0], [50.0, -1.0]], [[50.0, 1.2], [-50.0, 1.2]]])
TURN = {"angle_min_rad": full_turn(720)[0], "angle_increment_rad": full_turn(720)[1]}


def sweep(pose, walls=WALLS, reach_m=np.inf, sigma_m=0.0, rng=None):
    """(720,) ranges of the full turn, NaN beyond ``reach_m``."""
    angles = TURN["angle_min_rad"] + TURN["angle_increment_rad"] * np.arange(720)
    ranges = cast(walls, np.asarray(pose, dtype=float), angles)[0]
    if rng is not None:
        ranges = ranges + rng.normal(0.0, sigma_m, ranges.shape)
    return np.where(ranges < reach_m, ranges, np.nan)


def matched(pair, **more):
    return match_scans(
        pair.first_m,
        pair.second_m,
        angle_min_rad=pair.angle_min_rad,
        angle_increment_rad=pair.angle_increment_rad,
        **more,
    )


def off(pose, truth):
    """(3,) error of a pose: x, y, wrapped yaw."""
    return np.array([*(pose[:2] - truth[:2]), compose(inverse(truth), pose)[2]])


# --- Whole matches


@pytest.mark.parametrize("seed", range(12))
def test_without_noise_the_match_is_exact(seed):
    pair = draw_pair(np.random.default_rng(seed), 720, 0.5, np.radians(30.0), 0.0)
    match = matched(pair)
    np.testing.assert_allclose(off(match.pose_first_second, pair.pose_first_second), 0, atol=1e-9)
    assert match.converged
    assert match.is_observable
    assert match.inlier_ratio > 0.85
    assert match.rms_error_m < 1e-6


@given(seed=st.integers(0, 10_000))
def test_a_match_is_the_inverse_of_the_match_back(seed):
    pair = draw_pair(np.random.default_rng(seed), 720, 0.3, np.radians(20.0), 0.01)
    there = matched(pair)
    back = match_scans(pair.second_m, pair.first_m, **TURN)
    # Both use the same noise, so they are nearer to each other than to the truth.
    gap = off(compose(there.pose_first_second, back.pose_first_second), np.zeros(3))
    assert gap @ np.linalg.solve(there.covariance, gap) < chi2.ppf(0.99999, 3)


@given(seed=st.integers(0, 10_000))
def test_two_matches_compose(seed):
    rng = np.random.default_rng(seed)
    pose = np.array([5.0, 4.0, rng.uniform(-3.0, 3.0)])
    steps = [np.append(rng.uniform(-0.2, 0.2, 2), rng.uniform(-0.3, 0.3)) for _ in range(2)]
    poses = [pose, compose(pose, steps[0]), compose(compose(pose, steps[0]), steps[1])]
    a, b, c = (sweep(pose, sigma_m=0.01, rng=rng) for pose in poses)
    chain = compose(
        match_scans(a, b, **TURN).pose_first_second, match_scans(b, c, **TURN).pose_first_second
    )
    gap = off(chain, match_scans(a, c, **TURN).pose_first_second)
    assert np.abs(gap[:2]).max() < 0.006
    assert abs(gap[2]) < np.radians(0.06)


@pytest.mark.parametrize("shift", [0.5, -2.0])
def test_the_angle_of_the_first_beam_rotates_the_result(shift):
    pair = draw_pair(np.random.default_rng(4), 720, 0.5, 0.3, 0.01)
    plain = matched(pair)
    turned = match_scans(
        pair.first_m,
        pair.second_m,
        angle_min_rad=pair.angle_min_rad + shift,
        angle_increment_rad=pair.angle_increment_rad,
        guess=compose(compose(np.array([0, 0, shift]), plain.start), np.array([0, 0, -shift])),
    )
    expected = compose(compose(np.array([0, 0, shift]), plain.pose_first_second), [0, 0, -shift])
    np.testing.assert_allclose(off(turned.pose_first_second, expected), 0.0, atol=1e-4)


def test_a_clockwise_sweep_gives_the_same():
    pair = draw_pair(np.random.default_rng(5), 720, 0.5, 0.3, 0.01)
    last = pair.angle_min_rad + pair.angle_increment_rad * 719
    clockwise = match_scans(
        pair.first_m[::-1],
        pair.second_m[::-1],
        angle_min_rad=last,
        angle_increment_rad=-pair.angle_increment_rad,
    )
    np.testing.assert_allclose(
        clockwise.pose_first_second, matched(pair).pose_first_second, atol=1e-9
    )


def test_sweeps_of_different_beams_match():
    rng = np.random.default_rng(6)
    pair = draw_pair(rng, 720, 0.4, 0.4, 0.01)
    reference = ReferenceScan.of(pair.first_m, **TURN)
    match = match_to_reference(
        reference,
        pair.second_m[90:-90:3],
        angle_min_rad=pair.angle_min_rad + 90 * pair.angle_increment_rad,
        angle_increment_rad=3 * pair.angle_increment_rad,
    )
    error = off(match.pose_first_second, pair.pose_first_second)
    assert error @ np.linalg.solve(match.covariance, error) < chi2.ppf(0.999, 3)
    assert np.hypot(error[0], error[1]) < 0.01


@pytest.mark.parametrize("missing", [np.nan, np.inf, 0.0])
def test_missing_beams_do_no_harm(missing):
    pair = draw_pair(np.random.default_rng(7), 720, 0.3, 0.3, 0.01)
    rng = np.random.default_rng(8)
    first, second = pair.first_m.copy(), pair.second_m.copy()
    first[rng.random(720) < 0.3], second[rng.random(720) < 0.3] = missing, missing
    given_first, given_second = first.copy(), second.copy()
    match = match_scans(first, second, **TURN)
    error = off(match.pose_first_second, pair.pose_first_second)
    assert error @ np.linalg.solve(match.covariance, error) < chi2.ppf(0.999, 3)
    np.testing.assert_array_equal(first, given_first)
    np.testing.assert_array_equal(second, given_second)
    with pytest.raises(ValueError, match="read-only"):
        match.pose_first_second[0] = 0.0


def test_outliers_are_trimmed():
    pair = draw_pair(np.random.default_rng(9), 720, 0.3, 0.3, 0.01)
    rng = np.random.default_rng(10)
    second = pair.second_m.copy()
    # A person at 1 m and single returns from nowhere.
    second[100:160] = 1.0 + rng.normal(0.0, 0.01, 60)
    single = rng.random(720) < 0.1
    second[single] = rng.uniform(0.3, 8.0, single.sum())
    match = match_scans(pair.first_m, second, **TURN)
    error = off(match.pose_first_second, pair.pose_first_second)
    assert error @ np.linalg.solve(match.covariance, error) < chi2.ppf(0.9999, 3)
    assert 0.7 < match.inlier_ratio < 0.9


def test_a_bad_guess_falls_back_on_the_search():
    pair = draw_pair(np.random.default_rng(11), 720, 0.2, 0.2, 0.01)
    good = matched(pair, guess=pair.pose_first_second + np.array([0.03, -0.03, 0.02]))
    bad = matched(pair, guess=pair.pose_first_second + np.array([0.9, -0.8, 1.0]))
    assert good.starts == 1
    assert bad.starts == 2
    np.testing.assert_allclose(bad.pose_first_second, good.pose_first_second, atol=1e-3)


# --- What is unobservable


@pytest.mark.parametrize("sigma_m", [0.0, 0.01])
@pytest.mark.parametrize("heading", [0.0, 0.8])
def test_along_a_corridor_the_translation_is_unobservable(sigma_m, heading):
    rng = np.random.default_rng(12)
    move = np.array([0.2, 0.05, 0.1])
    first = sweep((0.0, 0.0, heading), CORRIDOR, 8.0, sigma_m, rng)
    second = sweep(compose(np.array([0.0, 0.0, heading]), move), CORRIDOR, 8.0, sigma_m, rng)
    guess = move + np.array([0.03, 0.02, -0.02])
    for match, kept in (
        (match_scans(first, second, **TURN), np.zeros(3)),
        (match_scans(first, second, guess=guess, **TURN), guess),
    ):
        assert not match.is_observable
        along = np.array([np.cos(heading), -np.sin(heading), 0.0])
        across = np.array([np.sin(heading), np.cos(heading), 0.0])
        np.testing.assert_allclose(np.abs(match.unobservable_directions @ along), [1.0], atol=0.01)
        assert match.covariance @ along @ along == pytest.approx(UNOBSERVABLE_SIGMA_M**2, rel=0.01)
        # Observable directions stay right, and unobservable ones keep the guess.
        error = match.pose_first_second - move
        assert abs(error @ across) < 0.002
        assert abs(error[2]) < 0.001
        assert abs((match.pose_first_second - kept) @ along) < 0.02


def test_a_corridor_with_an_end_is_observable():
    rng = np.random.default_rng(13)
    walls = np.concatenate([CORRIDOR, [[[5.0, -2.0], [5.0, 2.0]]]])
    move = np.array([0.2, 0.05, 0.1])
    first = sweep((0.0, 0.0, 0.0), walls, 8.0, 0.01, rng)
    second = sweep(move, walls, 8.0, 0.01, rng)
    match = match_scans(first, second, **TURN)
    assert match.is_observable
    deviation = np.sqrt(np.diag(match.covariance))
    error = off(match.pose_first_second, move)
    assert (np.abs(error) < 4.0 * deviation).all()
    # A score of beams sees the end, hundreds see the sides.
    assert deviation[0] > 2.0 * deviation[1]


def test_in_a_round_room_the_rotation_is_unobservable():
    rng = np.random.default_rng(14)
    first, second = (3.0 + rng.normal(0.0, 0.01, 720) for _ in range(2))
    match = match_scans(first, second, **TURN)
    assert match.unobservable_directions.shape == (1, 3)
    shift, turn = (
        np.hypot(*match.unobservable_directions[0, :2]),
        abs(match.unobservable_directions[0, 2]),
    )
    assert turn > 100.0 * shift
    assert np.hypot(*match.pose_first_second[:2]) < 0.005
    assert abs(match.pose_first_second[2]) < 1e-3


# --- Failures


@pytest.mark.parametrize("valid", [0, 1, 5, 29])
@pytest.mark.parametrize("which", ["first", "second"])
def test_too_few_beams_fail(valid, which):
    whole, holed = sweep((5.0, 4.0, 0.0)), np.full(720, np.nan)
    holed[:valid] = 2.0
    sweeps = (holed, whole) if which == "first" else (whole, holed)
    with pytest.raises(RegistrationFailed, match=f"{valid} of the {which} sweep's 720 beams"):
        match_scans(*sweeps, **TURN)


def test_an_empty_sweep_fails():
    with pytest.raises(RegistrationFailed, match="0 of the first sweep's 0 beams"):
        match_scans(np.empty(0), np.empty(0), **TURN)


def test_sweeps_of_different_places_fail():
    rng = np.random.default_rng(15)
    room = sweep((5.0, 4.0, 0.0), sigma_m=0.01, rng=rng)
    corridor = sweep((0.0, 0.0, 0.0), CORRIDOR, 8.0, 0.01, rng)
    with pytest.raises(RegistrationFailed, match="do not match from any of 2 starts"):
        match_scans(room, corridor, **TURN)


def test_clutter_fails():
    rng = np.random.default_rng(16)
    with pytest.raises(RegistrationFailed, match="do not match"):
        match_scans(rng.uniform(0.5, 8.0, 720), rng.uniform(0.5, 8.0, 720), **TURN)


@pytest.mark.parametrize("guess", [np.zeros(2), np.array([0.0, np.nan, 0.0])])
def test_a_guess_that_is_none_is_refused(guess):
    whole = sweep((5.0, 4.0, 0.0))
    with pytest.raises(ValueError, match="a guess must be"):
        match_scans(whole, whole, guess=guess, **TURN)


def test_iterations_that_end_early_are_reported():
    pair = draw_pair(np.random.default_rng(17), 720, 0.3, 0.3, 0.01)
    settings = PlIcpSettings(iterations_max=3)
    assert not matched(pair, settings=settings).converged


# --- Accuracy and honesty


@pytest.mark.parametrize(
    ("beams", "shift_m", "turn_deg", "median_m", "median_deg"),
    [
        (720, 0.5, 30.0, 0.9e-3, 0.009),
        (720, 0.2, 45.0, 0.9e-3, 0.009),
        (360, 0.1, 5.0, 1.3e-3, 0.012),
    ],
)
def test_errors_are_small_and_as_large_as_stated(beams, shift_m, turn_deg, median_m, median_deg):
    rng = np.random.default_rng(20240)
    errors, squares = [], []
    for _ in range(200):
        pair = draw_pair(rng, beams, shift_m, np.radians(turn_deg), 0.01)
        match = matched(pair)
        error = off(match.pose_first_second, pair.pose_first_second)
        errors.append(error)
        squares.append(error @ np.linalg.solve(match.covariance, error))
    shift, turn = np.hypot(*np.transpose(errors)[:2]), np.abs(np.transpose(errors)[2])
    assert shift.max() < 0.05
    assert turn.max() < np.radians(1.0)
    assert np.median(shift) <= median_m
    assert np.degrees(np.median(turn)) <= median_deg
    low, high = chi2.ppf([0.025, 0.975], 3 * 200) / 200
    assert low < np.mean(squares) < high


@pytest.mark.parametrize("known", [None, 0.01])
def test_the_covariance_is_that_of_many_draws(known):
    """One pair of places, new noise in both sweeps each time."""
    rng = np.random.default_rng(21)
    poses = np.array([[5.5, 4.4, 0.2], [5.8, 4.2, 0.5]])
    pair = draw_pair(rng, 720, 0.1, 0.1, 0.0)
    truth = compose(inverse(poses[0]), poses[1])
    settings = PlIcpSettings(range_sigma_m=known)
    errors, stated = [], []
    for _ in range(300):
        first, second = (sweep(pose, sigma_m=0.01, rng=rng) for pose in poses)
        match = match_scans(first, second, settings=settings, **TURN)
        errors.append(off(match.pose_first_second, truth))
        stated.append(match.covariance)
    drawn, stated = np.cov(np.transpose(errors)), np.mean(stated, axis=0)
    # In the stated covariance's own units, the drawn one is the identity.
    root = np.linalg.inv(np.linalg.cholesky(stated))
    ratio = np.linalg.eigvalsh(root @ drawn @ root.T)
    assert ratio.min() > 0.7
    assert ratio.max() < 1.4
    # No matcher can be better than the bound; this one is near it.
    pair = type(pair)(
        first_m=pair.first_m,
        second_m=pair.second_m,
        angle_min_rad=pair.angle_min_rad,
        angle_increment_rad=pair.angle_increment_rad,
        pose_first_second=truth,
        poses=poses,
    )
    least = bound(pair, 0.01)
    assert 0.85 < np.sqrt(np.trace(drawn[:2, :2]) / np.trace(least[:2, :2])) < 1.3


def test_the_covariance_grows_with_the_noise():
    pair = draw_pair(np.random.default_rng(22), 720, 0.3, 0.3, 0.0)
    rng = np.random.default_rng(23)
    deviations = []
    for sigma_m in (0.005, 0.02):
        first, second = (
            ranges + rng.normal(0.0, sigma_m, 720) for ranges in (pair.first_m, pair.second_m)
        )
        match = match_scans(first, second, **TURN)
        deviations.append(np.sqrt(np.diag(match.covariance)))
    np.testing.assert_allclose(deviations[1] / deviations[0], 4.0, rtol=0.25)
