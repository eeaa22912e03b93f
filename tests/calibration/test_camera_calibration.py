"""A small room from end to end: cloud and image to extrinsics with evidence."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fusion_core.calibration.features.camera_calibration import (
    PUBLISHED,
    CameraCalibration,
    FeatureCalibrationSettings,
    calibrate_by_features,
)
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.sensors import PointCloud
from fusion_core.simulation.turning_rig import TurningRigSettings, simulate_turning_rig
from tests.calibration.textured_room import Scene, small_scene

SETTINGS = FeatureCalibrationSettings()


@pytest.fixture(scope="module")
def scene() -> Scene:
    return small_scene()


@pytest.fixture(scope="module")
def calibration(scene: Scene) -> CameraCalibration:
    return calibrate_by_features(scene.cloud, scene.grey, scene.camera, SETTINGS)


def test_the_pose_is_found_without_a_guess(scene: Scene, calibration: CameraCalibration) -> None:
    error = pose_error(scene.T_camera_lidar, calibration.estimate.T_camera_lidar)
    # A quarter of the pixels that Song's camera has.
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.1
    assert np.linalg.norm(error[3:]) < 0.01
    nees = error @ np.linalg.solve(calibration.estimate.covariance, error)
    assert nees < 25.0
    assert calibration.estimate.reprojection_rms_px < 1.0


def test_the_evidence_belongs_to_the_estimate(scene: Scene, calibration: CameraCalibration) -> None:
    pairs = calibration.pairs
    assert pairs.accepted.sum() > 50
    assert {"", "correlation"} <= set(pairs.reasons)
    assert calibration.features.reasons.count("RANSAC") > 0
    height, width = calibration.image.picture.shape
    assert (pairs.intensity_px >= 0).all()
    assert (pairs.intensity_px < (width, height)).all()
    assert len(calibration.held_out_px) >= pairs.accepted.sum()
    assert calibration.curve.pairs[-1] == len(calibration.held_out_px)
    assert calibration.image.pixel_size == calibration.pixel_sizes.chosen


def test_the_same_input_gives_the_same_bytes(scene: Scene, calibration: CameraCalibration) -> None:
    again = calibrate_by_features(scene.cloud, scene.grey, scene.camera, SETTINGS)
    assert again.estimate.T_camera_lidar.tobytes() == calibration.estimate.T_camera_lidar.tobytes()
    assert again.estimate.covariance.tobytes() == calibration.estimate.covariance.tobytes()


def test_points_without_a_position_change_nothing(
    scene: Scene, calibration: CameraCalibration
) -> None:
    lost = np.full((1000, 3), np.nan, np.float32)
    lost[500:] = np.inf
    xyz = np.concatenate([scene.cloud.xyz_m, lost])
    intensity = np.concatenate([scene.cloud.intensity, np.ones(1000, np.float32)])
    damaged = replace(scene.cloud, xyz_m=xyz, intensity=intensity)
    found = calibrate_by_features(damaged, scene.grey, scene.camera, SETTINGS)
    np.testing.assert_array_equal(
        found.estimate.T_camera_lidar, calibration.estimate.T_camera_lidar
    )


def test_a_wrong_guess_is_replaced(scene: Scene) -> None:
    guess = apply_pose_error(scene.T_camera_lidar, np.array([0.02, -0.02, 0.01, 0.05, -0.05, 0.05]))
    found = calibrate_by_features(
        scene.cloud, scene.grey, scene.camera, SETTINGS, T_guess=guess, near_guess=True
    )
    assert found.estimate.improved
    np.testing.assert_array_equal(found.estimate.T_guess, guess)
    error = pose_error(scene.T_camera_lidar, found.estimate.T_camera_lidar)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.1


def test_the_true_guess_is_kept(scene: Scene) -> None:
    found = calibrate_by_features(
        scene.cloud, scene.grey, scene.camera, SETTINGS, T_guess=scene.T_camera_lidar
    )
    assert not found.estimate.improved
    np.testing.assert_array_equal(found.estimate.T_camera_lidar, scene.T_camera_lidar)


@pytest.mark.slow
def test_the_simulated_rig_by_either_preset() -> None:
    data = simulate_turning_rig(TurningRigSettings(), 2)
    points_m, intensity = data.cloud_in_rig()
    cloud = PointCloud(
        stamp_ns=0,
        received_ns=None,
        frame_id="rig",
        xyz_m=points_m.astype(np.float32),
        intensity=intensity.astype(np.float32),
    )
    grey = np.asarray(cv2.cvtColor(data.rgb, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    found = calibrate_by_features(cloud, grey, data.intrinsics, SETTINGS)
    error = pose_error(data.T_camera_lidar, found.estimate.T_camera_lidar)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.1
    assert np.linalg.norm(error[3:]) < 0.01
    assert found.estimate.reprojection_rms_px < 1.0
    published = calibrate_by_features(cloud, grey, data.intrinsics, PUBLISHED)
    assert published.image is published.feature_image
    assert "pixel fraction" in published.features.reasons
    # The paper's own pairs have 2.3 px.
    assert 1.0 < published.estimate.reprojection_rms_used_px < 6.0
    assert any("projection matrix M" in note for note in published.estimate.notes)


def refused(cloud: PointCloud, scene: Scene, message: str, grey: np.ndarray | None = None) -> None:
    with pytest.raises(CalibrationFailed, match=message) as caught:
        calibrate_by_features(cloud, scene.grey if grey is None else grey, scene.camera, SETTINGS)
    assert "\n" not in str(caught.value)


def test_an_image_of_another_size_is_refused(scene: Scene) -> None:
    half = np.asarray(cv2.resize(scene.grey, (256, 192)), dtype=np.uint8)
    refused(scene.cloud, scene, "the image has 256 x 192 .* of 512 x 384", half)


@pytest.mark.slow
def test_an_image_of_another_place_is_refused_with_the_number_of_pairs(scene: Scene) -> None:
    mirrored = np.ascontiguousarray(scene.grey[:, ::-1])
    refused(scene.cloud, scene, r"only \d+ features .* at least 12", mirrored)


def test_an_image_without_texture_is_refused(scene: Scene) -> None:
    refused(scene.cloud, scene, "image has only 0 features", np.full_like(scene.grey, 90))


def test_one_wall_alone_is_refused(scene: Scene) -> None:
    # The far wall of the room, before which furniture stands.
    xyz = scene.cloud.xyz_m
    wall = np.abs(xyz[:, 0] - 3.4) < 0.06
    flat = replace(scene.cloud, xyz_m=xyz[wall], intensity=scene.cloud.intensity[wall])
    refused(flat, scene, "lie in one plane: their singular values are")
