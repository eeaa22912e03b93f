"""Clouds that cannot be used are refused in one line; outliers are left out."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.calibration.features.cloud_filter import (
    CloudFilterSettings,
    is_no_outlier,
    usable_points,
)
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.sensors import PointCloud

SETTINGS = CloudFilterSettings()


def cloud(scale: float = 1.0, count: int = 5000) -> PointCloud:
    rng = np.random.default_rng(0)
    points = rng.uniform([-3.0, -3.0, -1.0], [3.0, 3.0, 1.0], (count, 3))
    points[:, 0] += 6.0
    return PointCloud(
        stamp_ns=0,
        received_ns=None,
        frame_id="lidar",
        xyz_m=(scale * points).astype(np.float32),
        intensity=rng.uniform(0, 100, count).astype(np.float32),
    )


def test_points_that_are_not_finite_are_left_out() -> None:
    whole = cloud()
    xyz, intensity = whole.xyz_m.copy(), whole.intensity.copy()
    xyz[:100], xyz[100:200, 1], intensity[200:300] = np.nan, np.inf, np.nan
    points, values = usable_points(replace(whole, xyz_m=xyz, intensity=intensity), SETTINGS)
    assert len(points) == len(values) == 4700
    np.testing.assert_array_equal(points, whole.xyz_m[300:].astype(np.float64))


@pytest.mark.parametrize(
    ("damaged", "message"),
    [
        (replace(cloud(), intensity=None), "no intensities"),
        (replace(cloud(), intensity=np.full(5000, 7.0, np.float32)), "all points have the int.* 7"),
        (cloud(scale=1000.0), "millimetres"),
        (cloud(scale=0.001), "another unit"),
        (replace(cloud(), xyz_m=np.full((5000, 3), np.nan, np.float32)), "only 0 of 5000"),
        (replace(cloud(), xyz_m=np.full((5000, 3), np.inf, np.float32)), "only 0 of 5000"),
        (cloud(count=200), "only 200 of 200"),
    ],
)
def test_a_cloud_that_shows_nothing_is_refused(damaged: PointCloud, message: str) -> None:
    with pytest.raises(CalibrationFailed, match=message) as caught:
        usable_points(damaged, SETTINGS)
    assert "\n" not in str(caught.value)


def test_the_radius_grows_with_the_distance() -> None:
    near = np.array([[1.0, 0.0, 0.0], [1.0, 0.01, 0.0]])
    settings = CloudFilterSettings(radius_m=0.02, radius_rad=0.02, neighbours_min=1)
    for scale in (1.0, 3.0, 10.0, 40.0):
        assert is_no_outlier(scale * near, settings).all()
        assert not is_no_outlier(scale * (near * [1.0, 6.0, 1.0]), settings).any()


def test_flying_points_are_dropped_and_surfaces_stay() -> None:
    rng = np.random.default_rng(1)
    wall = np.stack(
        [np.full(4000, 3.0), rng.uniform(-1, 1, 4000), rng.uniform(-1, 1, 4000)], axis=1
    )
    flying = rng.uniform([1.0, -1.0, -1.0], [2.5, 1.0, 1.0], (60, 3))
    kept = is_no_outlier(np.vstack([wall, flying]), CloudFilterSettings(neighbours_min=2))
    assert kept[:4000].mean() > 0.94
    assert kept[4000:].mean() < 0.1
