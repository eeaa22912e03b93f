"""Depth pictures: colours of metres, hatched gaps, pixels of pairs in their class, picking."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.model.classes import NoiseClass
from scanloom.plots.class_marks import draw_class_marks, spread_out
from scanloom.plots.color_scale import hatch
from scanloom.plots.depth_image import (
    DepthPicture,
    PairOverlay,
    depth_limits_m,
    depth_picture,
    dock_depth_picture,
)
from scanloom.plots.pair_pixels import PairPixels
from scanloom.plots.palette import class_color, color_map, color_of
from scanloom.plots.theme import DARK

COLORS = color_map("cividis")


def slope(rows: int = 60, columns: int = 80) -> np.ndarray:
    """Depths from 1 m at the left to 3 m at the right."""
    return np.tile(np.linspace(1.0, 3.0, columns, dtype=np.float32), (rows, 1))


def four_pairs() -> PairPixels:
    """A pixel of each class far from the others, and a beam without a pixel."""
    return PairPixels(
        beam=np.array([100, 101, 102, 103, 104]),
        row=np.array([30, 30, 30, 30, -1]),
        column=np.array([10, 30, 50, 70, -1]),
        noise_class=np.array([0, 1, 2, 3, -1]),
        repaired=np.array([False, True, True, False, False]),
    )


def drawn(
    depth_m: np.ndarray,
    pairs: PairPixels | None = None,
    limits_m: tuple[float, float] | None = None,
    **kwargs: object,
) -> DepthPicture:
    overlay = None if pairs is None else PairOverlay(pixels=pairs, **kwargs)
    return depth_picture(
        "Frame 5", depth_m, overlay, width_px=420, height_px=400, limits_m=limits_m
    )


def color_at(picture: DepthPicture, row: int, column: int) -> tuple[int, ...]:
    x, y = picture.axes.to_pixel(column, row)
    return tuple(picture.rgb[round(y), round(x)].tolist())


def test_the_nearest_is_darkest_and_the_farthest_lightest() -> None:
    picture = drawn(slope())
    assert picture.limits_m == pytest.approx((1.0, 3.0))
    assert color_at(picture, 5, 0) == tuple(COLORS[0])
    assert color_at(picture, 5, 79) == tuple(COLORS[255])


def test_given_limits_take_the_place_of_the_images_own() -> None:
    picture = drawn(slope(), limits_m=(0.0, 6.0))
    assert color_at(picture, 5, 79) == tuple(COLORS[round(0.5 * 255 + 0.01)])


def test_stray_pixels_do_not_take_the_colours() -> None:
    depth_m = slope(100, 100)
    depth_m[0, 0], depth_m[1, 1] = 0.05, 60.0
    limits = depth_limits_m(depth_m)
    assert limits is not None
    assert limits == pytest.approx((1.0, 3.0), abs=0.05)


def test_missing_depth_is_hatched() -> None:
    depth_m = slope()
    depth_m[:30, :40] = np.nan
    picture = drawn(depth_m)
    inside = picture.axes.box.view(picture.rgb)
    height, width = inside.shape[0] // 2 - 6, inside.shape[1] // 2 - 6
    assert np.array_equal(inside[:height, :width], hatch(*inside.shape[:2])[:height, :width])


def test_an_image_keeps_its_proportions_and_leaves_no_canvas_below() -> None:
    picture = depth_picture("wide", slope(20, 200), width_px=420, height_px=800)
    box = picture.axes.box
    assert box.width / box.height == pytest.approx(10.0, rel=0.05)
    assert picture.rgb.shape[0] < 150
    low = depth_picture("high", slope(200, 20), width_px=420, height_px=300)
    assert low.axes.box.height / low.axes.box.width == pytest.approx(10.0, rel=0.05)
    assert low.rgb.shape[0] <= 300


def colors_about(picture: DepthPicture, row: int, column: int) -> set[tuple[int, ...]]:
    """The colours of a mark, from its middle to the right."""
    x, y = picture.axes.to_pixel(column, row)
    part = picture.rgb[round(y), round(x) : round(x) + 7]
    return {tuple(color) for color in part.tolist()}


def test_a_mark_has_the_colour_of_its_class_and_good_pairs_the_lidars() -> None:
    picture = drawn(slope(), four_pairs())
    expected = [color_of("lidar"), *map(class_color, list(NoiseClass)[1:])]
    for color, column in zip(expected, (10, 30, 50, 70), strict=True):
        assert color in colors_about(picture, 30, column)


def test_marks_of_classes_differ_in_shape() -> None:
    shapes = set()
    for noise in NoiseClass:
        part = np.zeros((21, 21, 3), dtype=np.uint8)
        draw_class_marks(part, np.array([[10, 10]]), noise)
        shapes.add((part == class_color(noise)).all(axis=2).tobytes())
    assert len(shapes) == len(NoiseClass)


def curve(rows: np.ndarray, classes: np.ndarray | None = None) -> PairPixels:
    """A pair in every second column."""
    count = len(rows)
    return PairPixels(
        beam=np.arange(count),
        row=rows,
        column=2 * np.arange(count),
        noise_class=np.zeros(count, dtype=np.int64) if classes is None else classes,
        repaired=np.zeros(count, dtype=np.bool_),
    )


def orange_columns(picture: DepthPicture) -> np.ndarray:
    inside = picture.axes.box.view(picture.rgb)
    return (inside == color_of("lidar")).all(axis=2).any(axis=0)


def test_good_pairs_are_one_line_that_ends_where_the_curve_jumps() -> None:
    flat = drawn(slope(), curve(np.full(40, 30)))
    assert orange_columns(flat)[2:-6].all()
    rows = np.where(np.arange(40) < 20, 15, 45)
    assert not orange_columns(drawn(slope(), curve(rows))).all()
    between = drawn(slope(), curve(rows)).axes.to_pixel(39, 30)
    jumping = drawn(slope(), curve(rows)).rgb
    column = jumping[round(between[1]) - 20 : round(between[1]) + 20, round(between[0])]
    assert not (column == color_of("lidar")).all(axis=1).any()


def test_the_line_does_not_cross_a_stretch_that_is_not_good() -> None:
    classes = np.zeros(40, dtype=np.int64)
    classes[10:25] = NoiseClass.CONFLICT
    picture = drawn(slope(), curve(np.full(40, 30), classes), classes={NoiseClass.GOOD})
    place = picture.place_of(30, 35)
    assert place is not None
    assert not orange_columns(picture)[round(place[0]) - picture.axes.box.left]
    classes[10:25] = 0
    classes[17:19] = NoiseClass.CONFLICT
    picture = drawn(slope(), curve(np.full(40, 30), classes), classes={NoiseClass.GOOD})
    assert orange_columns(picture)[round(place[0]) - picture.axes.box.left]


def test_of_marks_that_would_cover_each_other_one_is_left() -> None:
    places = np.array([[0, 0], [7, 7], [8, 0], [3, 2], [800, 0], [9, 1]])
    assert spread_out(places, 8).tolist() == [0, 2, 4]
    assert spread_out(np.empty((0, 2), dtype=np.int64), 8).size == 0


def test_only_the_chosen_classes_are_drawn() -> None:
    picture, plain = drawn(slope(), four_pairs(), classes={NoiseClass.BURR}), drawn(slope())
    assert color_at(picture, 30, 50) == class_color(NoiseClass.BURR)
    for column in (10, 30, 70):
        assert color_at(picture, 30, column) == color_at(plain, 30, column)
    none = drawn(slope(), four_pairs(), classes=())
    assert np.array_equal(none.axes.box.view(none.rgb), plain.axes.box.view(plain.rgb))


def test_pixels_without_a_class_have_the_lidars_colour() -> None:
    pairs = four_pairs()
    pairs = PairPixels(
        beam=pairs.beam,
        row=pairs.row,
        column=pairs.column,
        noise_class=np.full(5, -1),
        repaired=np.zeros(5, dtype=np.bool_),
    )
    assert color_at(drawn(slope(), pairs), 30, 10) == color_of("lidar")


def test_a_hole_that_was_repaired_is_filled() -> None:
    pairs = four_pairs()
    before = replace(pairs, repaired=np.zeros(5, dtype=np.bool_))
    assert color_at(drawn(slope(), before), 30, 30) == (0, 0, 0)
    assert color_at(drawn(slope(), pairs), 30, 30) == (255, 255, 255)
    # A cross is on a disc.
    x, y = drawn(slope(), pairs).axes.to_pixel(50, 30)
    beside = [drawn(slope(), p).rgb[round(y), round(x) + 3].tolist() for p in (before, pairs)]
    assert beside[0] != [255, 255, 255] == beside[1]


def test_the_beam_that_is_looked_at_has_a_ring() -> None:
    picture, plain = drawn(slope(), four_pairs(), beam=102), drawn(slope(), four_pairs())
    height = min(picture.rgb.shape[0], plain.rgb.shape[0], picture.axes.box.bottom)
    rows, columns = np.nonzero((picture.rgb[:height] != plain.rgb[:height]).any(axis=2))
    x, y = picture.axes.to_pixel(50, 30)
    assert np.abs(rows - y).max() <= 13
    assert np.abs(columns - x).max() <= 13
    assert color_at(picture, 30, 50) == class_color(NoiseClass.BURR)


@pytest.mark.parametrize("beam", [104, 9999])
def test_a_beam_without_a_pixel_draws_nothing_in_the_image(beam: int) -> None:
    picture, plain = drawn(slope(), four_pairs(), beam=beam), drawn(slope(), four_pairs())
    assert np.array_equal(picture.axes.box.view(picture.rgb), plain.axes.box.view(plain.rgb))


@settings(max_examples=60)
@given(
    rows=st.integers(1, 400),
    columns=st.integers(1, 400),
    fraction=st.tuples(st.floats(0, 1), st.floats(0, 1)),
)
def test_picking_undoes_drawing(rows: int, columns: int, fraction: tuple[float, float]) -> None:
    depth_m = np.ones((rows, columns), dtype=np.float32)
    picture = depth_picture("Frame 5", depth_m, width_px=500, height_px=300)
    row, column = round(fraction[0] * (rows - 1)), round(fraction[1] * (columns - 1))
    assert picture.pixel_at(*picture.axes.to_pixel(column, row)) == (row, column)


def test_around_the_image_nothing_is_picked() -> None:
    picture = drawn(slope())
    box = picture.axes.box
    middle = box.top + box.height // 2
    for x, y in (
        (box.left - 1, middle),
        (box.right, middle),
        (box.left + 3, box.top - 1),
        (box.left + 3, box.bottom),
    ):
        assert picture.pixel_at(x, y) is None


@pytest.mark.parametrize(
    "depth_m",
    [
        np.full((32, 96), np.nan, dtype=np.float32),
        np.full((24, 32), 2.0, dtype=np.float32),
        np.ones((1, 1), dtype=np.float32),
        np.array([[np.nan, 1.5]], dtype=np.float32),
    ],
    ids=["all NaN", "constant", "one pixel", "one depth"],
)
def test_images_of_little_are_drawn(depth_m: np.ndarray) -> None:
    picture = drawn(depth_m)
    assert picture.rgb.dtype == np.uint8
    assert (picture.limits_m is None) == bool(np.isnan(depth_m).all())


def test_the_size_does_not_follow_the_numbers_of_a_frame() -> None:
    many = PairPixels(
        beam=np.arange(900),
        row=np.full(900, 3),
        column=np.full(900, 3),
        noise_class=np.arange(900) % 4,
        repaired=np.ones(900, dtype=np.bool_),
    )
    gaps = slope()
    gaps[20:30] = np.nan
    first = drawn(slope(), four_pairs())
    for depth_m, pairs in ((slope(), many), (gaps, four_pairs()), (gaps, many)):
        picture = drawn(depth_m, pairs)
        assert picture.rgb.shape == first.rgb.shape
        assert picture.axes.box == first.axes.box


@settings(max_examples=60)
@given(
    rows=st.integers(1, 400),
    columns=st.integers(1, 400),
    fraction=st.tuples(st.floats(0, 1), st.floats(0, 1)),
    width_px=st.sampled_from([350, 410]),
)
def test_in_a_dock_place_and_pixel_undo_each_other(
    rows: int, columns: int, fraction: tuple[float, float], width_px: int
) -> None:
    depth_m = np.ones((rows, columns), dtype=np.float32)
    picture = dock_depth_picture(depth_m, width_px=width_px, height_px=330)
    assert picture.rgb.shape[1] == width_px
    assert picture.rgb.shape[0] <= 330
    row, column = round(fraction[0] * (rows - 1)), round(fraction[1] * (columns - 1))
    place = picture.place_of(row, column)
    assert place is not None
    assert picture.pixel_at(*place) == (row, column)
    for outside in ((-1, column), (rows, column), (row, -1), (row, columns)):
        assert picture.place_of(*outside) is None


def test_in_a_dock_an_image_takes_most_of_the_width_and_its_size_stays() -> None:
    wide, high = slope(120, 200), slope(60, 80)
    without = dock_depth_picture(wide, width_px=410, height_px=330)
    assert without.axes.box.width >= 370
    assert dock_depth_picture(high, width_px=410, height_px=330).axes.box.width >= 345
    with_pairs = dock_depth_picture(
        wide, PairOverlay(pixels=four_pairs()), width_px=410, height_px=330, theme=DARK
    )
    assert with_pairs.rgb.shape == without.rgb.shape
    assert with_pairs.axes.box == without.axes.box
    assert with_pairs.rgb[1, 1].tolist() == list(DARK.background)
    nothing = np.full((120, 200), np.nan, dtype=np.float32)
    assert dock_depth_picture(nothing, width_px=410, height_px=330).limits_m is None


def test_too_small_a_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="px"):
        dock_depth_picture(slope(), width_px=60, height_px=60)
    with pytest.raises(ValueError, match="px"):
        depth_picture("Frame 5", slope(), width_px=100, height_px=100)
