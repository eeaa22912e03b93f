"""Where maps differ, cell by cell."""

import numpy as np
import pytest

from fusion_core.mapping.difference import compare_maps
from fusion_core.model.grids import MapDifference, OccupancyGrid

U, F, O = np.nan, -1.0, 1.0  # noqa: E741 (a map is drawn with one letter a cell)


def grid(
    log_odds: list[list[float]], x_m: float = 0.0, y_m: float = 0.0, resolution_m: float = 0.05
) -> OccupancyGrid:
    return OccupancyGrid(
        resolution_m=resolution_m, origin_m=(x_m, y_m), log_odds=np.array(log_odds)
    )


def test_every_combination_of_two_maps() -> None:
    a = grid([[U, U, U], [F, F, F], [O, O, O]])
    b = grid([[U, F, O]] * 3)
    difference = compare_maps({"lidar": a, "camera": b})
    words = np.vectorize(difference.legend.get)(difference.states)
    assert words.tolist() == [
        ["unknown", "free", "only camera"],
        ["free", "free", "only camera"],
        ["only lidar", "only lidar", "lidar and camera"],
    ]


def test_three_maps_of_different_extent_on_one_canvas() -> None:
    a = grid([[O]], x_m=0.10, y_m=-0.05)
    b = grid([[F, O]], x_m=0.05, y_m=-0.05)
    c = grid([[O], [O]], x_m=0.10, y_m=-0.05)
    difference = compare_maps({"a": a, "b": b, "c": c})
    assert difference.origin_m == (0.05, -0.05)
    assert len(difference.legend) == 9
    words = np.vectorize(difference.legend.get)(difference.states)
    assert words.tolist() == [["free", "a and b and c"], ["unknown", "only c"]]


def test_swapping_two_maps_swaps_their_states() -> None:
    rng = np.random.default_rng(5)
    maps = [grid(rng.choice([U, F, O], size=(6, 7)).tolist()) for _ in range(2)]
    ab = compare_maps({"a": maps[0], "b": maps[1]})
    ba = compare_maps({"b": maps[1], "a": maps[0]})
    swapped = np.array([0, 1, 3, 2, 4], dtype=np.uint8)
    assert np.array_equal(swapped[ab.states], ba.states)
    alike = compare_maps({"a": maps[0], "b": maps[0]})
    assert set(np.unique(alike.states)) == {MapDifference.UNKNOWN, MapDifference.FREE, 4}


def test_the_threshold_decides_what_is_occupied() -> None:
    likely = grid([[np.log(0.6 / 0.4)]])
    assert compare_maps({"a": likely, "b": likely}).states.item() == MapDifference.FREE
    lower = compare_maps({"a": likely, "b": likely}, occupied_probability=0.5)
    assert lower.states.item() == 4


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (grid([[O]], resolution_m=0.1), "another resolution"),
        (grid([[O]], x_m=0.02), "do not lie on"),
    ],
)
def test_maps_on_other_rasters_are_refused(other: OccupancyGrid, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        compare_maps({"a": grid([[O]]), "b": other})
    with pytest.raises(ValueError, match="two or three"):
        compare_maps({"a": grid([[O]])})
