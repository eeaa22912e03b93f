"""Visual SLAM's trajectory as a LiDAR's motion: poses and covariances."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
    transform_from_planar,
)
from fusion_core.model.planar_poses import relative_pose
from fusion_core.slam.visual.image_trajectory import LostStretch
from fusion_core.slam.visual.planar_motion import PlanarMotionSettings, planar_motion
from fusion_core.slam.visual.visual_map import VisualMap
from fusion_core.slam.visual.visual_slam import VisualSlamResult

COUNT = 6
STAMPS_NS = np.arange(COUNT, dtype=np.int64) * 100_000_000
T_LIDAR_CAMERA = make_transform(
    rotation_from_yaw_pitch_roll(0.1, 0.35, 0.02) @ R_BODY_OPTICAL, np.array([0.1, 0.17, -0.02])
)
POSES = np.stack(
    [0.05 * np.arange(COUNT), 0.01 * np.arange(COUNT) ** 2, 0.1 * np.arange(COUNT)], axis=1
)


def result(lost=()):
    """The camera of a LiDAR that drives along POSES."""
    rng = np.random.default_rng(7)
    T_first_camera = np.stack(
        [
            invert_transform(T_LIDAR_CAMERA) @ transform_from_planar(pose) @ T_LIDAR_CAMERA
            for pose in POSES
        ]
    )
    roots = rng.normal(0.0, 30.0, (COUNT, 8, 6))
    information = np.einsum("nki,nkj->nij", roots, roots)
    information[0] = np.nan
    is_tracked = ~np.isin(np.arange(COUNT), lost)
    information[~is_tracked] = T_first_camera[~is_tracked] = np.nan
    return VisualSlamResult(
        stamps_ns=STAMPS_NS,
        T_map_camera=T_first_camera,
        is_tracked=is_tracked,
        references=np.where(is_tracked, np.array([0, 0, 0, 1, 1, 2]), -1),
        information=information,
        visual_map=VisualMap(),
        lost=tuple(
            LostStretch(first=k, last=k, first_stamp_ns=0, last_stamp_ns=0, reason="dark")
            for k in lost
        ),
        jumps=(),
        doubtful=(),
        refused_loops=(),
        seconds={},
    )


def test_the_lidar_drives_as_it_did():
    track = planar_motion(result(), T_LIDAR_CAMERA, PlanarMotionSettings())
    np.testing.assert_allclose(track.poses_odom_lidar, POSES, atol=1e-12)
    assert track.measured.all()
    assert track.scale_sigma == PlanarMotionSettings().depth_scale_sigma


def test_the_covariance_is_that_of_differences():
    """Of the LiDAR's small motion: what it does to T_camera_map, by finite differences."""
    found = result()
    track = planar_motion(found, T_LIDAR_CAMERA, PlanarMotionSettings())

    def covariance(image):
        T_camera_map = invert_transform(found.T_map_camera[image])
        columns = []
        for axis in range(3):
            moved = np.zeros(3)
            moved[axis] = 1e-6
            T_map_moved = (
                found.T_map_camera[image]
                @ invert_transform(T_LIDAR_CAMERA)
                @ transform_from_planar(moved)
                @ T_LIDAR_CAMERA
            )
            away = invert_transform(T_map_moved) @ invert_transform(T_camera_map)
            turn = Rotation.from_matrix(away[:3, :3]).as_rotvec()
            columns.append(np.concatenate([turn, away[:3, 3]]) / 1e-6)
        J = np.stack(columns, axis=1)
        return np.linalg.inv(J.T @ found.information[image] @ J)

    yaw = POSES[2, 2] - POSES[1, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    expected = covariance(1) + R @ covariance(2) @ R.T
    np.testing.assert_allclose(track.step_covariance[1], expected, rtol=1e-4)
    # The image that begins the map is its origin.
    yaw = POSES[1, 2]
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(track.step_covariance[0], R @ covariance(1) @ R.T, rtol=1e-4)


def test_what_is_lost_is_not_measured():
    track = planar_motion(result(lost=(3,)), T_LIDAR_CAMERA, PlanarMotionSettings())
    assert track.measured.tolist() == [True, True, False, False, True]
    np.testing.assert_allclose(
        relative_pose(track.poses_odom_lidar[4], track.poses_odom_lidar[5]),
        relative_pose(POSES[4], POSES[5]),
        atol=1e-12,
    )
    assert any("1 dark" in note for note in track.notes)


def test_no_image_is_no_motion():
    with pytest.raises(Exception, match="placed no image"):
        planar_motion(result(lost=tuple(range(COUNT))), T_LIDAR_CAMERA, PlanarMotionSettings())
