"""The interpolated grid and the pose that fits it best."""

import numpy as np
import pytest

from fusion_core.model.planar_poses import compose_poses, transform_planar_points
from fusion_core.slam.scan_to_grid import (
    FULL,
    INFORMATION_OF_A_SCAN,
    LatticeSearch,
    ProbabilityGrid,
    correlative_match,
    interpolate,
    match_scan,
)

RESOLUTION_M = 0.05


def at_origin(cells):
    return ProbabilityGrid(cells, (0.0, 0.0), RESOLUTION_M)


def search(prior_weight):
    return LatticeSearch(
        translation_m=0.2,
        rotation_rad=0.1,
        step_rad=0.02,
        prior_weight=prior_weight,
        point_stride=1,
    )


def field(grid, x, y):
    out = np.empty(3)
    interpolate(grid, x, y, out)
    return out


def box_grid(width=120, height=90):
    """Walls three cells thick, the middle one darkest, along the sides of a room."""
    grid = np.zeros((height, width), dtype=np.uint8)
    for inset, value in ((9, 90), (10, 230), (11, 90)):
        grid[inset, inset : width - inset] = np.maximum(grid[inset, inset : width - inset], value)
        grid[height - 1 - inset, inset : width - inset] = value
        grid[inset : height - inset, inset] = value
        grid[inset : height - inset, width - 1 - inset] = value
    return grid


def box_points(pose, width=120, height=90, spacing_m=0.03):
    """Points on the middles of the walls, as a scan at ``pose`` has them."""
    left, right = 10.5 * RESOLUTION_M, (width - 10.5) * RESOLUTION_M
    low, high = 10.5 * RESOLUTION_M, (height - 10.5) * RESOLUTION_M
    x, y = np.arange(left, right, spacing_m), np.arange(low, high, spacing_m)
    walls = [np.stack([x, np.full_like(x, at)], axis=1) for at in (low, high)]
    walls += [np.stack([np.full_like(y, at), y], axis=1) for at in (left, right)]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return (np.concatenate(walls) - pose[:2]) @ np.array([[c, -s], [s, c]])


def test_a_cell_has_its_own_value_in_its_middle():
    grid = np.random.default_rng(1).integers(0, 256, (9, 11), dtype=np.uint8)
    for row, column in ((1, 1), (4, 5), (6, 8)):
        assert field(grid, column + 0.5, row + 0.5)[0] == pytest.approx(grid[row, column] / FULL)


def test_the_slopes_are_those_of_the_value():
    rng = np.random.default_rng(2)
    grid = rng.integers(0, 256, (20, 30), dtype=np.uint8)
    step = 1e-5
    for x, y in rng.uniform([2.6, 2.6], [27.4, 17.4], (200, 2)):
        value_x = field(grid, x + step, y)[0] - field(grid, x - step, y)[0]
        value_y = field(grid, x, y + step)[0] - field(grid, x, y - step)[0]
        np.testing.assert_allclose(
            field(grid, x, y)[1:], np.array([value_x, value_y]) / (2.0 * step), atol=1e-6
        )


def test_a_plane_is_interpolated_exactly():
    rows, columns = np.mgrid[0:12, 0:12]
    grid = (10 * columns + 5 * rows).astype(np.uint8)
    for x, y in ((3.2, 4.7), (6.5, 6.5), (8.9, 3.1)):
        np.testing.assert_allclose(
            field(grid, x, y) * FULL, [10 * (x - 0.5) + 5 * (y - 0.5), 10.0, 5.0], rtol=1e-12
        )


def test_outside_there_is_nothing():
    grid = np.full((8, 8), 255, dtype=np.uint8)
    for x, y in ((-3.0, 4.0), (4.0, 100.0), (0.9, 4.0), (4.0, 7.2)):
        assert (field(grid, x, y) == 0.0).all()


