"""Intrinsics: against those that drew the corners, by formulas written out beside the tests."""

import numpy as np
import pytest

from fusion_core.calibration.board.intrinsics import IntrinsicsSettings, estimate_intrinsics
from fusion_core.lens.projection import project_points
from fusion_core.lens.undistortion import undistort_pixels
from fusion_core.model.errors import CalibrationFailed
from tests.calibration.boards import BOARD, FISHEYE, PINHOLE, corner_sets, opencv_projection

SHAPE = (480, 640)
CAMERAS = [("pinhole", PINHOLE), ("fisheye", FISHEYE)]


def true_values(camera, count):
    values = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
    return np.array([*values, 0.0][:count])


@pytest.mark.parametrize(("model", "camera"), CAMERAS)
def test_without_noise_the_camera_is_found(model, camera):
    corners = corner_sets(camera, 1, sigma_px=0.0)
    found = estimate_intrinsics(BOARD, corners, SHAPE, IntrinsicsSettings(model=model))
    true = true_values(camera, found.values.size)
    assert np.abs(found.values[:4] - true[:4]).max() < 0.02
    assert np.abs(found.values[4:] - true[4:]).max() < 1e-3
    assert found.rms_held_out_px < 1e-3


@pytest.mark.parametrize(("model", "camera"), CAMERAS)
def test_deviations_are_as_large_as_the_errors(model, camera):
    ratios = []
    for seed in range(3):
        corners = corner_sets(camera, seed, count=10)
        found = estimate_intrinsics(BOARD, corners, SHAPE, IntrinsicsSettings(model=model))
        ratios.append((found.values - true_values(camera, found.values.size))[:4] / found.sd[:4])
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 2.0


def test_the_errors_are_those_of_the_noise():
    found = estimate_intrinsics(BOARD, corner_sets(PINHOLE, 5), SHAPE)
    # 0.1 px in each of u and v.
    assert found.rms_used_px == pytest.approx(0.1 * np.sqrt(2.0), rel=0.15)
    assert found.rms_held_out_px > found.rms_used_px


def test_an_image_with_a_wrong_corner_is_left_out_and_named():
    corners = corner_sets(PINHOLE, 2)
    corners[3] = corners[3] + np.random.default_rng(0).normal(0.0, 4.0, corners[3].shape)
    found = estimate_intrinsics(BOARD, corners, SHAPE)
    assert np.flatnonzero(found.outliers).tolist() == [3]
    assert any("image 4 is left out" in note for note in found.notes)
    assert found.residuals_px[3] is None
    assert abs(found.intrinsics.fx - PINHOLE.fx) < 4.0 * found.sd[0]


def test_an_image_without_a_board_is_named():
    found = estimate_intrinsics(BOARD, [None, *corner_sets(PINHOLE, 2)], SHAPE)
    assert "image 1: the board is not found" in found.notes
    assert np.isnan(found.image_rms_px[0])


def test_the_order_of_the_images_does_not_matter():
    corners = corner_sets(PINHOLE, 4)
    one = estimate_intrinsics(BOARD, corners, SHAPE)
    other = estimate_intrinsics(BOARD, corners[::-1], SHAPE)
    np.testing.assert_allclose(one.values, other.values, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(one.sd, other.sd, rtol=1e-2)


def test_too_few_boards_are_refused():
    with pytest.raises(CalibrationFailed, match="2 of 3 images, at least 3"):
        estimate_intrinsics(BOARD, [None, *corner_sets(PINHOLE, 1, count=2)], SHAPE)


def test_parallel_boards_are_refused():
    corners = corner_sets(PINHOLE, 1, tilt_deg=0.5, sigma_px=0.02)
    with pytest.raises(CalibrationFailed, match=r"parallel|do not determine the focal length"):
        estimate_intrinsics(BOARD, corners, SHAPE)


@pytest.mark.parametrize(("model", "camera"), CAMERAS)
def test_projection_and_its_inverse_agree_with_the_formulas(model, camera):
    rays = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    points = np.column_stack([rays, np.ones(50)]) * 2.0
    pixels = project_points(points, camera)
    np.testing.assert_allclose(pixels, opencv_projection(points, np.eye(4), camera), atol=1e-9)
    np.testing.assert_allclose(undistort_pixels(pixels, camera), rays, atol=1e-7)
