"""Two runs compared: one scale, one frame, and how far their trajectories differ."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.colors import difference_colors
from scanloom.plots.run_comparison import (
    RunOnMap,
    TrajectoryDifference,
    compare_trajectories,
    comparison_picture,
    transform_grid,
    transform_points,
)


def straight(begin: tuple[float, float], end: tuple[float, float], count: int = 50) -> np.ndarray:
    """(N, 3) poses along a line."""
    points = np.linspace(begin, end, count)
    return np.column_stack([points, np.zeros(count)])


coordinate = st.floats(-50.0, 50.0)
frames = st.builds(
    lambda x, y, yaw: np.array([x, y, yaw]), coordinate, coordinate, st.floats(-3.1, 3.1)
)


def in_frame(poses: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """(N, 3) poses by complex numbers."""
    points = (poses[:, 0] + 1j * poses[:, 1]) * np.exp(1j * frame[2]) + frame[0] + 1j * frame[1]
    return np.column_stack([points.real, points.imag, poses[:, 2] + frame[2]])


def run_of(poses: np.ndarray, first_ns: int = 0, step_ns: int = 10**8) -> RunOnMap:
    stamps_ns = first_ns + step_ns * np.arange(len(poses), dtype=np.int64)
    return RunOnMap(title="run", stamps_ns=stamps_ns, poses=poses, grid=None)


def spiral(count: int = 80) -> np.ndarray:
    turn = np.linspace(0.0, 9.0, count)
    return np.column_stack([turn * np.cos(turn), turn * np.sin(turn), turn + 1.3])


@given(frame=frames)
def test_the_same_trajectory_in_another_frame_has_no_distance(frame: np.ndarray) -> None:
    found = compare_trajectories(run_of(in_frame(spiral(), frame)), run_of(spiral()))
    assert found is not None
    assert found.distances_m.max() < 1e-9
    assert np.allclose(
        transform_points(spiral(), found.second_in_first), in_frame(spiral(), frame)[:, :2]
    )


@given(frame=frames, seed=st.integers(0, 99))
def test_only_drift_is_a_distance(frame: np.ndarray, seed: int) -> None:
    drift_m = np.random.default_rng(seed).normal(size=(80, 2)).cumsum(axis=0)
    drift_m -= drift_m[0]
    drifted = spiral() + np.column_stack([drift_m, np.zeros(80)])
    found = compare_trajectories(run_of(spiral()), run_of(in_frame(drifted, frame)))
    assert found is not None
    assert np.allclose(found.distances_m, np.linalg.norm(drift_m, axis=1), atol=1e-9)
    assert np.allclose(found.times_s, 0.1 * np.arange(80))


def test_trajectories_of_other_stamps_are_compared_where_both_are() -> None:
    line = straight((0.0, 0.0), (7.9, 0.0), 80)
    # Each third of a step, from the tenth on.
    between = straight((1.0, 0.0), (6.0, 0.0), 151)
    found = compare_trajectories(run_of(line), run_of(between, 10**9, 10**8 // 3))
    assert found is not None
    assert found.times_s.size == 50
    assert found.distances_m.max() < 1e-6
    assert compare_trajectories(run_of(line), run_of(line, 10**12)) is None


@settings(max_examples=30)
@given(frame=frames, row=st.integers(2, 17), column=st.integers(2, 27))
def test_a_moved_map_has_each_obstacle_where_it_belongs(
    frame: np.ndarray, row: int, column: int
) -> None:
    log_odds = np.full((20, 30), -5.0)
    log_odds[row, column] = 5.0
    grid = OccupancyGrid(resolution_m=0.5, origin_m=(-3.0, 4.0), log_odds=log_odds)
    moved = transform_grid(grid, frame)
    rows, columns = np.nonzero(np.nan_to_num(moved.log_odds) > 0.0)
    assert 2 <= rows.size <= 8
    at_m = np.array(moved.origin_m) + moved.resolution_m * (
        np.column_stack([columns, rows]).mean(axis=0) + 0.5
    )
    middle = np.array([[-3.0 + 0.5 * (column + 0.5), 4.0 + 0.5 * (row + 0.5), 0.0]])
    assert at_m == pytest.approx(in_frame(middle, frame)[0, :2], abs=0.15)


def test_two_runs_stand_side_by_side_on_one_scale() -> None:
    first = RunOnMap(
        title="1", stamps_ns=np.arange(50), poses=straight((0.0, 0.0), (4.0, 0.0)), grid=None
    )
    second = RunOnMap(
        title="2", stamps_ns=np.arange(50), poses=straight((0.0, 0.0), (2.0, 0.0)), grid=None
    )
    found: TrajectoryDifference | None = compare_trajectories(first, second)
    assert found is not None
    picture = comparison_picture(
        first, second, second_in_first=found.second_in_first, width_px=480, height_px=600
    )
    unknown = (picture == picture[30, 20]).all(axis=2)
    assert unknown[30, 460]
    widths = []
    for color, half in zip(difference_colors(2)[2:4], (np.s_[:236], np.s_[244:]), strict=True):
        near = np.abs(picture[30:100].astype(int) - color).max(axis=2) < 60
        widths.append(np.ptp(np.flatnonzero(near[:, half].any(axis=0))))
    assert widths[0] / widths[1] == pytest.approx(2.0, rel=0.12)


def grid_with_wall() -> OccupancyGrid:
    """20 m x 10 m, free, with a wall at x = 5 m."""
    log_odds = np.full((100, 200), -5.0)
    log_odds[:, 150] = 5.0
    return OccupancyGrid(resolution_m=0.1, origin_m=(-10.0, -5.0), log_odds=log_odds)


def test_a_trajectory_lies_on_its_map() -> None:
    run = RunOnMap(
        title="1",
        stamps_ns=np.arange(50),
        poses=straight((-8.0, 2.0), (2.0, 2.0)),
        grid=grid_with_wall(),
    )
    found = compare_trajectories(run, run)
    assert found is not None
    picture = comparison_picture(
        run, run, second_in_first=found.second_in_first, width_px=960, height_px=800
    )
    half = picture[:, :480]
    free = (half > 245).all(axis=2)
    rows = np.flatnonzero(free.sum(axis=1) > 150)
    rows = rows[(rows > 40) & (rows < 255)]
    dark = (half[rows] < 40).all(axis=2)
    (wall,) = np.flatnonzero(dark.mean(axis=0) > 0.9)[:1]
    near = np.abs(half[rows].astype(int) - difference_colors(2)[2]).max(axis=2) < 60
    x = np.flatnonzero(near.any(axis=0))
    y = np.flatnonzero(near.any(axis=1))
    # The window has a margin of a fiftieth on each side.
    px_per_m = 466.0 / 20.8
    # It ends 3 m before the wall, and begins under its ring.
    assert wall - x.max() == pytest.approx(3.0 * px_per_m, abs=3.0)
    assert wall - x.min() == pytest.approx(13.0 * px_per_m, abs=8.0)
    assert np.ptp(y) <= 6
