"""A run from above: to scale, y upwards, and nothing in another's colour."""

import numpy as np
import pytest

from fusion_core.model.slam_view import SlamView
from scanloom.plots.palette import Color, color_map
from scanloom.plots.slam_progress import (
    LOOP_CLOSURE,
    TRAJECTORY,
    Window,
    slam_progress_picture,
    window_around,
)

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
    return slam_progress_picture(moment, WINDOW, width_px=480, height_px=height_px)


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


def test_a_trajectory_is_to_scale_and_y_upwards() -> None:
    # 5 m, as long as the bar is for a window of 20 m.
    along = drawn(view(straight((-4.0, 0.0), (1.0, 0.0))))
    x, y = pixels_of(along, TRAJECTORY, PLOT).T
    assert np.ptp(y) <= 4
    # Ring and triangle cover its ends.
    middle = (x.min() + x.max()) / 2
    up = drawn(view(straight((-4.0, 0.0), (-4.0, 4.0))))
    assert pixels_of(up, TRAJECTORY, PLOT)[:, 1].min() < y.min() - 60
    bar_px = scale_bar_px(along)
    moved = drawn(view(straight((1.0, 0.0), (6.0, 0.0))))
    x_moved = pixels_of(moved, TRAJECTORY, PLOT)[:, 0]
    assert (x_moved.min() + x_moved.max()) / 2 - middle == pytest.approx(bar_px, abs=1.5)


def test_loops_are_lines_between_their_ends() -> None:
    poses = straight((-8.0, -2.0), (8.0, -2.0))
    assert len(pixels_of(drawn(view(poses)), LOOP_CLOSURE, PLOT)) == 0
    closed = drawn(view(poses, loops_m=np.array([[-6.0, -2.0, -6.0, 3.0]])))
    x, y = pixels_of(closed, LOOP_CLOSURE, PLOT).T
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
    assert window_around(view(straight((0.0, 0.0), (4.0, 0.0)), strayed), begin)[1][1] > 99.0  # type: ignore[index]  # a trajectory gives a window
