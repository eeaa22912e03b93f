"""Maps on axes in metres: each place at its spot, y upwards, no wall lost, the unknown around."""

import numpy as np
import pytest

from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.map.colors import FREE, UNKNOWN
from scanloom.plots.axes import Axes, fit_axes
from scanloom.plots.canvas import Box, blank_canvas
from scanloom.plots.grid_image import (
    draw_metric_grid,
    draw_scale_bar,
    grid_step_m,
    grid_texture,
    paint_grid,
)
from scanloom.plots.theme import LIGHT

SURE = 30.0
BOX = Box(10, 20, 320, 320)


def grid(
    log_odds: np.ndarray, resolution_m: float = 0.1, origin_m: tuple[float, float] = (0.0, 0.0)
) -> OccupancyGrid:
    return OccupancyGrid(
        resolution_m=resolution_m, origin_m=origin_m, log_odds=np.array(log_odds, dtype=np.float64)
    )


def axes(low_m: float = 0.0, high_m: float = 4.0) -> Axes:
    """Square axes of that many metres, in a canvas with a margin."""
    return fit_axes(blank_canvas(340, 380), BOX, np.full(2, low_m), np.full(2, high_m))


def with_dot(row: int, column: int, size: int = 40) -> np.ndarray:
    """Unknown, but for one cell with an obstacle."""
    log_odds = np.full((size, size), np.nan)
    log_odds[row, column] = SURE
    return log_odds


def dark_place_m(picture: Axes) -> tuple[float, float]:
    """x and y of the middle of the dark pixels in the box."""
    rows, columns = np.nonzero((picture.inside < 40).all(axis=2))
    place = picture.to_data(BOX.left + float(columns.mean()), BOX.top + float(rows.mean()))
    assert place is not None
    return place


def test_the_first_row_of_a_map_is_at_the_bottom() -> None:
    picture = axes()
    paint_grid(picture, grid(with_dot(4, 10)))
    assert dark_place_m(picture) == pytest.approx((1.05, 0.45), abs=0.02)


def test_one_place_is_at_one_spot_whatever_grid_it_is_in() -> None:
    pictures = axes(), axes()
    paint_grid(pictures[0], grid(with_dot(10, 12)))
    # The same point of the map frame in a grid that begins elsewhere.
    paint_grid(pictures[1], grid(with_dot(20, 7), origin_m=(0.5, -1.0)))
    assert dark_place_m(pictures[0]) == pytest.approx(dark_place_m(pictures[1]), abs=0.02)


def test_the_surer_an_obstacle_the_darker_and_unknown_is_not_one_half() -> None:
    probability = np.array([[0.05, 0.5, 0.95], [0.5, 0.5, np.nan]])
    texture = grid_texture(grid(np.log(probability / (1 - probability))))
    assert texture.shape == (2, 3, 3)
    lower = texture[1, :, 0].astype(int)
    assert lower.tolist() == pytest.approx([242, 128, 13], abs=2)
    assert tuple(texture[0, 2]) == UNKNOWN
    assert (texture[0, 0] == texture[0, 0, 0]).all()


def test_a_wall_of_one_cell_stays_when_cells_are_smaller_than_pixels() -> None:
    log_odds = np.full((1500, 1500), -SURE)
    log_odds[777] = SURE
    log_odds[:, 333] = SURE
    picture = axes(0.0, 150.0)
    paint_grid(picture, grid(log_odds))
    dark = (picture.inside < 40).all(axis=2)
    assert (dark.sum(axis=1) > 250).sum() == 1
    assert (dark.sum(axis=0) > 250).sum() == 1


def test_cells_beyond_a_map_are_unknown() -> None:
    picture = axes()
    paint_grid(picture, grid(np.full((10, 10), -SURE), origin_m=(1.0, 1.0)))
    unknown = (picture.inside == UNKNOWN).all(axis=2)
    assert unknown.mean() == pytest.approx(15 / 16, abs=0.01)
    x, y = (round(value) for value in picture.to_pixel(1.5, 1.5))
    assert tuple(picture.rgb[y, x]) == FREE
    paint_grid(picture, None)
    assert (picture.inside == UNKNOWN).all()


def test_a_map_stays_in_its_box() -> None:
    picture = axes()
    before = picture.rgb.copy()
    paint_grid(picture, grid(with_dot(4, 10)))
    rows, columns = np.nonzero((picture.rgb != before).any(axis=2))
    assert (rows.min(), rows.max()) == (BOX.top, BOX.bottom - 1)
    assert (columns.min(), columns.max()) == (BOX.left, BOX.right - 1)


def test_the_scale_bar_has_the_length_that_it_says() -> None:
    picture = axes(0.0, 10.0)
    assert grid_step_m(picture) == 2.0
    draw_scale_bar(picture, 360)
    bar = (picture.rgb[360] == LIGHT.ink).all(axis=1)
    assert np.flatnonzero(bar)[0] == BOX.left
    assert bar[: BOX.left + 66].sum() == round(2.0 * 32.0)


def test_grid_lines_are_at_the_multiples_of_a_length() -> None:
    picture = axes(-1.5, 2.5)
    draw_metric_grid(picture, 1.0)
    lines = (picture.inside < 250).all(axis=(0, 2))
    at_m = [-1.5 + (column + 0.5) / 80.0 for column in np.flatnonzero(lines)]
    assert at_m == pytest.approx([-1.0, 0.0, 1.0, 2.0], abs=0.02)
