"""Matches between two images as lines, and a cloud over an image."""

import numpy as np

from fusion_core.workflows.calibrate.recorded_camera import CloudInImage
from scanloom.plots.cloud_overlay import cloud_overlay_picture
from scanloom.plots.match_picture import match_picture
from scanloom.plots.palette import color_of
from scanloom.plots.theme import DARK, LIGHT

CAMERA = np.full((90, 120), 60, np.uint8)
INTENSITY = np.full((70, 200), 90, np.uint8)
IMAGE_PX = np.array([[10.0, 10.0], [60.0, 45.0], [100.0, 80.0], [np.nan, 5.0]])
INTENSITY_PX = np.array([[20.0, 20.0], [100.0, 35.0], [180.0, 60.0], [50.0, 5.0]])
ACCEPTED = np.array([True, False, True, False])


def test_lines_join_the_pixels_of_each_match() -> None:
    drawn = match_picture(
        CAMERA, INTENSITY, IMAGE_PX, INTENSITY_PX, ACCEPTED, width_px=416, theme=LIGHT
    )
    # Both images are 400 px wide: the pixels' centres are scaled, below each other.
    assert sorted(drawn.pairs) == [0, 1, 2]
    for place, pair in enumerate(drawn.pairs):
        np.testing.assert_allclose(
            drawn.upper_px[place] - drawn.upper_px[0],
            (IMAGE_PX[pair] - IMAGE_PX[drawn.pairs[0]]) * 400 / 120,
        )
        np.testing.assert_allclose(
            drawn.lower_px[place] - drawn.lower_px[0],
            (INTENSITY_PX[pair] - INTENSITY_PX[drawn.pairs[0]]) * 2.0,
        )
        color = color_of("good") if ACCEPTED[pair] else (150, 150, 150)
        for x, y in (drawn.upper_px[place], drawn.lower_px[place]):
            assert tuple(drawn.rgb[round(y), round(x)]) == color
            assert drawn.pair_at(x + 2.0, y - 2.0) == place
    assert drawn.pair_at(0.0, 0.0) is None


def test_of_many_matches_some_are_drawn_and_none_need_none() -> None:
    many = 5000
    pixels = np.random.default_rng(1).uniform(0.0, 60.0, (many, 2))
    drawn = match_picture(
        CAMERA, INTENSITY, pixels, pixels, np.arange(many) % 2 == 0, width_px=300, theme=DARK
    )
    assert 100 < drawn.pairs.size < 200
    empty = np.empty((0, 2))
    none = match_picture(CAMERA, INTENSITY, empty, empty, np.empty(0, bool), width_px=300)
    assert none.pair_at(10.0, 10.0) is None


def test_points_are_where_the_cloud_is_and_the_near_one_is_on_top() -> None:
    cloud = CloudInImage(
        pixels=np.array([[60.0, 45.0], [60.0, 45.0], [5.0, 5.0]]), depth_m=np.array([9.0, 1.0, 1.0])
    )
    grey = np.full((90, 120), 100, np.uint8)
    shown = cloud_overlay_picture(grey, cloud, title="now", width_px=400, opacity=1.0)
    bare = cloud_overlay_picture(grey, cloud, title="now", width_px=400, opacity=0.0)
    differing = np.argwhere((shown != bare).any(axis=2))
    assert len(differing) == 2
    colors = {tuple(map(int, shown[row, column])) for row, column in differing}
    # Both are of the nearest colour: dark.
    assert len(colors) == 1
    assert np.sum(next(iter(colors))) < 200
    empty = CloudInImage(pixels=np.empty((0, 2)), depth_m=np.empty(0))
    cloud_overlay_picture(grey, empty, title="none", width_px=300, opacity=1.0, theme=DARK)
