"""Derivatives by an error of a pose: against differences of the functions themselves."""

import numpy as np
import pytest

from fusion_core.calibration.board.laser_pixel_noise import Pairs
from fusion_core.calibration.board.laser_planes import LaserPlanes
from fusion_core.calibration.board.pose_minimiser import minimise_pose
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from tests.calibration.boards import FISHEYE, PINHOLE
from tests.calibration.test_laser_board import TRUTH, make_views
from tests.calibration.test_laser_pixels import make_pairs

STEP = 1e-6


def by_differences(function, T):
    columns = []
    for axis in range(6):
        error = np.zeros(6)
        error[axis] = STEP
        ahead = function(apply_pose_error(T, error))
        columns.append((ahead - function(apply_pose_error(T, -error))) / (2.0 * STEP))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
def test_pixels_by_the_pose_and_by_the_laser_point(camera):
    T, points, pixels = make_pairs(1, camera, count=10)
    pairs = Pairs(np.column_stack([points, np.zeros(10)]), pixels, camera)
    by_pose, by_laser = pairs.jacobians(T)
    np.testing.assert_allclose(by_pose, -by_differences(pairs.residuals_px, T), atol=1e-3)
    moved = Pairs(pairs.points_m + np.array([STEP, 0.0, 0.0]), pixels, camera)
    along_x = (pairs.residuals_px(T) - moved.residuals_px(T)) / STEP
    np.testing.assert_allclose(by_laser[:, :, 0], along_x, atol=1e-1)


def test_distances_by_the_pose_and_by_an_offset_of_the_ranges():
    poses = [view.pose for view in make_views(1, count=4)]
    rng = np.random.default_rng(0)
    ends = np.concatenate([rng.uniform(0.5, 2.0, (4, 2, 2)), np.zeros((4, 2, 1))], axis=2)
    planes = LaserPlanes(
        ends_m=ends,
        across=np.tile([0.0, 1.0, 0.0], (4, 1)),
        line_sd_m=np.full(4, 0.01),
        T_camera_board=np.array([pose.T_camera_plane for pose in poses]),
        board_covariance=np.array([pose.covariance for pose in poses]),
    )
    expected = by_differences(planes.distances, TRUTH)
    np.testing.assert_allclose(planes.distance_jacobian(TRUTH), expected, atol=1e-6)
    longer = ends * (1.0 + STEP / np.linalg.norm(ends, axis=2, keepdims=True))
    moved = LaserPlanes(
        longer, planes.across, planes.line_sd_m, planes.T_camera_board, planes.board_covariance
    )
    by_offset = (moved.distances(TRUTH) - planes.distances(TRUTH)) / STEP
    np.testing.assert_allclose(planes.offset_jacobian(TRUTH), by_offset, atol=1e-6)


def test_held_parameters_keep_their_value_and_the_others_are_found():
    rng = np.random.default_rng(3)
    points = rng.uniform(-1.0, 1.0, (20, 3))
    held = np.array([True, False, True, False, True, True])
    wanted = np.array([0.3, 0.0, -0.4, 0.0, 0.2, -0.1])
    T_start = apply_pose_error(TRUTH, rng.uniform(-0.2, 0.2, 6))
    T_true = apply_pose_error(T_start, wanted)
    there = points @ T_true[:3, :3].T + T_true[:3, 3]

    def evaluate(T):
        def residuals(T):
            return (points @ T[:3, :3].T + T[:3, 3] - there).ravel()

        return residuals(T), by_differences(residuals, T)

    found = pose_error(minimise_pose(evaluate, T_start, T_start, held), T_start)
    np.testing.assert_allclose(found, wanted, atol=1e-7)