@pytest.mark.parametrize("seed", range(5))
def test_a_scan_is_found_where_it_is(seed):
    rng = np.random.default_rng(seed)
    truth = np.array([3.1, 2.2, rng.uniform(-3.0, 3.0)])
    corner_m = (-1.0, 4.0)
    points_m = box_points(truth)
    truth = truth + np.array([*corner_m, 0.0])
    start = truth + rng.uniform(-1.0, 1.0, 3) * [0.05, 0.05, 0.02]
    match = match_scan(ProbabilityGrid(box_grid(), corner_m, RESOLUTION_M), points_m, start)
    np.testing.assert_allclose(match.pose_grid_scan, truth, atol=5e-4)
    assert match.occupancy == pytest.approx(230 / 255, abs=0.02)


def test_no_pose_nearby_costs_less():
    rng = np.random.default_rng(3)
    truth = np.array([3.0, 2.0, 0.4])
    points_m = box_points(truth) + rng.normal(0.0, 0.02, (box_points(truth).shape[0], 2))
    predicted, sigma = truth + np.array([0.04, -0.02, 0.01]), (0.1, 0.05)
    grid = box_grid()
    match = match_scan(at_origin(grid), points_m, predicted, predicted=predicted, prior_sigma=sigma)

    def cost(pose):
        cells = transform_planar_points(pose, points_m) / RESOLUTION_M
        residuals = np.array([1.0 - field(grid, x, y)[0] for x, y in cells])
        away = (pose - predicted) / [sigma[0], sigma[0], sigma[1]]
        return INFORMATION_OF_A_SCAN * (residuals**2).mean() + (away**2).sum()

    best = cost(match.pose_grid_scan)
    for away in rng.normal(0.0, 1.0, (30, 3)):
        assert cost(match.pose_grid_scan + away * [0.005, 0.005, 0.003]) > best


def test_a_corridor_leaves_its_length_open():
    grid = np.zeros((60, 400), dtype=np.uint8)
    for row in (15, 40):
        grid[row - 1 : row + 2] = np.array([[90], [230], [90]])
    x = np.arange(-3.0, 3.0, 0.04)
    middle_m = 28.0 * RESOLUTION_M
    walls = np.concatenate(
        [np.stack([x, np.full_like(x, (row + 0.5) * RESOLUTION_M)], axis=1) for row in (15, 40)]
    )
    yaw = 0.5
    pose = np.array([10.0, middle_m, yaw])
    c, s = np.cos(yaw), np.sin(yaw)
    # On the crest of a wall the field is flat and has no gradient: points have noise.
    walls[:, 1] += np.random.default_rng(1).normal(0.0, 0.015, len(walls))
    points_m = (walls - [0.0, middle_m]) @ np.array([[c, -s], [s, c]])
    predicted = pose + np.array([0.03, 0.02, 0.0])
    match = match_scan(
        at_origin(grid),
        points_m,
        predicted,
        predicted=predicted,
        prior_sigma=(0.1, 0.1),
    )
    # Along the corridor the prediction holds, across it the walls do.
    np.testing.assert_allclose(match.pose_grid_scan, [10.03, middle_m, yaw], atol=4e-3)
    along = np.array([c, -s, 0.0])
    across = np.array([s, c, 0.0])
    assert along @ match.information @ along < 1.0
    assert across @ match.information @ across > 1e3


def test_the_window_finds_the_best_of_all_its_poses():
    grid = box_grid()
    truth = np.array([3.0, 2.0, 0.0])
    points_m = box_points(truth)
    predicted = compose_poses(truth, np.array([0.1, -0.15, 0.06]))
    found = correlative_match(at_origin(grid), points_m, predicted, search((0.0, 0.0)))
    np.testing.assert_allclose(found[:2], truth[:2], atol=RESOLUTION_M)
    assert found[2] == pytest.approx(0.0, abs=0.021)
    cautious = correlative_match(at_origin(grid), points_m, predicted, search((1e3, 1e3)))
    assert (cautious == predicted).all()


@pytest.mark.parametrize("shape", [(0, 2), (5, 3), (5,)])
def test_points_that_are_none_are_refused(shape):
    with pytest.raises(ValueError, match="points_m must be"):
        match_scan(at_origin(box_grid()), np.zeros(shape), np.zeros(3))
