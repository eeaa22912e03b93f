"""Pictures of maps: where the cells lie, in which colours, and how long the scale bar is."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from fusion_core.exporting.map_picture import (
    scale_bar_m,
    write_difference_picture,
    write_grid_picture,
)
from fusion_core.model.grids import MapDifference, OccupancyGrid

MARGIN_PX, ZOOM = 12, 16


def read_rgb(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_COLOR)[:, :, ::-1]


def cell_color(picture: np.ndarray, row: int, column: int, rows: int) -> tuple[int, ...]:
    """Colour in the middle of a cell, row 0 being the lowest in the picture."""
    y = MARGIN_PX + (rows - 1 - row) * ZOOM + ZOOM // 2
    return tuple(picture[y, MARGIN_PX + column * ZOOM + ZOOM // 2].tolist())


def test_more_probable_obstacles_are_darker(tmp_path: Path) -> None:
    p = np.array([[0.9, 0.5, 0.1], [np.nan, 0.1, 0.1]])
    grid = OccupancyGrid(resolution_m=0.05, origin_m=(0.0, 0.0), log_odds=np.log(p / (1 - p)))
    write_grid_picture(tmp_path / "map.png", grid)
    picture = read_rgb(tmp_path / "map.png")
    grey = [cell_color(picture, 0, column, 2) for column in range(3)]
    assert all(red == green == blue for red, green, blue in grey)
    assert [color[0] for color in grey] == [26, 128, 230]
    red, green, blue = cell_color(picture, 1, 0, 2)
    assert red < green < blue


def test_the_legend_has_unconfirmed_cells_only_where_there_are_any(tmp_path: Path) -> None:
    for second, line_px in ((0.0, 22), (1.0, 0)):
        grid = OccupancyGrid(
            resolution_m=0.05, origin_m=(0.0, 0.0), log_odds=np.array([[-1.0, second]])
        )
        write_grid_picture(tmp_path / f"{line_px}.png", grid)
    with_line, without = (read_rgb(tmp_path / f"{line_px}.png") for line_px in (22, 0))
    assert with_line.shape[0] == without.shape[0] + 22
    assert cell_color(with_line, 0, 1, 1) == (128, 128, 128)
    assert (128, 128, 128) in {tuple(color) for color in with_line[-30:].reshape(-1, 3).tolist()}


@pytest.mark.parametrize("names", [("lidar", "camera"), ("lidar", "camera", "fused")])
def test_each_state_of_a_difference_has_its_own_colour(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    count = 1 + 2 ** len(names)
    difference = MapDifference(
        names=names,
        resolution_m=0.05,
        origin_m=(0.0, 0.0),
        states=np.arange(count, dtype=np.uint8)[:, np.newaxis],
    )
    write_difference_picture(tmp_path / "map.png", difference)
    picture = read_rgb(tmp_path / "map.png")
    colors = [cell_color(picture, row, 0, count) for row in range(count)]
    assert len(set(colors)) == count == len(difference.legend)
    below = picture[MARGIN_PX + count * ZOOM :].reshape(-1, 3)
    assert {tuple(color) for color in below.tolist()} >= set(colors)


def test_the_scale_bar_is_as_long_as_it_says(tmp_path: Path) -> None:
    grid = OccupancyGrid(resolution_m=0.05, origin_m=(0.0, 0.0), log_odds=np.full((40, 100), 1.0))
    write_grid_picture(tmp_path / "map.png", grid)
    picture = read_rgb(tmp_path / "map.png")
    zoom = 800 // 100
    bar_row = picture[2 * MARGIN_PX + 40 * zoom + 6]
    is_ink = bar_row.sum(axis=1) == 0
    assert not is_ink[:MARGIN_PX].any()
    bar_px = int(np.argmin(is_ink[MARGIN_PX:]))
    assert bar_px * 0.05 / zoom == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("width_m", "bar_m"), [(3.0, 1.0), (2.99, 0.5), (6.1, 2.0), (15.5, 5.0), (100.0, 20.0)]
)
def test_scale_bar_lengths(width_m: float, bar_m: float) -> None:
    assert scale_bar_m(width_m) == pytest.approx(bar_m)
