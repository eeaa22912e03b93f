"""Images of a lens without its distortion, against the projection of each pixel's straight ray."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fusion_core.lens.projection import project_points
from fusion_core.lens.straight_images import StraightImages
from fusion_core.model.sensors import CameraIntrinsics

PINHOLE = CameraIntrinsics(width=160, height=120, fx=110.0, fy=112.0, cx=78.5, cy=61.0)
LENSES = {
    "barrel": replace(PINHOLE, distortion=(-0.3, 0.1, 0.002, -0.001, 0.01)),
    "six coefficients": replace(PINHOLE, distortion=(0.4, 0.2, 0.0, 0.001, 0.05, 0.6)),
    "folding": replace(PINHOLE, distortion=(-0.8, 0.0, 0.0, 0.0)),
    "folding twice": replace(PINHOLE, distortion=(-1.2, 0.55, 0.0, 0.0, 0.0)),
    "fisheye": replace(PINHOLE, distortion_model="equidistant", distortion=(0.03, -0.01)),
}


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
def test_each_pixel_shows_its_straight_ray(lens: CameraIntrinsics) -> None:
    height, width = lens.height, lens.width
    # Each stored pixel tells its own place.
    row, column = np.mgrid[:height, :width]
    depth_m = (1.0 + row * width + column).astype(np.float32)
    straight_m = StraightImages(lens).depth(depth_m)

    rays = np.stack([(column - lens.cx) / lens.fx, (row - lens.cy) / lens.fy], axis=-1)
    points = np.concatenate([rays, np.ones((height, width, 1))], axis=-1).reshape(-1, 3)
    stored = project_points(points, lens).reshape(height, width, 2)
    u, v = np.moveaxis(stored, -1, 0)
    is_shown = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5)
    # Which of two pixels is nearest, and the place of the fold to a pixel, are left to rounding.
    assert np.mean(np.isfinite(straight_m) != is_shown) < 0.01
    both = np.isfinite(straight_m) & is_shown
    found = straight_m[both].astype(np.int64) - 1
    assert np.abs(found % width - u[both]).max() < 0.51
    assert np.abs(found // width - v[both]).max() < 0.51
    assert both.mean() > 0.25


@pytest.mark.parametrize("name", ["barrel", "fisheye"])
def test_both_images_stay_together(name: str) -> None:
    lens = LENSES[name]
    row, column = np.mgrid[: lens.height, : lens.width]
    straight = StraightImages(lens)
    depth = straight.depth(column.astype(np.float32))
    color = straight.color(np.stack([column, row, row], axis=-1).astype(np.uint8))
    inside = (slice(20, 100), slice(20, 140))
    assert np.nanmax(np.abs(depth[inside] - color[inside][..., 0])) < 1.1


def test_images_without_distortion_stay_as_they_are() -> None:
    straight = StraightImages(PINHOLE)
    depth_m = np.ones((120, 160), np.float32)
    assert straight.depth(depth_m) is depth_m
    rgb = np.zeros((120, 160, 3), np.uint8)
    assert straight.color(rgb) is rgb


@pytest.mark.parametrize("name", ["barrel", "six coefficients", "fisheye"])
def test_the_places_are_those_of_opencv(name: str) -> None:
    lens = LENSES[name]
    row, column = np.mgrid[: lens.height, : lens.width]
    straight = StraightImages(lens)
    found_u, found_v = (
        straight.depth(column.astype(np.float32)),
        straight.depth(row.astype(np.float32)),
    )
    make_maps = (
        cv2.fisheye.initUndistortRectifyMap if lens.is_fisheye else cv2.initUndistortRectifyMap
    )
    size = (lens.width, lens.height)
    u, v = make_maps(
        lens.matrix, lens.opencv_distortion, np.eye(3), lens.matrix, size, cv2.CV_32FC1
    )
    shown = np.isfinite(found_u)
    assert shown.mean() > 0.25
    # Half a pixel to the nearest.
    assert np.abs(found_u - u)[shown].max() < 0.51
    assert np.abs(found_v - v)[shown].max() < 0.51


@pytest.mark.parametrize(
    "lens",
    [
        replace(PINHOLE, distortion=(-0.25, 0.08, 0.001, -0.002, 0.0)),
        replace(PINHOLE, distortion_model="equidistant", distortion=(0.02, -0.01, 0.003, 0.0)),
    ],
    ids=["plumb bob", "fisheye"],
)
def test_a_spot_lies_where_the_camera_matrix_has_it(lens: CameraIntrinsics) -> None:
    ((u, v),) = project_points(np.array([[0.31, -0.22, 1.0]]), lens)
    rows, columns = np.mgrid[: lens.height, : lens.width]
    spot = 255.0 * np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 8.0)
    stored = np.repeat(spot.astype(np.uint8)[..., np.newaxis], 3, axis=2)
    straight = StraightImages(lens).color(stored)[..., 0].astype(float)
    seen = np.array([(straight * columns).sum(), (straight * rows).sum()]) / straight.sum()
    expected = PINHOLE.fx * 0.31 + PINHOLE.cx, -PINHOLE.fy * 0.22 + PINHOLE.cy
    np.testing.assert_allclose(seen, expected, atol=0.5)


@pytest.mark.parametrize("model", ["plumb_bob", "equidistant"])
def test_zeros_of_any_model_are_no_distortion(model: str) -> None:
    lens = replace(PINHOLE, distortion_model=model, distortion=(0.0,) * 4)
    point = np.array([[0.31, -0.22, 1.0]])
    np.testing.assert_array_equal(project_points(point, lens), project_points(point, PINHOLE))
    depth_m = np.ones((120, 160), np.float32)
    assert StraightImages(lens).depth(depth_m) is depth_m
