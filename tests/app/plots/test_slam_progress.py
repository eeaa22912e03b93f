"""A run from above: to scale, y upwards, and nothing in another's colour."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.slam_view import SlamView
from fusion_core.workflows.map.colors import difference_colors
from scanloom.plots.palette import Color, color_map
from scanloom.plots.run_comparison import (
    Apart,
    WayOnMap,
    apart,
    moved_grid,
    moved_points,
    runs_picture,
)
from scanloom.plots.slam_progress import (
    LOOP,
    UNTRUSTED,
    WAY,
    Window,
    live_picture,
    run_picture,
    window_around,
)
from scanloom.plots.time_picture import Course, time_picture

WINDOW: Window = (np.array([-10.0, -5.0]), np.array([10.0, 5.0]))
NO_LOOPS = np.empty((0, 4))


def view(
    poses: np.ndarray,
    particles: np.ndarray | None = None,
    weights: np.ndarray | None = None,
    loops_m: np.ndarray = NO_LOOPS,
) -> SlamView:
    many = 0 if particles is None else len(particles)
    return SlamView(
        stage="matching scans",
        stamps_ns=np.arange(len(poses), dtype=np.int64),
        poses_map_scan=poses,
        particles=np.empty((0, 3)) if particles is None else particles,
        weights=np.full(many, 1.0 / max(many, 1)) if weights is None else weights,
        effective=np.full(len(poses) if many else 0, np.nan),
        loops_m=loops_m,
    )


def straight(begin: tuple[float, float], end: tuple[float, float], count: int = 50) -> np.ndarray:
    """(N, 3) poses along a line."""
    points = np.linspace(begin, end, count)
    return np.column_stack([points, np.zeros(count)])


def pixels_of(picture: np.ndarray, color: Color, rows: slice = np.s_[:]) -> np.ndarray:
    """(N, 2) x, y of the pixels that have exactly a colour."""
    y, x = np.nonzero((picture[rows] == color).all(axis=2))
    return np.column_stack([x, y + (rows.start or 0)])


def drawn(moment: SlamView, height_px: int = 400) -> np.ndarray:
    return live_picture(moment, WINDOW, width_px=480, height_px=height_px)


# Above the scale bar and the legend.
PLOT = np.s_[:280]


def scale_bar_px(picture: np.ndarray) -> int:
    """The longest dark run of pixels of any row below the plot."""
    dark = (picture[PLOT.stop :] < 60).all(axis=2)
    longest = 0
    for row in dark:
        ends = np.flatnonzero(np.diff(np.concatenate([[0], row, [0]])))
        longest = max(longest, int((ends[1::2] - ends[::2]).max(initial=0)))
    return longest


def test_a_way_is_to_scale_and_y_upwards() -> None:
    # 5 m, as long as the bar is for a window of 20 m.
    along = drawn(view(straight((-4.0, 0.0), (1.0, 0.0))))
    x, y = pixels_of(along, WAY, PLOT).T
    assert np.ptp(y) <= 4
    # Ring and triangle cover its ends.
    middle = (x.min() + x.max()) / 2
    up = drawn(view(straight((-4.0, 0.0), (-4.0, 4.0))))
    assert pixels_of(up, WAY, PLOT)[:, 1].min() < y.min() - 60
    bar_px = scale_bar_px(along)
    moved = drawn(view(straight((1.0, 0.0), (6.0, 0.0))))
    x_moved = pixels_of(moved, WAY, PLOT)[:, 0]
    assert (x_moved.min() + x_moved.max()) / 2 - middle == pytest.approx(bar_px, abs=1.5)


def test_loops_are_lines_between_their_ends() -> None:
    poses = straight((-8.0, -2.0), (8.0, -2.0))
    assert len(pixels_of(drawn(view(poses)), LOOP, PLOT)) == 0
    closed = drawn(view(poses, loops_m=np.array([[-6.0, -2.0, -6.0, 3.0]])))
    x, y = pixels_of(closed, LOOP, PLOT).T
    assert np.ptp(x) <= 5
    assert np.ptp(y) > 100


def test_a_heavier_particle_is_brighter_and_on_top() -> None:
    poses = straight((-1.0, 0.0), (0.0, 0.0))
    weights = np.array([0.96, 0.01, 0.01, 0.01, 0.01])
    apart_m = np.column_stack([np.arange(5.0) - 8.0, np.full(5, 3.0), np.zeros(5)])
    picture = drawn(view(poses, apart_m, weights), 600)
    colors = color_map("viridis")
    heaviest, light = tuple(colors[-1].tolist()), tuple(colors[round(255 * 0.05 / 3)].tolist())
    bright = pixels_of(picture, heaviest, PLOT)
    dim = pixels_of(picture, light, PLOT)
    assert len(bright) > 4
    assert len(dim) > 16
    assert bright[:, 0].max() < dim[:, 0].min()
    together = np.tile([[-8.0, 3.0, 0.0]], (5, 1))
    covered = drawn(view(poses, together, weights[::-1].copy()), 600)
    assert len(pixels_of(covered, heaviest, PLOT)) > 4
    assert len(pixels_of(covered, light, PLOT)) == 0


def test_the_window_stays_until_something_leaves_it() -> None:
    assert window_around(view(np.empty((0, 3)))) is None
    begin = window_around(view(straight((0.0, 0.0), (4.0, 0.0))))
    assert begin is not None
    assert (begin[0] <= (0.0, -1.0)).all()
    assert (begin[1] >= (4.0, 1.0)).all()
    assert window_around(view(straight((0.0, 0.0), (4.1, 0.3))), begin) is begin
    grown = window_around(view(straight((0.0, 0.0), (40.0, 0.0))), begin)
    assert grown is not None
    assert grown[1][0] > 40.0
    assert (grown[0] <= begin[0]).all()
    strayed = np.array([[0.0, 99.0, 0.0]])
    assert window_around(view(straight((0.0, 0.0), (4.0, 0.0)), strayed), begin)[1][1] > 99.0  # type: ignore[index]  # a way gives a window


def grid_with_wall() -> OccupancyGrid:
    """20 m x 10 m, free, with a wall at x = 5 m."""
    log_odds = np.full((100, 200), -5.0)
    log_odds[:, 150] = 5.0
    return OccupancyGrid(resolution_m=0.1, origin_m=(-10.0, -5.0), log_odds=log_odds)


def finished(trusted: np.ndarray, loops_m: np.ndarray = NO_LOOPS) -> np.ndarray:
    return run_picture(
        "1: a run",
        grid_with_wall(),
        straight((-8.0, 2.0), (2.0, 2.0)),
        trusted,
        loops_m,
        width_px=480,
        height_px=600,
    )


def test_what_cannot_be_trusted_has_its_colour_and_only_that() -> None:
    trusted = np.ones(50, dtype=bool)
    whole = finished(trusted)
    assert len(pixels_of(whole, UNTRUSTED)) == 0
    x_way = pixels_of(whole, WAY, np.s_[:200])[:, 0]
    trusted[20:30] = False
    x_lost = pixels_of(finished(trusted), UNTRUSTED, np.s_[:200])[:, 0]
    share = (x_lost - x_way.min()) / np.ptp(x_way)
    assert share.min() == pytest.approx(20 / 49, abs=0.03)
    assert share.max() == pytest.approx(29 / 49, abs=0.03)
    # A single scan is seen, too.
    alone = np.ones(50, dtype=bool)
    alone[25] = False
    assert len(pixels_of(finished(alone), UNTRUSTED, np.s_[:200])) > 4


def test_the_way_lies_on_its_map() -> None:
    picture = finished(np.ones(50, dtype=bool))
    dark = (picture[40:200] < 40).all(axis=2)
    (wall,) = np.flatnonzero(dark.mean(axis=0) > 0.9)[:1]
    x, y = pixels_of(picture, WAY, np.s_[:200]).T
    px_per_m = 464.0 / 20.4
    # The way ends under its triangle, 3 m before the wall, and begins under its ring.
    assert wall - x.min() == pytest.approx(13.0 * px_per_m, abs=12.0)
    assert np.ptp(y) <= 4


coordinate = st.floats(-50.0, 50.0)
frames = st.builds(
    lambda x, y, yaw: np.array([x, y, yaw]), coordinate, coordinate, st.floats(-3.1, 3.1)
)


def laid(poses: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """(N, 3) poses by complex numbers."""
    points = (poses[:, 0] + 1j * poses[:, 1]) * np.exp(1j * frame[2]) + frame[0] + 1j * frame[1]
    return np.column_stack([points.real, points.imag, poses[:, 2] + frame[2]])


def way(poses: np.ndarray, first_ns: int = 0, step_ns: int = 10**8) -> WayOnMap:
    stamps_ns = first_ns + step_ns * np.arange(len(poses), dtype=np.int64)
    return WayOnMap(title="way", stamps_ns=stamps_ns, poses=poses, grid=None)


def spiral(count: int = 80) -> np.ndarray:
    turn = np.linspace(0.0, 9.0, count)
    return np.column_stack([turn * np.cos(turn), turn * np.sin(turn), turn + 1.3])


@given(frame=frames)
def test_the_same_way_in_another_frame_is_not_apart(frame: np.ndarray) -> None:
    found = apart(way(laid(spiral(), frame)), way(spiral()))
    assert found is not None
    assert found.away_m.max() < 1e-9
    assert np.allclose(moved_points(spiral(), found.second_in_first), laid(spiral(), frame)[:, :2])


@given(frame=frames, seed=st.integers(0, 99))
def test_only_what_drifts_is_apart(frame: np.ndarray, seed: int) -> None:
    drift_m = np.random.default_rng(seed).normal(size=(80, 2)).cumsum(axis=0)
    drift_m -= drift_m[0]
    drifted = spiral() + np.column_stack([drift_m, np.zeros(80)])
    found = apart(way(spiral()), way(laid(drifted, frame)))
    assert found is not None
    assert np.allclose(found.away_m, np.linalg.norm(drift_m, axis=1), atol=1e-9)
    assert np.allclose(found.times_s, 0.1 * np.arange(80))


def test_ways_of_other_stamps_are_compared_where_both_are() -> None:
    line = straight((0.0, 0.0), (7.9, 0.0), 80)
    # Each third of a step, from the tenth on.
    between = straight((1.0, 0.0), (6.0, 0.0), 151)
    found = apart(way(line), way(between, 10**9, 10**8 // 3))
    assert found is not None
    assert found.times_s.size == 50
    assert found.away_m.max() < 1e-6
    assert apart(way(line), way(line, 10**12)) is None


@settings(max_examples=30)
@given(frame=frames, row=st.integers(2, 17), column=st.integers(2, 27))
def test_a_moved_map_has_each_obstacle_where_it_belongs(
    frame: np.ndarray, row: int, column: int
) -> None:
    log_odds = np.full((20, 30), -5.0)
    log_odds[row, column] = 5.0
    grid = OccupancyGrid(resolution_m=0.5, origin_m=(-3.0, 4.0), log_odds=log_odds)
    moved = moved_grid(grid, frame)
    rows, columns = np.nonzero(np.nan_to_num(moved.log_odds) > 0.0)
    assert 2 <= rows.size <= 8
    at_m = np.array(moved.origin_m) + moved.resolution_m * (
        np.column_stack([columns, rows]).mean(axis=0) + 0.5
    )
    middle = np.array([[-3.0 + 0.5 * (column + 0.5), 4.0 + 0.5 * (row + 0.5), 0.0]])
    assert at_m == pytest.approx(laid(middle, frame)[0, :2], abs=0.15)


def test_two_runs_stand_side_by_side_on_one_scale() -> None:
    first = WayOnMap(
        title="1", stamps_ns=np.arange(50), poses=straight((0.0, 0.0), (4.0, 0.0)), grid=None
    )
    second = WayOnMap(
        title="2", stamps_ns=np.arange(50), poses=straight((0.0, 0.0), (2.0, 0.0)), grid=None
    )
    found: Apart | None = apart(first, second)
    assert found is not None
    picture = runs_picture(
        first, second, second_in_first=found.second_in_first, width_px=480, height_px=600
    )
    unknown = (picture == picture[30, 20]).all(axis=2)
    assert unknown[30, 460]
    widths = []
    for color, half in zip(difference_colors(2)[2:4], (np.s_[:236], np.s_[244:]), strict=True):
        near = np.abs(picture[30:100].astype(int) - color).max(axis=2) < 60
        widths.append(np.ptp(np.flatnonzero(near[:, half].any(axis=0))))
    assert widths[0] / widths[1] == pytest.approx(2.0, rel=0.12)


def test_courses_are_where_their_numbers_are() -> None:
    times_s = np.linspace(0.0, 10.0, 101)
    values = np.where(np.abs(times_s - 5.0) < 1.0, np.nan, times_s)
    course = Course(words="way", color=WAY, times_s=times_s, values=values)
    picture = time_picture(
        [course], words="m", limits=(0.0, 20.0), level=(15.0, "most"), width_px=480, height_px=220
    )
    x, y = pixels_of(picture, WAY, np.s_[:160]).T
    left, right = x.min(), x.max()
    # Half of the scale at the end of the line.
    assert y.min() == pytest.approx((14 + 162) / 2, abs=3)
    gap = (x > left + 0.42 * (right - left)) & (x < left + 0.58 * (right - left))
    assert not gap.any()
    with pytest.raises(ValueError, match="nothing"):
        time_picture([], words="m", limits=(0.0, 1.0), width_px=480, height_px=220)
