"""The virtual camera: projection, rays, pixel sizes, and directions that cover a cloud."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.calibration.features.virtual_camera import (
    VirtualCamera,
    camera_towards,
    cloud_directions,
)
from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import invert_transform, transform_points


def camera(azimuth: float = 0.3, elevation: float = -0.2) -> VirtualCamera:
    direction = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    return camera_towards(direction, focal_px=300.0, width=401, height=301)


@given(st.floats(-3.0, 3.0), st.floats(-1.2, 1.2))
def test_the_direction_is_the_middle_of_the_image_and_up_is_up(
    azimuth: float, elevation: float
) -> None:
    view = camera(azimuth, elevation)
    direction = view.T_view_lidar[2, :3]
    pixels, depth_m = view.project(np.array([direction * 2.0, direction * 2.0 + (0, 0, 0.1)]))
    np.testing.assert_allclose(pixels[0], (200.0, 150.0), atol=1e-9)
    assert depth_m[0] == pytest.approx(2.0)
    assert pixels[1, 1] < 150.0


@given(st.floats(1.0, 8.0))
def test_rays_lead_back_to_their_pixels_at_any_pixel_size(size: float) -> None:
    view = camera().with_pixel_size(size)
    pixels = np.array([[0.0, 0.0], [10.25, 20.5], [30.0, 3.75]])
    points = transform_points(invert_transform(view.T_view_lidar), 3.0 * view.rays(pixels))
    np.testing.assert_allclose(view.project(points)[0], pixels, atol=1e-9)


def test_larger_pixels_keep_the_edge_of_the_image() -> None:
    fine, coarse = camera(), camera().with_pixel_size(4.0)
    left = fine.rays(np.array([[-0.5, -0.5]]))
    np.testing.assert_allclose(coarse.rays(np.array([[-0.5, -0.5]])), left, atol=1e-12)
    assert (coarse.width, coarse.height) == (100, 75)


def test_a_point_behind_has_no_pixel() -> None:
    view = camera()
    assert np.isnan(view.project(-view.T_view_lidar[2:3, :3])[0]).all()


@given(st.integers(0, 1000), st.floats(-3.0, 3.0), st.floats(-1.2, 1.2))
def test_what_falls_into_the_picture_is_what_projects_there(
    seed: int, azimuth: float, elevation: float
) -> None:
    view = camera(azimuth, elevation)
    rng = np.random.default_rng(seed)
    points = rng.uniform(0.0, 5.0, (500, 1)) * sphere(500)
    points = transform_points(invert_transform(view.T_view_lidar), points)
    pixels, depth_m = view.project(points)
    u, v = pixels.T
    inside = np.flatnonzero((u >= -0.5) & (u < 400.5) & (v >= -0.5) & (v < 300.5))
    seen, seen_pixels, seen_depth_m = view.see(points)
    assert inside.size > 10
    np.testing.assert_array_equal(seen, inside)
    np.testing.assert_allclose(seen_pixels, pixels[inside], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(seen_depth_m, depth_m[inside], rtol=1e-12)


def sphere(count: int = 20_000) -> FloatArray:
    points = np.random.default_rng(0).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1)[:, np.newaxis]


def test_a_narrow_cloud_is_seen_by_one_camera_towards_its_centre() -> None:
    points = sphere()
    points = points[points @ (0.6, 0.0, 0.8) > 0.95]
    directions = list(cloud_directions(points, 1.2))
    assert len(directions) == 1
    np.testing.assert_allclose(directions[0], (0.6, 0.0, 0.8), atol=0.01)


def test_every_point_of_a_whole_sphere_lies_within_half_a_view_of_a_direction() -> None:
    directions = np.array(list(cloud_directions(sphere(), 1.2)))
    closest = (sphere(5000) @ directions.T).max(axis=1)
    assert np.arccos(closest).max() < 0.6


def test_directions_without_points_are_left_out() -> None:
    points = sphere()
    whole = len(list(cloud_directions(points, 1.2)))
    half = list(cloud_directions(points[points[:, 0] > 0.0], 1.2))
    assert len(half) < 0.8 * whole
    assert min(direction[0] for direction in half) > -0.7
