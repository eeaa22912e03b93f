"""The intensity image against loops over its formulas, and its search of the pixel size."""

import numpy as np
import pytest

from fusion_core.calibration.features.cloud_filter import CloudFilterSettings
from fusion_core.calibration.features.intensity_correction import (
    corrected_intensity,
    incidence_cosine,
)
from fusion_core.calibration.features.intensity_image import (
    PUBLISHED,
    IntensityImageSettings,
    render_intensity_image,
    search_pixel_size,
)
from fusion_core.calibration.features.virtual_camera import VirtualCamera, camera_towards
from fusion_core.model.conventions import FloatArray

NO_FILTER = CloudFilterSettings(neighbours_min=0)
PLAIN = IntensityImageSettings(correction="none", equalisation="none", fill_radius_px=0.0)


def view() -> VirtualCamera:
    return camera_towards(np.array([1.0, 0.0, 0.0]), focal_px=20.0, width=24, height=18)


def scattered(count: int = 900, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    points = rng.uniform([1.0, -1.0, -0.8], [4.0, 1.0, 0.8], (count, 3))
    return points, rng.uniform(1.0, 200.0, count)


def test_each_pixel_shows_the_point_of_median_distance() -> None:
    points, intensity = scattered()
    settings = PLAIN.model_copy(update={"pixel_value": "median"})
    image = render_intensity_image(points, intensity, view(), 1.0, settings, NO_FILTER)
    for row in range(18):
        for column in range(24):
            # (11), (12): the nearest pixel; u' runs along -Y and v' along -Z, over X.
            u = -20.0 * points[:, 1] / points[:, 0] + 11.5
            v = -20.0 * points[:, 2] / points[:, 0] + 8.5
            here = np.flatnonzero((np.floor(u + 0.5) == column) & (np.floor(v + 0.5) == row))
            if here.size == 0:
                assert np.isnan(image.intensity[row, column])
                assert np.isnan(image.points_m[row, column]).all()
                continue
            middle = here[np.argsort(points[here, 0])][(here.size - 1) // 2]
            np.testing.assert_allclose(image.points_m[row, column], points[middle], rtol=1e-6)
            assert image.intensity[row, column] == pytest.approx(intensity[middle], rel=1e-6)


def test_the_mean_leaves_out_what_lies_before_and_behind() -> None:
    points = np.array([[2.0, 0.05, 0.05]] * 4 + [[1.0, 0.025, 0.025]])
    image = render_intensity_image(
        points, np.array([10.0, 20.0, 30.0, 40.0, 200.0]), view(), 1.0, PLAIN, NO_FILTER
    )
    assert np.nanmax(image.intensity) == pytest.approx(25.0)


def test_a_hole_is_filled_in_the_picture_and_has_no_point() -> None:
    rows, columns = np.mgrid[0:18, 0:24]
    rays = view().rays(np.stack([columns.ravel(), rows.ravel()], axis=1).astype(float))
    points = 2.0 * rays @ view().T_view_lidar[:3, :3]
    kept = np.arange(len(points)) != 9 * 24 + 12
    settings = PLAIN.model_copy(update={"fill_radius_px": 0.7})
    image = render_intensity_image(
        points[kept], np.linspace(50, 60, kept.sum()), view(), 1.0, settings, NO_FILTER
    )
    assert np.isnan(image.points_m[9, 12]).all()
    assert np.isnan(image.intensity[9, 12])
    assert 50.0 < image.smooth[9, 12] < 60.0
    assert image.kept_fraction == 1.0


def test_rank_equalisation_uses_all_greys_evenly() -> None:
    points, intensity = scattered(6000)
    settings = PLAIN.model_copy(update={"equalisation": "rank"})
    image = render_intensity_image(points, intensity**3, view(), 1.0, settings, NO_FILTER)
    shown = image.picture[np.isfinite(image.intensity)]
    assert np.histogram(shown, bins=4, range=(0, 256))[0].std() < 0.05 * shown.size


def test_the_pixel_size_grows_until_enough_pixels_are_filled() -> None:
    wide = camera_towards(np.array([1.0, 0.0, 0.0]), focal_px=200.0, width=240, height=180)
    rng = np.random.default_rng(1)
    at = rng.uniform((0, 0), (240, 180), (10_000, 2))
    points = 3.0 * wide.rays(at) @ wide.T_view_lidar[:3, :3]
    search = search_pixel_size(points, wide, IntensityImageSettings())
    # Of pixels of area a, 1 - exp(-a n) have one of n points an area.
    expected = 1.0 - np.exp(-(search.sizes**2) * 10_000 / (240 * 180))
    np.testing.assert_allclose(search.filled_fraction, expected, atol=0.05)
    assert (np.diff(search.kept_fraction) < 0.0).all()
    assert search.filled_fraction[-1] >= 0.5 > search.filled_fraction[-2]
    assert search.chosen == search.sizes[-1]
    assert search_pixel_size(points, wide, PUBLISHED).chosen > search.chosen


def slanted_plane() -> FloatArray:
    """(60, 80, 3) points on a plane that is seen at a changing angle."""
    rows, columns = np.mgrid[0:60, 0:80]
    big = camera_towards(np.array([1.0, 0.0, 0.0]), focal_px=60.0, width=80, height=60)
    rays = big.rays(np.stack([columns.ravel(), rows.ravel()], axis=1).astype(float))
    rays = rays @ big.T_view_lidar[:3, :3]
    normal = np.array([0.6, 0.8, 0.0])
    return (rays * (2.0 / (rays @ normal))[:, np.newaxis]).reshape(60, 80, 3)


def test_the_incidence_angle_is_that_of_the_plane() -> None:
    points = slanted_plane()
    expected = np.abs(points @ (0.6, 0.8, 0.0)) / np.linalg.norm(points, axis=2)
    cosine = incidence_cosine(points.astype(np.float32))
    np.testing.assert_allclose(cosine[5:-5, 5:-5], expected[5:-5, 5:-5], rtol=1e-3)


def test_the_correction_undoes_range_and_angle() -> None:
    points = slanted_plane()
    range_m = np.linalg.norm(points, axis=2)
    cosine = np.abs(points @ (0.6, 0.8, 0.0)) / range_m
    rng = np.random.default_rng(2)
    reflectance = rng.choice([20.0, 60.0, 100.0], range_m.shape, p=[0.2, 0.6, 0.2])
    seen = reflectance * range_m**-2.0 * cosine
    corrected = corrected_intensity(seen, points.astype(np.float32))[6:-6, 6:-6]
    ratio = corrected / reflectance[6:-6, 6:-6]
    # Uncorrected it varies by a factor of ten.
    assert ratio.std() < 0.05 * ratio.mean()


def test_no_surface_is_seen_at_a_slant_across_a_depth_edge() -> None:
    points = np.repeat(slanted_plane()[:, :1], 80, axis=1)
    columns = np.linspace(-0.6, 0.6, 80)
    points[..., 0] = 2.0
    points[:, 40:, 0] = 4.0
    points[..., 1] = points[..., 0] * columns
    points[..., 2] = points[..., 0] * np.linspace(-0.4, 0.4, 60)[:, np.newaxis]
    cosine = incidence_cosine(points.astype(np.float32))
    assert np.isnan(cosine[30, 38:42]).all()
    assert np.nanmin(cosine[10:-10, 10:-10]) > 0.8
