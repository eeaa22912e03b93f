"""Submaps: what they hold, and that a finished one is only cropped."""

import numpy as np
import pytest

from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.slam.submaps import GrowingSubmap, SubmapSettings

SETTINGS = SubmapSettings(max_range_m=5.0)


def points(rng, count=60):
    angle, distance = rng.uniform(-1.5, 1.5, count), rng.uniform(1.0, 4.5, count)
    return np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)


@pytest.mark.parametrize("step_m", [0.2, 6.0])
def test_it_is_the_grid_of_its_scans(step_m):
    """The same scans through the final maps' builder, which is tested on its own; with long steps
    the grid must grow."""
    rng = np.random.default_rng(1)
    submap = GrowingSubmap(np.array([10.0, -3.0]), 7, 6.0 * step_m, SETTINGS)
    builder = GridBuilder(
        GridSettings(p_hit=0.6, p_miss=0.48, p_lowest=0.02, p_highest=0.98, resolution_m=0.05)
    )
    for step in range(6):
        pose = np.array([10.0 + step_m * step, -3.0, 0.3 * step])
        points_m = points(rng)
        submap.add_scan(pose, points_m)
        builder.add_scan(
            pose, np.arctan2(points_m[:, 1], points_m[:, 0]), np.hypot(*points_m.T), 100.0
        )
    finished, expected = submap.finish(13), builder.build()
    assert (finished.first, finished.end) == (7, 13)
    assert finished.grid.corner_m == pytest.approx(expected.origin_m)
    probability = np.where(expected.known, expected.probability, 0.0)
    assert finished.grid.cells.shape == probability.shape
    # An end point that lies on a cell's border by rounding may fall to either side.
    differs = np.abs(finished.grid.cells / 255.0 - probability) > 0.003
    assert differs.mean() < 1e-3


def test_its_obstacles_lie_where_points_were():
    submap = GrowingSubmap(np.zeros(2), 0, 1.0, SETTINGS)
    pose, points_m = np.array([0.2, 0.1, 0.7]), np.array([[2.0, 0.5], [3.0, -1.0], [1.5, 1.5]])
    submap.add_scan(pose, points_m)
    obstacles_m = submap.finish(1).obstacles_m()
    assert obstacles_m.shape == (3, 2)
    for point_m in transform_planar_points(pose, points_m):
        assert np.abs(obstacles_m - point_m).max(axis=1).min() <= 0.025 + 1e-9


def test_a_match_does_not_depend_on_the_grid_size():
    """Cells at the edge of the known area have as many neighbours as any other."""
    submap = GrowingSubmap(np.zeros(2), 0, 1.0, SETTINGS)
    submap.add_scan(np.zeros(3), np.array([[2.0, 0.0], [0.0, 3.0], [-2.5, 0.0], [0.0, -1.5]]))
    rows, columns = np.nonzero(submap.grid.cells)
    shape = submap.grid.cells.shape
    assert min(rows.min(), columns.min()) >= 3
    assert shape[0] - 1 - rows.max() >= 3
    assert shape[1] - 1 - columns.max() >= 3
    # Scans that fill the padding, so that the grid must grow again.
    submap.add_scan(np.zeros(3), np.array([[4.9, 0.0]]))
    rows, columns = np.nonzero(submap.grid.cells)
    assert submap.grid.cells.shape[1] - 1 - columns.max() >= 3


def test_points_beyond_its_limits_are_left_out():
    submap = GrowingSubmap(np.zeros(2), 0, 1.0, SETTINGS)
    submap.add_scan(np.zeros(3), np.array([[2.0, 0.0], [50.0, 0.0]]))
    assert submap.finish(1).obstacles_m() == pytest.approx(np.array([[2.025, 0.025]]))
    submap.add_scan(np.array([80.0, 0.0, 0.0]), np.array([[2.0, 0.0]]))
    assert submap.finish(2).obstacles_m().shape == (1, 2)


def test_without_a_point_it_is_one_free_cell():
    submap = GrowingSubmap(np.zeros(2), 0, 1.0, SETTINGS)
    submap.add_scan(np.zeros(3), np.zeros((0, 2)))
    finished = submap.finish(1)
    assert finished.grid.cells.shape == (1, 1)
    assert finished.obstacles_m().size == 0
