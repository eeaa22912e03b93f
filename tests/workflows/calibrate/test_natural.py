"""Calibration without a board, on simulated rooms whose mount is known."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fusion_core.calibration.planar.natural_settings import NaturalSettings
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.model.errors import CalibrationFailed, MissingStream
from fusion_core.model.extrinsics import POSE_PARAMETERS
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
)
from fusion_core.recordings.formats import open_recording
from fusion_core.simulation.faults import FaultSettings
from fusion_core.simulation.recorder import record_run
from fusion_core.simulation.scenes import SceneSettings, find_scene, plan_run
from fusion_core.workflows.calibrate.natural import calibrate_without_board

QUICK = NaturalSettings(basin_starts=0, held_out_blocks=3, frames=24, patches=200)
Simulated = tuple[Path, list[np.ndarray], list[str]]


@pytest.fixture(scope="module")
def simulate(tmp_path_factory) -> Callable[..., Simulated]:
    """Writes a scene with rolled cameras: the recording, T_camera_lidar and topics."""
    folder = tmp_path_factory.mktemp("natural")

    def write(name: str, duration_s: float, roll_deg: float, published: str = "none") -> Simulated:
        path = folder / f"{name}_{roll_deg:g}_{published}.mcap"
        scene = find_scene(name)
        own = scene.settings.model_dump() | {"duration_s": duration_s, "image_scale": 0.5}
        run = plan_run(scene, SceneSettings(**own), FaultSettings())
        roll = rotation_from_yaw_pitch_roll(np.deg2rad(roll_deg), 0.0, 0.0)
        # About the camera's own axis, ahead.
        turn = make_transform(roll, np.zeros(3))
        mounts = run.simulation.mounts
        cameras = tuple(
            replace(camera, T_base_optical=camera.T_base_optical @ turn)
            for camera in mounts.cameras
        )
        mounts = replace(mounts, cameras=cameras)
        simulation = replace(run.simulation, mounts=mounts)
        record_run(replace(run, simulation=simulation, published_mounts=published), path)
        poses = [invert_transform(T) for T in mounts.T_lidar_camera()]
        return path, poses, [camera.depth_topic for camera in cameras]

    return write


@pytest.fixture(scope="module")
def rolled(simulate) -> Simulated:
    return simulate("furnished_room", 3.0, 5.0)


def place_error(T: np.ndarray, estimate: np.ndarray) -> np.ndarray:
    """Forward, left and up of the camera in the LiDAR's frame."""
    return invert_transform(T)[:3, 3] - invert_transform(estimate)[:3, 3]


def test_all_six_degrees_are_found_without_a_guess(rolled) -> None:
    path, (T,), _ = rolled
    with open_recording(path) as recording:
        found = calibrate_without_board(recording, QUICK)
        again = calibrate_without_board(recording, QUICK)
    assert np.rad2deg(np.abs(pose_error(T, found.T_camera_lidar)[:3])).max() < 0.3
    assert np.abs(place_error(T, found.T_camera_lidar)[:2]).max() < 0.03
    assert found.improved
    assert found.T_guess is None
    assert found.reprojection_rms_px is None
    # The camera's y is its height above the LiDAR, which walls do not show; rolled by 5 degrees,
    # its x has a part of it.
    assert "y_m" in found.unobservable
    assert set(found.unobservable) <= {"x_m", "y_m"}
    assert found.sd[4] is None
    assert any("Not observable: place below the camera, known" in note for note in found.notes)
    np.testing.assert_array_equal(found.T_camera_lidar, again.T_camera_lidar)
    np.testing.assert_array_equal(found.covariance, again.covariance)
    assert found.verdict == again.verdict


def test_a_measured_height_leaves_nothing_unknown(rolled) -> None:
    path, (T,), _ = rolled
    measured = QUICK.model_copy(update={"lidar_height_m": 0.31, "basin_starts": 3})
    with open_recording(path) as recording:
        found = calibrate_without_board(recording, measured)
    assert found.unobservable == ()
    assert np.abs(place_error(T, found.T_camera_lidar)).max() < 0.03
    assert found.basin == 1.0


def test_a_right_guess_is_kept_and_a_wrong_one_is_improved(rolled) -> None:
    path, (T,), topics = rolled
    with open_recording(path) as recording:
        kept = calibrate_without_board(recording, QUICK, T_guess=T, depth_topic=topics[0])
        off = apply_pose_error(T, np.array([0.02, -0.04, 0.02, 0.05, 0.0, -0.05]))
        better = calibrate_without_board(recording, QUICK, T_guess=off)
    assert not kept.improved
    np.testing.assert_allclose(kept.T_camera_lidar, T, atol=1e-12)
    assert "The guess is kept" in kept.verdict
    assert better.improved
    assert "better on frames that were held out" in better.verdict
    np.testing.assert_allclose(better.T_guess, off, atol=1e-12)
    assert np.rad2deg(np.abs(pose_error(T, better.T_camera_lidar)[:3])).max() < 0.3
    # The height that nothing shows stays the guess's.
    up = place_error(off, better.T_camera_lidar)[2]
    assert abs(up) < 0.01


@pytest.mark.slow
def test_recorded_transforms_are_a_guess_unless_they_are_ignored(simulate) -> None:
    path, (T,), _ = simulate("furnished_room", 3.0, 0.0, "all")
    with open_recording(path) as recording:
        found = calibrate_without_board(recording, QUICK)
        free = calibrate_without_board(recording, QUICK, ignore_transforms=True)
    np.testing.assert_allclose(found.T_guess, T, atol=1e-6)
    assert free.T_guess is None


@pytest.mark.slow
def test_a_camera_on_its_side_is_of_its_stored_images(simulate) -> None:
    path, poses, topics = simulate("robot_at_home", 4.0, 0.0)
    T = poses[1]
    guess = apply_pose_error(T, np.array([0.02, 0.03, -0.02, 0.02, 0.0, 0.02]))
    with open_recording(path) as recording:
        with pytest.raises(MissingStream, match="4 depth cameras"):
            calibrate_without_board(recording, QUICK)
        found = calibrate_without_board(recording, QUICK, T_guess=guess, depth_topic=topics[1])
    # Rolled by 90 degrees, its x is the height.
    assert found.unobservable == ("x_m",)
    assert np.rad2deg(np.abs(pose_error(T, found.T_camera_lidar)[:3])).max() < 0.3
    assert np.abs(place_error(T, found.T_camera_lidar)[:2]).max() < 0.03


def test_where_nothing_is_seen_it_refuses_or_keeps_the_guess(log, pose_of) -> None:
    """A few coarse images of a plane, and a scan of nine beams."""
    for index in range(6):
        log.scan(100.0 * index)
        log.image(100.0 * index)
    log.info()
    T = invert_transform(pose_of(0.0, 0.0, 0.5, optical=True))
    with log.open() as recording:
        with pytest.raises(CalibrationFailed) as caught:
            calibrate_without_board(recording, QUICK)
        assert "\n" not in str(caught.value)
        kept = calibrate_without_board(recording, QUICK, T_guess=T)
    assert not kept.improved
    assert kept.unobservable == POSE_PARAMETERS
    np.testing.assert_array_equal(kept.T_camera_lidar, T)
    assert kept.verdict.startswith("The guess is kept: ")


def test_a_camera_without_intrinsics_is_refused(log) -> None:
    log.scan(0.0)
    log.image(0.0)
    with log.open() as recording, pytest.raises(CalibrationFailed, match="no usable intrinsics"):
        calibrate_without_board(recording, QUICK)
