"""Correlative matching: the maximum of brute force, and a covariance that shows ambiguity."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import RegistrationFailed
from fusion_core.registration.correlative import SearchWindow, find_best_pose, match_correlative
from fusion_core.registration.likelihood_grid import make_likelihood_pyramid
from tests.benchmarks.scan_matching_room import WALLS, cast, compose, full_turn

SEEDS = st.integers(0, 2**32 - 1)


def sweep(pose, beams=360, walls=WALLS, range_max_m=np.inf):
    """(n, 2) points of a noise-free sweep in the sensor's frame."""
    first, step = full_turn(beams)
    angles = first + step * np.arange(beams)
    ranges = cast(walls, np.asarray(pose, dtype=float), angles)[0]
    ranges = np.where(ranges < range_max_m, ranges, np.nan)
    return ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def moved(points, pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def brute_force(pyramid, points, window, turns):
    """(T, C, C) the score of every pose of the lattice; the yaws, and the cells' offsets."""
    grid = pyramid.levels[0].astype(int)
    truncation_m = int(np.ceil(window.translation_m / pyramid.resolution_m - 1e-9))
    yaws = window.centre[2] + np.linspace(-window.rotation_rad, window.rotation_rad, 2 * turns + 1)
    offsets = np.arange(-truncation_m, truncation_m + 1)
    scores = np.zeros((yaws.size, offsets.size, offsets.size), dtype=int)
    for t, yaw in enumerate(yaws):
        placed = moved(points, np.array([window.centre[0], window.centre[1], yaw]))
        cells = np.floor((placed - pyramid.corner_m) / pyramid.resolution_m).astype(int)
        for i, row in enumerate(offsets):
            for j, column in enumerate(offsets):
                r, c = cells[:, 1] + row, cells[:, 0] + column
                inside = (r >= 0) & (r < grid.shape[0]) & (c >= 0) & (c < grid.shape[1])
                scores[t, i, j] = grid[r[inside], c[inside]].sum()
    return scores, yaws, offsets


def problem(seed):
    """A random map, points that lie partly on it, and a window."""
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-2.0, 2.0, (rng.integers(1, 25), 2))
    points = moved(landmarks, np.append(rng.uniform(-0.4, 0.4, 2), rng.uniform(-0.5, 0.5)))
    points = np.vstack([points, rng.uniform(-4.0, 4.0, (rng.integers(0, 10), 2))])
    resolution, turns = float(rng.uniform(0.05, 0.2)), int(rng.integers(0, 4))
    pyramid = make_likelihood_pyramid(
        landmarks,
        resolution_m=resolution,
        truncation_m=resolution * float(rng.uniform(0.5, 3.0)),
        levels=int(rng.integers(1, 6)),
    )
    window = SearchWindow(
        centre=(float(rng.uniform(-0.5, 0.5)), float(rng.uniform(-0.5, 0.5)), 0.3),
        translation_m=float(rng.uniform(0.0, 5.0)) * resolution,
        rotation_rad=0.4 * (turns > 0),
    )
    return pyramid, points, window, turns


@given(seed=SEEDS)
def test_the_maximum_is_that_of_brute_force(seed):
    pyramid, points, window, turns = problem(seed)
    scores, yaws, offsets = brute_force(pyramid, points, window, turns)
    step = window.rotation_rad / max(turns, 1) or None
    if scores.max() == 0:
        with pytest.raises(RegistrationFailed, match="no pose within"):
            match_correlative(pyramid, points, window, step_rad=step)
        return
    match = match_correlative(pyramid, points, window, step_rad=step)
    assert match.score == scores.max() / (255 * len(points))
    # Ties leave the choice open; the pose must be one that brute force scores as high.
    t = np.abs(yaws - match.pose_map_points[2]).argmin()
    column, row = (match.pose_map_points[:2] - window.centre[:2]) / pyramid.resolution_m
    i, j = (np.abs(offsets - offset).argmin() for offset in (row, column))
    assert scores[t, i, j] == scores.max()
    np.testing.assert_allclose(
        match.pose_map_points,
        [
            window.centre[0] + offsets[j] * pyramid.resolution_m,
            window.centre[1] + offsets[i] * pyramid.resolution_m,
            yaws[t],
        ],
        atol=1e-12,
    )


