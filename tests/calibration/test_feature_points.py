"""The 3D point of a feature: on its ray, on the surface, and never across a depth edge."""

import numpy as np

from fusion_core.calibration.features.cloud_filter import CloudFilterSettings
from fusion_core.calibration.features.feature_points import (
    has_middle_fraction,
    interpolated_points,
    nearest_points,
)
from fusion_core.calibration.features.intensity_image import (
    IntensityImage,
    IntensityImageSettings,
    render_intensity_image,
)
from fusion_core.calibration.features.virtual_camera import VirtualCamera, camera_towards
from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import transform_points

PLAIN = IntensityImageSettings(correction="none")


def view() -> VirtualCamera:
    return camera_towards(np.array([0.0, 1.0, 0.0]), focal_px=100.0, width=120, height=90)


def image_of(points: FloatArray) -> IntensityImage:
    return render_intensity_image(
        points,
        np.linspace(1, 9, len(points)),
        view(),
        1.0,
        PLAIN,
        CloudFilterSettings(neighbours_min=0),
    )


def points_at(pixels: FloatArray, normal: FloatArray, distance: float) -> FloatArray:
    rays = view().rays(pixels) @ view().T_view_lidar[:3, :3]
    return rays * (distance / (rays @ normal))[:, np.newaxis]


def test_a_feature_on_a_plane_has_the_plane_s_point_on_its_ray() -> None:
    rng = np.random.default_rng(0)
    normal = np.array([0.4, 0.9, 0.1])
    image = image_of(points_at(rng.uniform((0, 0), (119, 89), (30_000, 2)), normal, 2.5))
    features = rng.uniform((10, 10), (110, 80), (50, 2))
    points, is_edge = interpolated_points(image, features, radius_px=3, edge_fraction=0.05)
    assert not is_edge.any()
    np.testing.assert_allclose(points, points_at(features, normal, 2.5), atol=1e-5)


def test_noise_is_averaged_and_the_ray_is_kept() -> None:
    rng = np.random.default_rng(1)
    normal = np.array([0.0, 1.0, 0.0])
    clean = points_at(rng.uniform((0, 0), (119, 89), (40_000, 2)), normal, 3.0)
    noisy = clean * (1.0 + rng.normal(scale=0.01, size=(len(clean), 1)) / 3.0)
    features = rng.uniform((10, 10), (110, 80), (200, 2))
    points, _ = interpolated_points(image_of(noisy), features, radius_px=3, edge_fraction=0.1)
    seen = transform_points(view().T_view_lidar, points)
    np.testing.assert_allclose(
        100.0 * seen[:, :2] / seen[:, 2:] + (59.5, 44.5), features, atol=1e-6
    )
    assert np.std(seen[:, 2] - 3.0) < 0.004


def test_there_is_no_point_across_a_depth_edge_nor_in_a_hole() -> None:
    rng = np.random.default_rng(2)
    pixels = rng.uniform((0, 0), (119, 89), (40_000, 2))
    pixels = pixels[np.abs(pixels[:, 0] - 100.0) > 8.0]
    distance = np.where(pixels[:, 0] < 50.0, 2.0, 3.0)
    rays = view().rays(pixels) @ view().T_view_lidar[:3, :3]
    image = image_of(rays * distance[:, np.newaxis])
    features = np.array([[30.0, 40.0], [50.0, 40.0], [70.0, 40.0], [100.0, 40.0]])
    points, is_edge = interpolated_points(image, features, radius_px=3, edge_fraction=0.05)
    np.testing.assert_array_equal(is_edge, (False, True, False, False))
    np.testing.assert_array_equal(np.isfinite(points[:, 0]), (True, False, True, False))
    np.testing.assert_array_equal(
        np.isfinite(nearest_points(image, features)[:, 0]), (True, True, True, False)
    )


def test_a_fraction_far_from_whole_pixels_is_dropped_as_published() -> None:
    pixels = np.array([[10.0, 20.1], [10.29, 20.71], [10.31, 20.0], [10.0, 20.5], [9.8, 20.9]])
    np.testing.assert_array_equal(has_middle_fraction(pixels), (False, False, True, True, False))
