"""A depth image as coloured points: where they are, how large, and in which colours."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import make_transform, transform_points
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import CameraIntrinsics, ColorImage
from scanloom.scene.color_picture import upright_color
from scanloom.scene.depth_surface import (
    colors_by_depth,
    colors_by_image,
    depth_surface,
    is_registered,
    muted,
    point_at,
)

T_LIDAR_CAMERA = make_transform(R_BODY_OPTICAL, np.array([0.1, -0.2, 0.3]))


def camera(width: int, height: int) -> Camera:
    lens = CameraIntrinsics(
        width=width,
        height=height,
        fx=0.9 * width,
        fy=0.9 * width,
        cx=0.5 * (width - 1),
        cy=0.5 * (height - 1),
    )
    return Camera(topic="/d", intrinsics=lens, T_rig_camera=np.eye(4))


def test_points_lie_on_the_rays_of_their_pixels():
    depth_m = np.random.default_rng(1).uniform(1.0, 5.0, (60, 80)).astype(np.float32)
    depth_m[10:20, 30:50] = np.nan
    model = camera(80, 60)
    seen = depth_surface(depth_m, model, T_LIDAR_CAMERA)
    assert len(seen.points_m) == 60 * 80 - 200
    rows, columns = np.nonzero(np.isfinite(depth_m))
    rays = model.rays(rows, columns) * depth_m[rows, columns, np.newaxis]
    np.testing.assert_allclose(seen.points_m, transform_points(T_LIDAR_CAMERA, rays), atol=1e-5)
    np.testing.assert_allclose(seen.down * 60 - 0.5, rows, atol=1e-4)
    np.testing.assert_allclose(seen.right * 80 - 0.5, columns, atol=1e-4)


@pytest.mark.parametrize("shape", [(240, 320), (480, 640), (1080, 1920)])
def test_large_images_are_strided_and_their_points_touch(shape):
    height, width = shape
    seen = depth_surface(np.full(shape, 3.0, np.float32), camera(width, height), T_LIDAR_CAMERA)
    assert 10_000 < len(seen.points_m) <= 20_300
    spacing_m = np.diff(np.unique(seen.points_m[:, 1].round(5))).max()
    assert spacing_m < seen.point_m < 3.0 * spacing_m


def test_an_image_without_depth_has_no_points():
    seen = depth_surface(np.full((6, 8), np.nan, np.float32), camera(8, 6), T_LIDAR_CAMERA)
    assert seen.points_m.shape == (0, 3)
    assert colors_by_depth(seen, 1.0, 2.0).shape == (0, 3)
    assert muted(colors_by_depth(seen, 1.0, 2.0), (100.0, 200.0)).shape == (0, 3)
    assert point_at(seen, (0.5, 0.5)) is None


def test_colours_are_those_of_the_same_place():
    seen = depth_surface(np.full((60, 80), 2.0, np.float32), camera(80, 60), T_LIDAR_CAMERA)
    image = np.zeros((30, 40, 3), dtype=np.uint8)
    image[:, 20:, 0] = 200
    image[15:, :, 1] = 100
    colors = colors_by_image(seen, image)
    np.testing.assert_array_equal(colors[:, 0], np.where(seen.right > 0.5, 200, 0))
    np.testing.assert_array_equal(colors[:, 1], np.where(seen.down > 0.5, 100, 0))


def test_the_point_at_a_place_is_that_of_its_pixel():
    depth_m = np.full((60, 80), 2.0, np.float32)
    depth_m[:, 40:] = np.nan
    seen = depth_surface(depth_m, camera(80, 60), T_LIDAR_CAMERA)
    point = point_at(seen, (10.5 / 60, 20.5 / 80))
    assert point is not None
    ray = camera(80, 60).rays(np.array([10]), np.array([20]))
    np.testing.assert_allclose(point, transform_points(T_LIDAR_CAMERA, 2.0 * ray)[0], atol=1e-5)
    assert point_at(seen, (0.5, 0.9)) is None


def test_far_is_brighter_than_near():
    depth_m = np.linspace(1.0, 4.0, 80, dtype=np.float32)[np.newaxis].repeat(60, axis=0)
    seen = depth_surface(depth_m, camera(80, 60), T_LIDAR_CAMERA)
    colors = colors_by_depth(seen, 1.0, 4.0)[:80]
    grey = cv2.cvtColor(colors[np.newaxis], cv2.COLOR_RGB2GRAY)[0].astype(int)
    assert (np.diff(grey) >= -1).all()
    assert grey[-1] - grey[0] > 150


def test_muted_colours_are_nearly_grey_and_of_medium_brightness():
    colors = np.array([[0, 0, 0], [255, 255, 255], [255, 0, 0], [0, 90, 255]], dtype=np.uint8)
    quiet = muted(colors, (100.0, 160.0)).astype(int)
    np.testing.assert_allclose(quiet[:2], [[100] * 3, [160] * 3], atol=1)
    assert (np.ptp(quiet, axis=1) <= 0.23 * np.ptp(colors.astype(int), axis=1) + 1).all()


def color(shape: tuple[int, int], frame_id: str = "camera") -> ColorImage:
    return ColorImage(
        stamp_ns=0, received_ns=None, frame_id=frame_id, rgb=np.zeros((*shape, 3), np.uint8)
    )


def test_only_an_image_of_the_same_view_gives_its_colours():
    depth = SimpleNamespace(frame_id="camera", depth_m=np.zeros((240, 320)))
    assert is_registered(color((240, 320)), depth)
    assert is_registered(color((480, 640)), depth)
    assert not is_registered(color((240, 320), "color camera"), depth)
    assert not is_registered(color((1080, 1920)), depth)


def test_colour_is_turned_cut_and_made_small_as_the_depth():
    stored = np.zeros((200, 400, 3), dtype=np.uint8)
    stored[:100, 200:] = 255
    lens = SimpleNamespace(width=100)
    turned = SimpleNamespace(
        R_stored_view=np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        stored_shape=(100, 200),
        intrinsics=lens,
    )
    picture = upright_color(stored, SimpleNamespace(views=(turned,)), 0)
    assert picture.shape == (400, 200, 3)
    np.testing.assert_array_equal(picture, np.rot90(stored, 1))
    half = SimpleNamespace(R_stored_view=np.eye(3), stored_shape=(100, 200), intrinsics=lens)
    picture = upright_color(stored, SimpleNamespace(views=(half,)), 0, most_px=50)
    assert picture.shape == (50, 50, 3)
    assert picture[5, 45].tolist() == [255, 255, 255]
