"""Pixels without the distortion of their lens, against OpenCV's projection."""

import cv2
import numpy as np
import pytest

from fusion_core.lens.projection import project_points
from fusion_core.lens.undistortion import pixel_rays, straight_pixels
from fusion_core.model.sensors import CameraIntrinsics


@pytest.mark.parametrize("is_fisheye", [False, True])
def test_straight_pixels_are_those_of_the_camera_matrix(is_fisheye: bool) -> None:
    camera = CameraIntrinsics(
        width=640, height=480, fx=500.0, fy=510.0, cx=320.0, cy=240.0,
        distortion=(0.1, -0.05, 0.001, 0.002) if not is_fisheye else (0.05, 0.01, 0.0, 0.0),
        distortion_model="equidistant" if is_fisheye else "plumb_bob",
    )  # fmt: skip
    points = np.random.default_rng(0).uniform([-1, -0.8, 2], [1, 0.8, 3], (50, 3))
    project = cv2.fisheye.projectPoints if is_fisheye else cv2.projectPoints
    args = (np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    seen = project(points.reshape(-1, 1, 3), *args)[0].reshape(-1, 2)
    ideal = points[:, :2] / points[:, 2:] * [500.0, 510.0] + [320.0, 240.0]
    np.testing.assert_allclose(straight_pixels(seen.astype(np.float32), camera), ideal, atol=0.02)


def test_beyond_the_fold_there_is_no_ray() -> None:
    camera = CameraIntrinsics(
        width=640,
        height=480,
        fx=300.0,
        fy=300.0,
        cx=320.0,
        cy=240.0,
        distortion=(-0.5, 0.0, 0.0, 0.0),
    )
    # r (1 - r^2 / 2) grows up to r = sqrt(2 / 3), where it is 0.544.
    rays = pixel_rays(
        np.array([[320.0 + 0.5 * 300.0, 240.0], [320.0 + 0.6 * 300.0, 240.0]]), camera
    )
    assert np.isfinite(rays[0]).all()
    assert np.isnan(rays[1]).all()
    np.testing.assert_allclose(project_points(rays[:1], camera), [[470.0, 240.0]])