@given(seed=SEEDS)
def test_the_covariance_is_that_of_all_poses(seed):
    pyramid, points, window, turns = problem(seed)
    scores, yaws, offsets = brute_force(pyramid, points, window, turns)
    if scores.max() == 0:
        return
    step = window.rotation_rad / max(turns, 1)
    match = match_correlative(pyramid, points, window, step_rad=step or None)
    weights = np.exp(2.0 / 255.0 * (scores - scores.max()))
    turn, row, column = np.meshgrid(yaws, offsets, offsets, indexing="ij")
    resolution = pyramid.resolution_m
    poses = np.stack([column * resolution, row * resolution, turn], axis=-1).reshape(-1, 3)
    expected = np.cov(poses.T, aweights=weights.ravel(), ddof=0) if len(poses) > 1 else 0.0
    expected = expected + np.diag([resolution**2 / 12, resolution**2 / 12, match.step_rad**2 / 3])
    # What is left out weighs less than exp(-10) each.
    largest = np.ptp(poses, axis=0).max() ** 2 * len(poses) * np.exp(-10.0)
    np.testing.assert_allclose(match.covariance, expected, atol=largest + 1e-12)


@given(seed=SEEDS)
def test_each_level_holds_the_maxima_of_its_blocks(seed):
    rng = np.random.default_rng(seed)
    pyramid = make_likelihood_pyramid(
        rng.uniform(-1.0, 1.0, (rng.integers(1, 12), 2)),
        resolution_m=0.1,
        truncation_m=0.15,
        levels=int(rng.integers(2, 5)),
    )
    ground = pyramid.levels[0]
    for level, values in enumerate(pyramid.levels):
        size = 2**level
        padded = np.pad(ground, ((0, size - 1), (0, size - 1)))
        blocks = np.lib.stride_tricks.sliding_window_view(padded, (size, size))
        np.testing.assert_array_equal(values, blocks.max(axis=(2, 3)))


@given(seed=SEEDS)
def test_a_cell_is_the_likelihood_at_its_centre(seed):
    rng = np.random.default_rng(seed)
    landmarks = rng.uniform(-1.0, 1.0, (rng.integers(1, 12), 2))
    truncation_m = float(rng.uniform(0.05, 0.4))
    pyramid = make_likelihood_pyramid(
        landmarks, resolution_m=0.1, truncation_m=truncation_m, levels=3
    )
    rows, columns = np.indices(pyramid.levels[0].shape)
    middles = np.stack([columns, rows], axis=-1) * 0.1 + pyramid.corner_m + 0.05
    squared = ((middles[:, :, None] - landmarks) ** 2).sum(axis=-1).min(axis=-1)
    expected = 255.0 * np.maximum(1.0 - squared / truncation_m**2, 0.0)
    np.testing.assert_allclose(pyramid.levels[0], expected, atol=0.5 + 1e-6)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -3.0])
def test_one_pyramid_finds_every_sweep_of_its_room(yaw):
    origin = (5.0, 4.0, 0.0)
    pyramid = make_likelihood_pyramid(
        sweep(origin, 1440), resolution_m=0.05, truncation_m=0.1, levels=6
    )
    window = SearchWindow(translation_m=1.5, rotation_rad=np.pi)
    for x, y in ((0.0, 0.0), (1.2, -0.4), (-0.8, 1.3)):
        points = sweep(compose(np.array(origin), np.array([x, y, yaw])))
        match = match_correlative(pyramid, points, window)
        assert np.hypot(*(match.pose_map_points[:2] - (x, y))) < 0.06
        assert abs(match.pose_map_points[2] - yaw) < 0.01
        np.testing.assert_array_equal(
            find_best_pose(pyramid, points, window), match.pose_map_points
        )
        # Brute force would score each of the lattice's poses.
        poses = (2 * np.pi / match.step_rad) * (2 * 1.5 / 0.05) ** 2
        assert match.poses_scored < 0.01 * poses


def test_a_corridor_leaves_its_length_open():
    walls = np.array([[[-50.0, -1.0], [50.0, -1.0]], [[50.0, 1.2], [-50.0, 1.2]]])
    # Dense enough that neighbouring points of the map are nearer than the likelihood's
    # truncation_m.
    dense = sweep((0.0, 0.0, 0.0), 2880, walls=walls, range_max_m=8.0)
    pyramid = make_likelihood_pyramid(dense, resolution_m=0.1, truncation_m=0.2, levels=5)
    seen = sweep((0.0, 0.0, 0.0), walls=walls, range_max_m=4.0)
    match = match_correlative(pyramid, seen, SearchWindow(translation_m=2.0, rotation_rad=0.3))
    deviation = np.sqrt(np.diag(match.covariance))
    assert deviation[0] > 0.5
    assert deviation[1] < 0.06


