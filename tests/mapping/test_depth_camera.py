"""Images of a lens without its distortion, against the projection of each pixel's straight ray."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.calibration.projection import project_points
from fusion_core.mapping.depth_camera import StraightImages, depth_intrinsics
from fusion_core.model.errors import MappingFailed
from fusion_core.model.sensors import CameraIntrinsics

PINHOLE = CameraIntrinsics(width=160, height=120, fx=110.0, fy=112.0, cx=78.5, cy=61.0)
LENSES = {
    "barrel": replace(PINHOLE, distortion=(-0.3, 0.1, 0.002, -0.001, 0.01)),
    "six coefficients": replace(PINHOLE, distortion=(0.4, 0.2, 0.0, 0.001, 0.05, 0.6)),
    "folding": replace(PINHOLE, distortion=(-0.8, 0.0, 0.0, 0.0)),
    "folding twice": replace(PINHOLE, distortion=(-1.2, 0.55, 0.0, 0.0, 0.0)),
    "fisheye": replace(PINHOLE, distortion_model="equidistant", distortion=(0.03, -0.01)),
    "fisheye without coefficients": replace(PINHOLE, distortion_model="equidistant"),
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


def test_the_camera_of_smaller_images_sees_the_same() -> None:
    half = depth_intrinsics(PINHOLE, (60, 80))
    # A pixel of the half covers two by two: its centre is where theirs meet.
    (pixel,) = project_points(np.array([[0.2, -0.1, 1.0]]), PINHOLE)
    (smaller,) = project_points(np.array([[0.2, -0.1, 1.0]]), half)
    np.testing.assert_allclose(smaller, (pixel - 0.5) / 2.0)


def test_an_impossible_size_is_refused() -> None:
    with pytest.raises(MappingFailed, match="a depth image of 1 x 1 pixels is not of a camera"):
        depth_intrinsics(replace(PINHOLE, fx=0.1, fy=0.1), (1, 1))
