"""``calibrate planar``: from files to files, and one clear line for what is wrong."""

import json

import numpy as np
import pytest

from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.exporting.camera_info import write_camera_info
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.geometry import make_transform
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.recordings.calibration_files.extrinsics import read_extrinsics
from fusion_core.simulation.board_recording import BoardSceneSettings, write_board_recording
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.calibrate.planar import (
    PlanarOptions,
    calibrate_planar,
    planar_lines,
)

CAMERA = CameraIntrinsics(width=640, height=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
TRUTH = make_transform(
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.array([0.05, 0.3, 0.1])
)
SCENE = BoardSceneSettings(seed=2, places=12, still_s=0.6, carried_s=0.3)


@pytest.fixture(scope="module")
def camera_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("camera") / "camera.yaml"
    write_camera_info(file, CAMERA, {})
    return file


@pytest.fixture(scope="module")
def pair_file(tmp_path_factory):
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(1.0, 4.0, 30), rng.uniform(-0.5, 0.5, 30)], axis=1)
    seen = np.column_stack([points, np.zeros(30)]) @ TRUTH[:3, :3].T + TRUTH[:3, 3]
    pixels = seen[:, :2] / seen[:, 2:] * 500.0 + (319.5, 239.5) + rng.normal(0.0, 0.3, (30, 2))
    file = tmp_path_factory.mktemp("pairs") / "pairs.txt"
    np.savetxt(file, np.column_stack([points, pixels]), fmt="%.6f")
    return file


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    file = tmp_path_factory.mktemp("board") / "board.mcap"
    write_board_recording(file, SCENE)
    return file


@pytest.fixture(scope="module")
def short_recording(tmp_path_factory):
    file = tmp_path_factory.mktemp("board") / "short.mcap"
    write_board_recording(file, BoardSceneSettings(seed=2, places=3, still_s=0.6, carried_s=0.05))
    return file


def test_pairs_become_a_result_that_is_read_back(tmp_path, pair_file, camera_file):
    output = tmp_path / "result.json"
    options = PlanarOptions(intrinsics_file=camera_file)
    result = calibrate_planar(pair_file, output, options)
    assert np.abs(pose_error(TRUTH, np.array(result["T_camera_lidar"]))).max() < 0.02
    np.testing.assert_allclose(read_extrinsics(output)[None], result["T_camera_lidar"], atol=1e-12)
    held = json.loads(output.read_text())
    assert held["reprojection_rms_px"] > held["reprojection_rms_used_px"]
    assert held["pairs"] == 30
    assert (tmp_path / "result.urdf").exists()
    assert planar_lines(result)[0].startswith("Found from 30 pairs")


def test_the_same_input_gives_the_same_bytes(tmp_path, pair_file, camera_file):
    texts = []
    for name in ("a.json", "b.json"):
        calibrate_planar(
            pair_file, tmp_path / name, PlanarOptions(intrinsics_file=camera_file, seed=3)
        )
        texts.append((tmp_path / name).read_bytes())
    assert texts[0] == texts[1]


def test_a_recording_with_a_board_gives_the_pose(tmp_path, recording):
    options = PlanarOptions(board="8x6", square_m=0.1)
    result = calibrate_planar(recording, tmp_path / "result.toml", options)
    with np.load(truth_path(recording)) as truth:
        error = pose_error(truth["T_camera_lidar"], np.array(result["T_camera_lidar"]))
    assert np.degrees(np.linalg.norm(error[:3])) < 1.0
    assert np.linalg.norm(error[3:]) < 0.03
    assert result["board"]["size_counts"] == "squares"
    assert any("stands still at" in note for note in result["input_notes"])


@pytest.mark.slow
def test_a_board_that_never_stands_is_interpolated(tmp_path):
    file = tmp_path / "moving.mcap"
    moving = BoardSceneSettings(seed=4, places=8, still_s=0.0, carried_s=2.0, camera_rate_hz=10.0)
    write_board_recording(file, moving)
    settings = tmp_path / "settings.toml"
    # The simulated board slows down at each place.
    settings.write_text("[board_views]\nstill_px = 0.01\n")
    options = PlanarOptions(board="7x5", square_m=0.1, settings_file=settings)
    result = calibrate_planar(file, tmp_path / "result.json", options)
    with np.load(truth_path(file)) as truth:
        error = pose_error(truth["T_camera_lidar"], np.array(result["T_camera_lidar"]))
    assert np.degrees(np.linalg.norm(error[:3])) < 1.0
    assert np.linalg.norm(error[3:]) < 0.03
    assert any("interpolated" in note for note in result["input_notes"])


def test_a_wrong_guess_is_improved_and_kept_in_the_file(tmp_path, pair_file, camera_file):
    guess = apply_pose_error(TRUTH, np.array([0.02, 0.0, 0.02, 0.05, 0.0, 0.0]))
    file = tmp_path / "guess.json"
    file.write_text(json.dumps({"T_camera_lidar": guess.tolist()}))
    options = PlanarOptions(intrinsics_file=camera_file, guess_file=file)
    result = calibrate_planar(pair_file, tmp_path / "result.json", options)
    assert result["improved"]
    np.testing.assert_allclose(result["T_guess"], guess, atol=1e-12)


def problem(source, output, **options):
    with pytest.raises(ScanLoomError) as caught:
        calibrate_planar(source, output, PlanarOptions(**options))
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_pairs_without_intrinsics(tmp_path, pair_file):
    assert "pairs.txt: holds pairs, which need" in problem(pair_file, tmp_path / "r.json")


def test_pairs_in_millimetres(tmp_path, pair_file, camera_file):
    file = tmp_path / "mm.txt"
    np.savetxt(file, np.loadtxt(pair_file) * (1000.0, 1000.0, 1.0, 1.0))
    text = problem(file, tmp_path / "r.json", intrinsics_file=camera_file)
    assert "mm.txt: a laser point is" in text
    assert text.endswith("Lengths are in metres.")


def test_a_board_that_is_not_there(tmp_path, short_recording):
    text = problem(short_recording, tmp_path / "r.json", board="9x7", square_m=0.1)
    assert "no board of 9x7 inner corners" in text or "show a board of" in text


def test_squares_in_millimetres(tmp_path, recording):
    assert "in metres" in problem(recording, tmp_path / "r.json", board="7x5", square_m=100.0)


def test_squares_of_a_wrong_size(tmp_path, recording):
    text = problem(recording, tmp_path / "r.json", board="7x5", square_m=0.2)
    assert "do not agree with the board" in text or "open" in text


def test_intrinsics_of_another_size(tmp_path, recording):
    file = tmp_path / "small.yaml"
    write_camera_info(
        file, CameraIntrinsics(width=320, height=240, fx=260, fy=260, cx=160, cy=120), {}
    )
    text = problem(recording, tmp_path / "r.json", board="7x5", square_m=0.1, intrinsics_file=file)
    assert "640 x 480 pixels, the intrinsics are for 320 x 240" in text


def test_three_places_only(tmp_path, short_recording):
    text = problem(short_recording, tmp_path / "r.json", board="7x5", square_m=0.1)
    assert "places" in text


def test_an_output_that_is_an_input(pair_file, camera_file, tmp_path):
    guess = tmp_path / "guess.json"
    guess.write_text(json.dumps({"T_camera_lidar": TRUTH.tolist()}))
    text = problem(pair_file, guess, intrinsics_file=camera_file, guess_file=guess)
    assert "is read as the input" in text
