"""Laser points with their pixels: against poses that are known, by formulas written out."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion_core.calibration.board.laser_pixels import (
    LaserPixelSettings,
    calibrate_laser_pixels,
)
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.extrinsics import POSE_PARAMETERS
from fusion_core.model.geometry import make_transform
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics
from fusion_core.recordings.laser_pixel_file import read_laser_pixels
from tests.calibration.boards import FISHEYE, PINHOLE, opencv_projection

FEW_STARTS = LaserPixelSettings(starts=5)


def true_pose(rng):
    """(4, 4) T_camera_lidar of a camera some 30 cm above the LiDAR that looks the same way."""
    level = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    turn = Rotation.from_euler("xyz", rng.uniform(-15.0, 15.0, 3), degrees=True).as_matrix()
    return make_transform(turn @ level, np.array([*rng.uniform(-0.1, 0.1, 1), 0.35, 0.05]))


def make_pairs(seed, camera=PINHOLE, count=40, sigma_px=0.0, sigma_m=0.0):
    rng = np.random.default_rng(seed)
    T = true_pose(rng)
    points, pixels = [], []
    while len(points) < count:
        azimuth, distance = rng.uniform(-0.6, 0.6), rng.uniform(0.7, 4.0)
        point = distance * np.array([np.cos(azimuth), np.sin(azimuth)])
        pixel = opencv_projection(np.array([[*point, 0.0]]), T, camera)[0]
        if (pixel > 0).all() and (pixel < (camera.width - 1, camera.height - 1)).all():
            points.append(point + rng.normal(0.0, sigma_m, 2))
            pixels.append(pixel + rng.normal(0.0, sigma_px, 2))
    return T, np.array(points), np.clip(np.array(pixels), 0.0, (639.0, 479.0))


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
@pytest.mark.parametrize("seed", range(3))
def test_without_noise_the_pose_is_exact(seed, camera):
    T, points, pixels = make_pairs(seed, camera)
    found = calibrate_laser_pixels(points, pixels, camera, FEW_STARTS)
    assert np.abs(pose_error(T, found.estimate.T_camera_lidar)).max() < 1e-6
    assert found.estimate.reprojection_rms_px < 1e-4


def test_outliers_do_not_move_the_pose_and_are_named():
    T, points, pixels = make_pairs(1, sigma_px=0.3)
    clean = calibrate_laser_pixels(points, pixels, PINHOLE).estimate
    pixels[:5] = pixels[:5][::-1] + np.array([60.0, -25.0])
    found = calibrate_laser_pixels(points, np.clip(pixels, 0, (639, 479)), PINHOLE).estimate
    assert np.abs(pose_error(T, found.T_camera_lidar)).max() < 4.0 * max(clean.sd)
    named = next(note for note in found.notes if "far off" in note)
    assert {"1", "2", "4", "5"} <= set(named.replace(",", "").split())


def test_held_out_and_used_errors_are_those_of_the_noise():
    _, points, pixels = make_pairs(2, count=200, sigma_px=0.5)
    estimate = calibrate_laser_pixels(points, pixels, PINHOLE, FEW_STARTS).estimate
    assert estimate.reprojection_rms_used_px == pytest.approx(0.5 * np.sqrt(2.0), rel=0.1)
    assert estimate.reprojection_rms_used_px < estimate.reprojection_rms_px < 0.8


def test_noise_of_the_laser_is_told_from_that_of_the_pixels():
    _, points, pixels = make_pairs(3, count=400, sigma_px=0.5, sigma_m=0.02)
    noise = calibrate_laser_pixels(points, pixels, PINHOLE, FEW_STARTS).noise
    assert noise.pixel_px == pytest.approx(0.5, rel=0.35)
    assert noise.laser_m == pytest.approx(0.02, rel=0.2)


@pytest.mark.slow
def test_the_covariance_is_honest():
    squares = []
    for seed in range(40):
        T, points, pixels = make_pairs(seed, sigma_px=0.5, sigma_m=0.01)
        estimate = calibrate_laser_pixels(points, pixels, PINHOLE, FEW_STARTS).estimate
        error = pose_error(T, estimate.T_camera_lidar)
        squares.append(error @ np.linalg.solve(estimate.covariance, error))
    assert 4.5 < np.mean(squares) < 8.5


def test_a_guess_that_is_better_is_kept():
    T, points, pixels = make_pairs(4, count=12, sigma_px=1.0)
    found = calibrate_laser_pixels(points, pixels, PINHOLE, FEW_STARTS, T_guess=T)
    assert not found.estimate.improved
    np.testing.assert_array_equal(found.estimate.T_camera_lidar, T)
    assert found.estimate.verdict.startswith("The guess is kept")
    assert found.estimate.reprojection_rms_px == pytest.approx(reprojection_rms(found.guess_px))


def test_a_worse_guess_is_improved():
    T, points, pixels = make_pairs(4, sigma_px=0.5)
    guess = apply_pose_error(T, np.array([0.03, -0.02, 0.03, 0.05, -0.05, 0.05]))
    found = calibrate_laser_pixels(points, pixels, PINHOLE, FEW_STARTS, T_guess=guess)
    assert found.estimate.improved
    error = pose_error(T, found.estimate.T_camera_lidar)
    assert np.linalg.norm(error) < 0.3 * np.linalg.norm(pose_error(T, guess))


def on_one_line(seed):
    T, points, _ = make_pairs(seed)
    points[:, 0] = 2.0
    pixels = opencv_projection(np.column_stack([points, np.zeros(len(points))]), T, PINHOLE)
    seen = ((pixels > 0) & (pixels < (639, 479))).all(axis=1)
    noise = np.random.default_rng(seed).normal(0.0, 0.3, pixels.shape)
    return T, points[seen], np.clip(pixels + noise, 0, (639, 479))[seen]


@pytest.mark.parametrize("sd_m", [0.0, 0.001, 0.01, 0.02])
def test_points_on_one_line_are_refused_without_a_guess(sd_m):
    _, points, pixels = on_one_line(5)
    points += np.random.default_rng(5).normal(0.0, sd_m, points.shape)
    with pytest.raises(CalibrationFailed, match="one line"):
        calibrate_laser_pixels(points, pixels, PINHOLE)


def test_one_point_many_times_is_refused():
    _, points, pixels = make_pairs(5)
    with pytest.raises(CalibrationFailed, match="one line"):
        calibrate_laser_pixels(0.0 * points + points[0], 0.0 * pixels + pixels[0], PINHOLE)


@pytest.mark.parametrize("sd_m", [0.0, 0.01])
def test_points_on_one_line_keep_what_the_guess_says_of_the_rest(sd_m):
    T, points, pixels = on_one_line(5)
    points += np.random.default_rng(5).normal(0.0, sd_m, points.shape)
    error = np.array([0.004, 0.003, -0.004, 0.01, 0.01, -0.01])
    guess = apply_pose_error(T, error)
    estimate = calibrate_laser_pixels(points, pixels, PINHOLE, T_guess=guess).estimate
    assert estimate.unobservable
    kept = [name in estimate.unobservable for name in POSE_PARAMETERS]
    np.testing.assert_allclose(pose_error(estimate.T_camera_lidar, guess)[kept], 0.0, atol=1e-9)
    assert "Not observable" in estimate.verdict


def test_too_few_pairs_are_refused():
    _, points, pixels = make_pairs(0, count=5)
    with pytest.raises(CalibrationFailed, match="5 pairs do not determine a pose, at least 6"):
        calibrate_laser_pixels(points, pixels, PINHOLE)


def test_millimetres_are_refused():
    _, points, pixels = make_pairs(0)
    with pytest.raises(CalibrationFailed, match="metres"):
        calibrate_laser_pixels(points * 1000.0, pixels, PINHOLE)


def test_pixels_outside_the_image_are_refused():
    _, points, pixels = make_pairs(0)
    pixels[3] = (1200.0, 700.0)
    with pytest.raises(CalibrationFailed, match=r"pixel \(1200, 700\) of pair 4 is outside"):
        calibrate_laser_pixels(points, pixels, PINHOLE)


@pytest.mark.data
def test_the_published_result_is_improved(data_folder):
    folder = data_folder / "real" / "calibration" / "laser_pixel_pairs"
    points, pixels = read_laser_pixels(folder / "data.txt")
    camera = read_intrinsics(folder / "config.yaml", (640, 480))
    values = np.array((folder / "calibration_result.txt").read_text().split(), float)
    published = make_transform(Rotation.from_quat(values[:4]).as_matrix(), values[4:])
    found = calibrate_laser_pixels(points, pixels, camera, T_guess=published)
    assert found.estimate.improved
    assert reprojection_rms(found.guess_px) == pytest.approx(15.09, abs=0.01)
    assert found.estimate.reprojection_rms_px < 0.6 * reprojection_rms(found.guess_px)
