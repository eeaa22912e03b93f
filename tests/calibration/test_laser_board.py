"""A LiDAR and a camera with a board: against poses that are known.

The views are made by geometry alone: corners by the camera's formula, ranges by meeting a
rectangle.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion_core.calibration.board.board_pose import fit_plane_pose
from fusion_core.calibration.board.laser_board import (
    BoardView,
    LaserBoardSettings,
    calibrate_laser_board,
)
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.extrinsics import POSE_PARAMETERS
from fusion_core.model.geometry import invert_transform, make_transform
from tests.calibration.boards import BOARD, PINHOLE, opencv_projection

ANGLES = np.radians(np.arange(-120.0, 120.0, 0.5))
QUICK = LaserBoardSettings(draws=1000)
LEVEL = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
TRUTH = make_transform(
    Rotation.from_euler("xyz", [-8.0, 4.0, 2.0], degrees=True).as_matrix() @ LEVEL,
    np.array([0.05, 0.2, -0.03]),
)
GUESS = apply_pose_error(TRUTH, np.array([0.02, -0.02, 0.02, 0.04, -0.04, 0.03]))


def ranges_of(T_lidar_board, sigma_m, rng):
    """A round room of 4 m, a fixed wall of 70 cm, and the board."""
    rays = np.stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros(ANGLES.size)], axis=1)
    ranges = np.full(ANGLES.size, 4.0)
    wall = 2.5 / rays[:, 0]
    ranges = np.where((rays[:, 0] > 0) & (np.abs(wall * rays[:, 1] - 1.4) < 0.35), wall, ranges)
    normal = T_lidar_board[:3, 2]
    distance = (normal @ T_lidar_board[:3, 3]) / (rays @ normal)
    on_board = (rays * distance[:, None] - T_lidar_board[:3, 3]) @ T_lidar_board[:3, :3]
    low, high = np.array([-0.1, -0.1]) - 0.03, np.array([0.7, 0.5]) + 0.03
    hit = (
        (distance > 0) & (on_board[:, :2] > low).all(axis=1) & (on_board[:, :2] < high).all(axis=1)
    )
    ranges = np.where(hit & (distance < ranges), distance, ranges)
    return ranges + rng.normal(0.0, sigma_m, ranges.size)


def make_views(seed, count=20, sigma_m=0.005, sigma_px=0.1, tilt_deg=(40.0, 40.0, 30.0)):
    rng = np.random.default_rng(seed)
    views = []
    while len(views) < count:
        angles = rng.uniform(-1.0, 1.0, 3) * tilt_deg
        rotation = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
        middle = np.array([*rng.uniform(-0.25, 0.25, 2), 1.0]) * rng.uniform(0.9, 1.7)
        middle[1] += 0.15
        T_camera_board = make_transform(rotation, middle - rotation @ np.array([0.3, 0.2, 0.0]))
        corners = opencv_projection(BOARD.points_m(), T_camera_board, PINHOLE)
        if (corners < 5).any() or (corners > (634, 474)).any():
            continue
        T_lidar_board = invert_transform(TRUTH) @ T_camera_board
        noisy = corners + rng.normal(0.0, sigma_px, corners.shape)
        pose = fit_plane_pose(BOARD.points_m(), noisy, PINHOLE)
        ranges = ranges_of(T_lidar_board, sigma_m, rng)
        views.append(BoardView(pose=pose, ranges_m=ranges, angles_rad=ANGLES))
    return views


@pytest.fixture(scope="module")
def views():
    return make_views(1)


@pytest.fixture(scope="module")
def found(views):
    return calibrate_laser_board(views, BOARD, QUICK)


def test_the_pose_is_found_without_a_guess(found):
    error = pose_error(TRUTH, found.estimate.T_camera_lidar)
    assert (np.abs(error) < 4.0 * np.array(found.estimate.sd)).all()
    assert np.degrees(np.linalg.norm(error[:3])) < 0.6
    assert np.linalg.norm(error[3:]) < 0.02
    assert found.estimate.basin == 1.0
    assert found.estimate.unobservable == ()


def test_without_noise_it_is_exact():
    exact = calibrate_laser_board(make_views(2, sigma_m=0.0, sigma_px=0.0), BOARD, QUICK)
    assert np.abs(pose_error(TRUTH, exact.estimate.T_camera_lidar)).max() < 1e-5


def test_the_order_of_the_views_does_not_matter(views, found):
    other = calibrate_laser_board(views[::-1], BOARD, QUICK)
    difference = pose_error(found.estimate.T_camera_lidar, other.estimate.T_camera_lidar)
    assert np.abs(difference).max() < 1e-6


def test_held_out_distances_are_larger_than_used_ones(found):
    assert 0.0005 < found.distance_rms_used_m < found.distance_rms_m < 0.01


@pytest.mark.slow
def test_the_covariance_is_honest():
    squares = []
    for seed in range(30):
        estimate = calibrate_laser_board(make_views(seed), BOARD, QUICK).estimate
        error = pose_error(TRUTH, estimate.T_camera_lidar)
        squares.append(error @ np.linalg.solve(estimate.covariance, error))
    assert 4.0 < np.mean(squares) < 9.0


def test_a_guess_is_improved(views):
    estimate = calibrate_laser_board(views, BOARD, QUICK, T_guess=GUESS).estimate
    assert estimate.improved
    error = pose_error(TRUTH, estimate.T_camera_lidar)
    assert np.linalg.norm(error) < 0.2 * np.linalg.norm(pose_error(TRUTH, GUESS))


def test_a_guess_that_agrees_better_is_kept():
    few = make_views(3, count=8, sigma_m=0.01)
    estimate = calibrate_laser_board(few, BOARD, QUICK, T_guess=TRUTH).estimate
    assert not estimate.improved
    np.testing.assert_array_equal(estimate.T_camera_lidar, TRUTH)
    assert estimate.verdict.startswith("The guess is kept")


def test_boards_that_only_turn_upright_leave_parameters_open():
    # All normals lie in one plane: moving the LiDAR along the upright changes nothing.
    upright = make_views(4, tilt_deg=(0.0, 40.0, 0.0))
    with pytest.raises(
        CalibrationFailed, match=r"leave the pose open: it is turned about one axis"
    ):
        calibrate_laser_board(upright, BOARD, QUICK)
    estimate = calibrate_laser_board(upright, BOARD, QUICK, T_guess=GUESS).estimate
    assert "y_m" in estimate.unobservable
    kept = [name in estimate.unobservable for name in POSE_PARAMETERS]
    difference = pose_error(estimate.T_camera_lidar, GUESS)
    np.testing.assert_allclose(difference[kept], 0.0, atol=1e-9)


def test_few_places_are_refused(views):
    with pytest.raises(CalibrationFailed, match="seen at 3 places, at least 5"):
        calibrate_laser_board(views[:3], BOARD, QUICK)


def test_a_lidar_that_does_not_see_the_board_is_refused(views):
    blind = [
        BoardView(pose=view.pose, ranges_m=np.full(ANGLES.size, 4.0), angles_rad=ANGLES)
        for view in views
    ]
    with pytest.raises(CalibrationFailed, match="do not agree with the board at 5 of 20 places"):
        calibrate_laser_board(blind, BOARD, QUICK)


def test_an_offset_of_the_ranges_is_within_the_deviations(views, found):
    longer = [
        BoardView(pose=view.pose, ranges_m=view.ranges_m + 0.005, angles_rad=ANGLES)
        for view in views
    ]
    moved = calibrate_laser_board(longer, BOARD, QUICK).estimate
    difference = pose_error(found.estimate.T_camera_lidar, moved.T_camera_lidar)
    sd = np.array(found.estimate.sd)
    assert 0.7 < np.abs(difference / sd).max() < 1.3
    without = QUICK.model_copy(update={"range_offset_sd_m": 0.0})
    sure = np.array(calibrate_laser_board(views, BOARD, without).estimate.sd)
    assert (sure <= sd).all()
    assert np.abs(difference / sure).max() > 1.5
