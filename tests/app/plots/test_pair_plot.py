"""Pairs in the plane: each point where its metres say, in its sensor's colour."""

import numpy as np
import pytest

from scanloom.plots.pair_plot import PairPicture, PairPlot, pair_picture
from scanloom.plots.palette import color_of

LIDAR_M = np.array([[-1.0, 3.0], [0.0, 3.2], [1.0, 3.0], [0.5, 2.5], [np.nan, np.nan]])
DEPTH_M = np.array([[-1.0, 2.0], [0.0, 2.2], [1.0, 2.0], [np.nan, np.nan], [-0.5, 2.5]])
AGREE = np.array([True, False, True, False, False])


def drawn(*plots: PairPlot, width_px: int = 480, height_px: int = 340) -> PairPicture:
    return pair_picture(plots, width_px=width_px, height_px=height_px)


def plot(**values) -> PairPlot:
    return PairPlot(**{"title": "", "lidar_m": LIDAR_M, "depth_m": DEPTH_M} | values)


def px_per_m(picture: PairPicture) -> float:
    return picture.axes[0].px_per_unit[0]


def color_at(picture: PairPicture, x_m: float, z_m: float, number: int = 0) -> tuple[int, ...]:
    x, y = picture.axes[number].to_pixel(x_m, z_m)
    return tuple(int(value) for value in picture.rgb[round(y), round(x)])


def count_of(picture: PairPicture, name: str, number: int = 0) -> int:
    """Pixels of a sensor's colour inside a plot, without the legend."""
    inside = picture.axes[number].inside
    return int((inside == color_of(name)).all(axis=2).sum())


def test_points_of_inliers_are_where_their_metres_say():
    picture = drawn(plot(is_inlier=AGREE))
    for index in (0, 2):
        assert color_at(picture, *LIDAR_M[index]) == color_of("lidar")
        assert color_at(picture, *DEPTH_M[index]) == color_of("depth")


def test_left_is_left_and_ahead_is_up():
    picture = drawn(plot())
    x, y = picture.axes[0].to_pixel(0.0, 3.0)
    assert picture.axes[0].to_pixel(1.0, 3.0)[0] > x
    assert picture.axes[0].to_pixel(0.0, 4.0)[1] < y


def test_a_metre_is_as_long_across_as_ahead():
    picture = drawn(plot(), width_px=700, height_px=300)
    x, y = picture.axes[0].to_pixel(0.0, 0.0)
    right, up = picture.axes[0].to_pixel(1.0, 1.0)
    assert right - x == pytest.approx(y - up)
    assert right - x == pytest.approx(px_per_m(picture))


def halfway(picture: PairPicture, index: int) -> tuple[int, ...]:
    return color_at(picture, *(0.5 * (LIDAR_M[index] + DEPTH_M[index]) + (0.0, 0.03)))


def test_inliers_are_joined_and_others_are_not():
    without = drawn(plot(is_inlier=np.zeros(5, dtype=bool)))
    picture = drawn(plot(is_inlier=AGREE))
    assert halfway(picture, 0) != halfway(without, 0)
    assert halfway(picture, 1) == halfway(without, 1)


def test_an_outlier_is_a_cross():
    dotted, crossed = drawn(plot(is_inlier=AGREE)), drawn(plot(is_inlier=np.zeros(5, dtype=bool)))
    x, y = (round(value) for value in dotted.axes[0].to_pixel(*LIDAR_M[0]))
    # An arm's end, beyond a dot; and beside the middle, within a dot and between the arms.
    assert dotted.rgb[y + 3, x + 3].min() > 230 > crossed.rgb[y + 3, x + 3].min()
    assert dotted.rgb[y - 2, x].min() < 150 < crossed.rgb[y - 2, x].min()


def test_without_an_a_all_pairs_are_joined():
    picture = drawn(plot())
    assert max(halfway(picture, 1)) < 200
    assert max(halfway(drawn(plot(is_inlier=AGREE)), 1)) > 230