def test_two_similar_places_give_a_large_covariance():
    corner = np.array([(0.1 * k, 0.0) for k in range(15)] + [(0.0, 0.1 * k) for k in range(1, 15)])
    once = make_likelihood_pyramid(corner, resolution_m=0.1, truncation_m=0.2, levels=4)
    twice = make_likelihood_pyramid(
        np.vstack([corner, corner + 1.5]), resolution_m=0.1, truncation_m=0.2, levels=4
    )
    window = SearchWindow(translation_m=2.0, rotation_rad=0.2)
    assert np.sqrt(match_correlative(once, corner, window).covariance[0, 0]) < 0.15
    # Two equally good poses with a distance of 1.5 m along x: a standard deviation of half of it.
    assert np.sqrt(match_correlative(twice, corner, window).covariance[0, 0]) == pytest.approx(
        0.75, abs=0.1
    )


def test_missing_points_are_left_out():
    points = sweep((5.0, 4.0, 0.0))
    pyramid = make_likelihood_pyramid(points, resolution_m=0.1, truncation_m=0.2, levels=4)
    window = SearchWindow(translation_m=0.5, rotation_rad=0.2)
    holed = points.copy()
    holed[::3] = np.nan
    match = match_correlative(pyramid, holed, window)
    given_alone = match_correlative(pyramid, holed[np.isfinite(holed).all(axis=1)], window)
    assert match.score == given_alone.score
    np.testing.assert_array_equal(match.pose_map_points, given_alone.pose_map_points)


def test_a_match_that_is_none_fails():
    points = sweep((5.0, 4.0, 0.0))
    pyramid = make_likelihood_pyramid(points, resolution_m=0.1, truncation_m=0.2, levels=4)
    window = SearchWindow(translation_m=0.5, rotation_rad=0.2)
    with pytest.raises(RegistrationFailed, match="no point"):
        match_correlative(pyramid, np.full((5, 2), np.nan), window)
    far = SearchWindow(centre=(100.0, 0.0, 0.0), translation_m=0.5, rotation_rad=0.2)
    with pytest.raises(RegistrationFailed, match=r"no pose within 0\.5 m"):
        match_correlative(pyramid, points, far)
    shape = 3.0 * np.stack([np.cos(np.arange(60)), np.sin(np.arange(60))], axis=1)
    score = match_correlative(pyramid, shape, window).score
    assert match_correlative(pyramid, shape, window, score_min=score - 1e-3).score == score
    with pytest.raises(RegistrationFailed, match="scores more than"):
        match_correlative(pyramid, shape, window, score_min=score)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"points_m": np.zeros((3, 3))}, r"must be \(n, 2\)"),
        ({"points_m": np.full((3, 2), np.nan)}, "at least one point"),
        ({"points_m": np.array([[0.0, 0.0], [1e7, 1e7]])}, "too many"),
        ({"resolution_m": 0.0}, "positive"),
        ({"levels": 0}, "positive"),
    ],
)
def test_a_map_that_is_none_is_refused(wrong, text):
    right = {"points_m": np.zeros((1, 2)), "resolution_m": 0.1, "truncation_m": 0.2, "levels": 2}
    with pytest.raises(ValueError, match=text):
        make_likelihood_pyramid(**(right | wrong))


@pytest.mark.parametrize(
    ("translation", "rotation", "text"),
    [(-0.1, 0.1, "not negative"), (np.nan, 0.1, "finite"), (0.1, 3.2, "between 0 and pi")],
)
def test_a_window_that_is_none_is_refused(translation, rotation, text):
    with pytest.raises(ValueError, match=text):
        SearchWindow(translation_m=translation, rotation_rad=rotation)


def test_a_window_beyond_reason_is_refused():
    pyramid = make_likelihood_pyramid(
        np.zeros((1, 2)), resolution_m=0.01, truncation_m=0.02, levels=2
    )
    with pytest.raises(ValueError, match="too many poses"):
        match_correlative(
            pyramid, np.ones((3, 2)), SearchWindow(translation_m=500.0, rotation_rad=np.pi)
        )
