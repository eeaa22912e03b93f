"""What a box and a brush cover, against the distance of each pixel."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from scanloom.plots.drawn_mask import drawn_mask

SHAPE = 20, 30
places = st.tuples(st.floats(-5.0, 34.0), st.floats(-5.0, 24.0))


@given(places, places)
def test_a_box_covers_what_is_between_its_corners(
    one: tuple[float, float], other: tuple[float, float]
) -> None:
    row, column = np.indices(SHAPE)
    low_x, high_x = sorted((round(one[0]), round(other[0])))
    low_y, high_y = sorted((round(one[1]), round(other[1])))
    expected = (column >= low_x) & (column <= high_x) & (row >= low_y) & (row <= high_y)
    np.testing.assert_array_equal(drawn_mask(SHAPE, "box", [one, other]), expected)


inside = st.tuples(st.floats(0.0, 29.0), st.floats(0.0, 19.0))


@given(st.lists(inside, min_size=1, max_size=5), st.integers(0, 6))
def test_a_brush_covers_what_is_near_its_way(
    way: list[tuple[float, float]], radius_px: int
) -> None:
    row, column = np.indices(SHAPE)
    points = np.round(np.array(way))
    distance = np.full(SHAPE, np.inf)
    for begin, end in zip(points, [*points[1:], points[-1]], strict=True):
        along = end - begin
        length = float(along @ along)
        share = 0.0
        if length > 0.0:
            share = np.clip(
                ((column - begin[0]) * along[0] + (row - begin[1]) * along[1]) / length, 0, 1
            )
        near = np.hypot(column - begin[0] - share * along[0], row - begin[1] - share * along[1])
        distance = np.minimum(distance, near)
    mask = drawn_mask(SHAPE, "brush", way, radius_px)
    # Lines are drawn to within a pixel.
    assert mask[distance <= radius_px - 1.0].all()
    assert not mask[distance > radius_px + 1.0].any()