def test_sampled_pairs_are_ringed():
    # So wide that the legend is of one line in both.
    picture = drawn(plot(is_inlier=AGREE, sample=np.array([1])), width_px=620)
    plain = drawn(plot(is_inlier=AGREE), width_px=620)
    differs = (picture.axes[0].inside != plain.axes[0].inside).any(axis=2)
    y, x = np.nonzero(differs)
    box = picture.axes[0].box
    for points_m in (LIDAR_M, DEPTH_M):
        at = picture.axes[0].to_pixel(*points_m[1])
        near = np.hypot(x + box.left - at[0], y + box.top - at[1]) < 8.0
        assert near.sum() > 20
    for other in (0, 2):
        at = picture.axes[0].to_pixel(*LIDAR_M[other])
        assert not (np.hypot(x + box.left - at[0], y + box.top - at[1]) < 8.0).any()


def test_plots_share_the_scale_of_the_first():
    after = plot(title="after", lidar_m=LIDAR_M - (0.0, 1.0), is_inlier=AGREE)
    picture = drawn(plot(is_inlier=AGREE), after, height_px=600)
    alone = drawn(plot(is_inlier=AGREE), plot(), height_px=600)
    assert picture.axes[0].x_limits == picture.axes[1].x_limits == alone.axes[0].x_limits
    assert picture.axes[0].y_limits == picture.axes[1].y_limits == alone.axes[0].y_limits
    first, second = (axes.box for axes in picture.axes)
    assert first.bottom < second.top
    # The map of this plot lays the LiDAR's points on the depth's.
    assert color_at(picture, *DEPTH_M[0], number=1) == color_of("lidar")
    assert color_at(picture, *DEPTH_M[0], number=0) == color_of("depth")


def test_a_few_stray_points_do_not_take_the_scale():
    along = np.linspace(-1.0, 1.0, 200)
    wall_m = np.stack([along, np.full(200, 3.0)], axis=1)
    stray_m = wall_m.copy()
    stray_m[7] = 80.0, 90.0
    clean = drawn(PairPlot(title="", lidar_m=wall_m, depth_m=wall_m + 0.2))
    strayed = drawn(PairPlot(title="", lidar_m=stray_m, depth_m=wall_m + 0.2))
    assert px_per_m(strayed) > 0.5 * px_per_m(clean)


def test_a_transform_that_sends_points_far_away_is_drawn():
    wild_m = LIDAR_M * 1e12
    wild_m[2] = np.inf, -np.inf
    picture = drawn(plot(is_inlier=AGREE), plot(lidar_m=wild_m, is_inlier=AGREE), height_px=600)
    assert count_of(picture, "lidar", 1) == 0
    assert count_of(picture, "depth", 1) > 0


def test_nothing_to_draw_is_no_error():
    nothing = np.full((4, 2), np.nan)
    picture = drawn(plot(lidar_m=nothing, depth_m=nothing, is_inlier=np.zeros(4, dtype=bool)))
    assert count_of(picture, "lidar") == 0
    assert drawn(plot(lidar_m=np.zeros((0, 2)), depth_m=np.zeros((0, 2)))).rgb.any()


def test_a_single_place_has_a_scale():
    same = np.full((3, 2), 2.0)
    picture = drawn(plot(lidar_m=same, depth_m=same, is_inlier=np.ones(3, dtype=bool)))
    assert np.isfinite(px_per_m(picture))
    assert color_at(picture, 2.0, 2.0) == color_of("lidar")


def test_given_arrays_are_left_alone():
    lidar_m, depth_m = LIDAR_M.copy(), DEPTH_M.copy()
    drawn(plot(lidar_m=lidar_m, depth_m=depth_m, is_inlier=AGREE))
    np.testing.assert_array_equal(lidar_m, LIDAR_M)
    np.testing.assert_array_equal(depth_m, DEPTH_M)


def test_no_plot_and_too_small_a_picture_are_refused():
    with pytest.raises(ValueError, match="need a plot"):
        drawn()
    with pytest.raises(ValueError, match="to draw in"):
        drawn(plot(), width_px=60)
