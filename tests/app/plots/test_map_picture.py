"""Maps side by side: the same place at the same spot, y upwards, no wall lost, differences seen."""

import numpy as np
import pytest

from fusion_core.model.grids import MapDifference, OccupancyGrid
from fusion_core.workflows.map.colors import FREE, UNKNOWN, difference_colors
from scanloom.plots.map_picture import map_pictures, map_texture

SURE = 30.0


def grid(
    log_odds: np.ndarray, resolution_m: float = 0.1, origin_m: tuple[float, float] = (0.0, 0.0)
) -> OccupancyGrid:
    return OccupancyGrid(
        resolution_m=resolution_m, origin_m=origin_m, log_odds=np.array(log_odds, dtype=np.float64)
    )


def boxes_of(picture: np.ndarray) -> list[tuple[int, int, int, int]]:
    """(top, left, bottom, right) of the maps: the blue-grey of the unknown surrounds each."""
    unknown = (picture == UNKNOWN).all(axis=2)
    # The legend's swatch is small.
    columns = np.flatnonzero(unknown.sum(axis=0) > 20)
    parts = np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1)
    rows = np.flatnonzero(unknown.sum(axis=1) > 20)
    return [(rows[0], part[0], rows[-1] + 1, part[-1] + 1) for part in parts]


def with_dot(row: int, column: int, size: int = 40) -> np.ndarray:
    """Unknown, but for one cell with an obstacle."""
    log_odds = np.full((size, size), np.nan)
    log_odds[row, column] = SURE
    return log_odds


def dark_place(picture: np.ndarray, box: tuple[int, int, int, int]) -> tuple[float, float]:
    """Mean (y, x) of the dark pixels in a box, relative to it."""
    top, left, bottom, right = box
    inside = (picture[top:bottom, left:right] < 40).all(axis=2)
    rows, columns = np.nonzero(inside)
    return float(rows.mean()), float(columns.mean())


def test_the_first_row_of_a_map_is_at_the_bottom() -> None:
    picture = map_pictures({"map": grid(with_dot(4, 10))}, width_px=420, height_px=500)
    (box,) = boxes_of(picture)
    y, x = dark_place(picture, box)
    size_px = box[2] - box[0]
    assert y == pytest.approx((1 - 4.5 / 40) * size_px, abs=2)
    assert x == pytest.approx(10.5 / 40 * size_px, abs=2)


def test_one_place_is_at_one_spot_in_each_map() -> None:
    here = grid(with_dot(10, 12))
    # The same point of the map frame in a grid that begins elsewhere.
    there = grid(with_dot(20, 7), origin_m=(0.5, -1.0))
    picture = map_pictures({"here": here, "there": there}, width_px=900, height_px=500)
    first, second = boxes_of(picture)
    assert dark_place(picture, first) == pytest.approx(dark_place(picture, second), abs=1.5)


def test_the_surer_an_obstacle_the_darker_and_unknown_is_not_one_half() -> None:
    probability = np.array([[0.05, 0.5, 0.95], [0.5, 0.5, np.nan]])
    texture = map_texture(grid(np.log(probability / (1 - probability))))
    assert texture.shape == (2, 3, 3)
    lower = texture[1, :, 0].astype(int)
    assert lower.tolist() == pytest.approx([242, 128, 13], abs=2)
    assert tuple(texture[0, 2]) == UNKNOWN
    assert (texture[0, 0] == texture[0, 0, 0]).all()


def test_a_wall_of_one_cell_stays_when_cells_are_smaller_than_pixels() -> None:
    log_odds = np.full((1500, 1500), -SURE)
    log_odds[777] = SURE
    log_odds[:, 333] = SURE
    picture = map_pictures({"large": grid(log_odds)}, width_px=400, height_px=420)
    dark = (picture < 40).all(axis=2)
    assert (dark.sum(axis=1) > 250).sum() == 1
    assert (dark.sum(axis=0) > 250).sum() == 1


def test_cells_beyond_a_map_are_unknown() -> None:
    small = grid(np.full((10, 10), -SURE), origin_m=(1.0, 1.0))
    large = grid(np.full((40, 40), -SURE))
    picture = map_pictures({"large": large, "small": small}, width_px=700, height_px=420)
    unknown = (picture == UNKNOWN).all(axis=2)[:300]
    assert not unknown[:, :330].any()
    share = unknown[:, 360:].sum() / (picture[:300, 360:].shape[0] * 330)
    assert 0.7 < share < 1.0
    assert (picture[150:, 500] == FREE).any()


@pytest.mark.parametrize("names", [("LiDAR", "fused"), ("LiDAR", "camera", "fused")])
def test_each_state_of_a_difference_has_the_colour_of_the_exported_picture(
    names: tuple[str, ...],
) -> None:
    count = 1 + 2 ** len(names)
    states = np.zeros((20, 20 * count), dtype=np.uint8)
    for state in range(count):
        states[5:15, 20 * state + 5 : 20 * state + 15] = state
    difference = MapDifference(names=names, resolution_m=0.05, origin_m=(0.0, 0.0), states=states)
    picture = map_pictures({}, difference, width_px=700, height_px=400)
    found = {tuple(color) for color in picture.reshape(-1, 3).tolist()}
    assert found >= set(difference_colors(len(names)))


def test_a_single_cell_that_differs_is_drawn_larger_than_what_is_shared() -> None:
    states = np.full((100, 100), MapDifference.FREE, dtype=np.uint8)
    states[20, 20] = MapDifference.FREE + 1
    states[60, 60] = MapDifference.FREE + 3
    difference = MapDifference(
        names=("LiDAR", "fused"), resolution_m=0.1, origin_m=(0.0, 0.0), states=states
    )
    picture = map_pictures({}, difference, width_px=140, height_px=400)
    colors = difference_colors(2)
    inside = picture[36:155, 10:130]
    only, both = ((inside == colors[state]).all(axis=2).sum() for state in (2, 4))
    assert only >= 9
    assert 1 <= both <= 4


def test_nothing_to_draw_and_no_room_are_refused() -> None:
    with pytest.raises(ValueError, match="no map"):
        map_pictures({}, width_px=400, height_px=400)
    with pytest.raises(ValueError, match="px"):
        map_pictures({"map": grid(with_dot(1, 1))}, width_px=400, height_px=60)
