"""Colours of points, against a loop over pixels and against walls that hide each other."""

import cv2
import numpy as np
import pytest

from fusion_core.calibration.coloring import ColoringSettings, color_points
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import make_transform
from fusion_core.model.sensors import CameraIntrinsics

CAMERA = CameraIntrinsics(
    width=320,
    height=240,
    fx=300.0,
    fy=305.0,
    cx=158.0,
    cy=121.0,
    distortion=(-0.1, 0.02, 0.001, -0.002, 0.0),
)
# LiDAR x ahead, y left, z up; the camera 10 cm below it and 5 cm to its left.
T_CAMERA_LIDAR = make_transform(
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.array([-0.05, 0.1, 0.02])
)
# Each pixel has a colour of its own.
V, U = np.mgrid[0:240, 0:320]
IMAGE = np.stack([U // 2, V, (U % 2) * 255], axis=-1).astype(np.uint8)


def wall(x_m: float, half_m: float, step_m: float) -> np.ndarray:
    y, z = np.meshgrid(*[np.arange(-half_m, half_m, step_m)] * 2)
    return np.column_stack([np.full(y.size, x_m), y.ravel(), z.ravel()])


def test_a_wall_has_the_colours_of_its_pixels() -> None:
    points = wall(3.0, 3.0, 0.05)
    rgb, seen = color_points(points, IMAGE, CAMERA, T_CAMERA_LIDAR)
    rotation, _ = cv2.Rodrigues(T_CAMERA_LIDAR[:3, :3])
    pixels, _ = cv2.projectPoints(
        points,
        rotation,
        T_CAMERA_LIDAR[:3, 3],
        CAMERA.matrix,
        np.array(CAMERA.distortion),
    )
    for (u, v), color, is_seen in zip(pixels.reshape(-1, 2), rgb, seen, strict=True):
        inside = -0.5 < u < 319.5 and -0.5 < v < 239.5
        assert is_seen == inside
        assert np.array_equal(color, IMAGE[round(v), round(u)] if inside else (0, 0, 0))
    assert 0.2 < seen.mean() < 0.8


def test_what_is_hidden_has_no_colour() -> None:
    near, far = wall(2.0, 0.3, 0.01), wall(4.0, 1.5, 0.02)
    behind = wall(-3.0, 1.0, 0.1)
    _, seen = color_points(np.concatenate([near, far, behind]), IMAGE, CAMERA, T_CAMERA_LIDAR)
    near_seen, far_seen, behind_seen = np.split(seen, [len(near), len(near) + len(far)])
    assert near_seen.all()
    assert not behind_seen.any()
    # The near wall's shadow, seen from the camera 5 cm left of the LiDAR and 10 cm below it.
    eye = -T_CAMERA_LIDAR[:3, :3].T @ T_CAMERA_LIDAR[:3, 3]
    crossing = eye + (far - eye) * ((2.0 - eye[0]) / (far[:, :1] - eye[0]))
    outside_m = np.abs(crossing[:, 1:]).max(axis=1) - 0.3
    # One cell of 0.4 degrees is 1.4 cm at 2 m, on either side of the edge.
    assert not far_seen[outside_m < -0.02].any()
    in_view = color_points(far, IMAGE, CAMERA, T_CAMERA_LIDAR)[1]
    assert far_seen[in_view & (outside_m > 0.02)].all()
    _, all_seen = color_points(
        np.concatenate([near, far]),
        IMAGE,
        CAMERA,
        T_CAMERA_LIDAR,
        ColoringSettings(depth_tolerance=5.0),
    )
    assert np.array_equal(all_seen[len(near) :], in_view)


def test_a_floor_does_not_hide_itself() -> None:
    x, y = np.meshgrid(np.arange(2.0, 8.0, 0.02), np.arange(-0.5, 0.5, 0.02))
    floor = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -0.6)])
    _, seen = color_points(floor, IMAGE, CAMERA, T_CAMERA_LIDAR)
    assert seen.all()


def test_points_without_a_position_and_empty_clouds() -> None:
    points = np.array([[3.0, 0.0, 0.0], [np.nan] * 3, [np.inf, 0.0, 0.0]])
    rgb, seen = color_points(points, IMAGE, CAMERA, T_CAMERA_LIDAR)
    assert seen.tolist() == [True, False, False]
    assert not rgb[1:].any()
    rgb, seen = color_points(np.empty((0, 3)), IMAGE, CAMERA, T_CAMERA_LIDAR)
    assert rgb.shape == (0, 3)
    assert seen.shape == (0,)


def test_an_image_of_another_size_is_refused() -> None:
    with pytest.raises(CalibrationFailed, match="160 x 120 pixels, the intrinsics are for 320 x"):
        color_points(np.ones((1, 3)), IMAGE[::2, ::2], CAMERA, T_CAMERA_LIDAR)
