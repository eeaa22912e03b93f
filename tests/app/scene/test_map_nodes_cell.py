"""The outline of a cell that is picked on a map."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from scanloom.scene.map_nodes import MapPlane, cell_mark, cell_outlines

PLANE = MapPlane(
    picture=np.zeros((30, 40, 3), dtype=np.uint8), resolution_m=0.1, origin_m=(-1.0, 0.5)
)


@given(st.floats(-0.99, 2.99), st.floats(0.51, 3.49))
def test_the_outline_holds_the_place(x_m: float, y_m: float) -> None:
    lines = cell_outlines(PLANE, np.array([x_m, y_m]), 0.3)
    assert lines.shape == (4, 2, 3)
    low, high = lines.reshape(-1, 3).min(axis=0), lines.reshape(-1, 3).max(axis=0)
    np.testing.assert_allclose(high - low, [0.1, 0.1, 0.0], atol=1e-5)
    assert low[0] <= x_m + 1e-5
    assert high[0] >= x_m - 1e-5
    assert low[1] <= y_m + 1e-5
    assert high[1] >= y_m - 1e-5
    # Its corners lie on the raster.
    steps = (low[:2] - PLANE.origin_m) / 0.1
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-4)
    # Each edge begins where the one before ends.
    np.testing.assert_array_equal(lines[:-1, 1], lines[1:, 0])


def test_beside_the_map_there_is_no_cell() -> None:
    for place in ([-1.1, 1.0], [3.1, 1.0], [0.0, 0.4], [0.0, 3.6]):
        assert len(cell_outlines(PLANE, np.array(place), 0.0)) == 0
        assert len(cell_mark(PLANE, np.array(place), 0.0)) == 0


def test_several_cells_are_outlined_as_each_by_itself() -> None:
    places_m = np.array([[-0.95, 0.55], [9.0, 9.0], [1.23, 2.04]])
    alone = [cell_outlines(PLANE, place_m, 0.3) for place_m in places_m]
    np.testing.assert_array_equal(cell_outlines(PLANE, places_m, 0.3), np.concatenate(alone))
    assert len(cell_outlines(PLANE, places_m, 0.3)) == 8


def test_a_picked_cell_stands_in_the_middle_of_a_larger_square() -> None:
    mark = cell_mark(PLANE, np.array([1.23, 2.04]), 0.3)
    cell, around = mark[:4].reshape(-1, 3), mark[4:].reshape(-1, 3)
    np.testing.assert_allclose(around.mean(axis=0), cell.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(np.ptp(around, axis=0), 7.0 * np.ptp(cell, axis=0), atol=1e-4)
