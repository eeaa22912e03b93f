"""Extrinsics in the files of KITTI and OpenCalib, against their formulas and their own numbers."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fusion_core.model.errors import SettingsError
from fusion_core.recordings.calibration_files.extrinsics import read_extrinsics, read_guess

T = np.eye(4)
T[:3, :3] = Rotation.from_euler("xyz", [-1.5, 0.02, -1.6]).as_matrix()
T[:3, 3] = 0.03, -0.4, -0.1


def text_of(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values.ravel())


def write(folder: Path, text: str) -> Path:
    path = folder / "calib.txt"
    path.write_text(text, encoding="utf-8")
    return path


def opencalib(sensor: str, target: str, matrix: np.ndarray) -> str:
    calib = {"rows": 4, "cols": 4, "type": 6, "continuous": True, "data": matrix.tolist()}
    entry = {"sensor_name": sensor, "target_sensor_name": target, "param": {"sensor_calib": calib}}
    return json.dumps({f"{sensor}-to-{target}-extrinsic": entry})


@pytest.mark.parametrize(
    "text",
    [
        f"K: 2000 0 960 0 2000 540 0 0 1\nD: 0 0 0 0\nT: {text_of(T[:3])}\n",
        f"T: {text_of(T)}\n",
        text_of(T),
        "\n".join(text_of(row) for row in T[:3]),
        f"T_camera_lidar: {T.tolist()}\n",
        f"T_camera_lidar:\n  rows: 4\n  cols: 4\n  data: {T.ravel().tolist()}\n",
        "%YAML:1.0\n---\nT_camera_lidar: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n"
        f"   data: {T.ravel().tolist()}\n",
        f"R: {T[:3, :3].tolist()}\nt: {T[:3, 3].tolist()}\n",
        opencalib("top_center_lidar", "center_camera", T),
        opencalib("center_camera", "top_center_lidar", np.linalg.inv(T)),
    ],
)
def test_forms_of_the_same_transform(tmp_path: Path, text: str) -> None:
    np.testing.assert_allclose(read_guess(write(tmp_path, text)), T, atol=1e-9)


def test_kitti_gives_the_rectified_camera_of_image_2(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    P2 = np.array([[707.0, 0.0, 604.0, 45.8], [0.0, 707.0, 180.5, -0.35], [0.0, 0.0, 1.0, 0.005]])
    rectification = Rotation.from_rotvec([0.01, -0.008, 0.004]).as_matrix()
    text = f"P2: {text_of(P2)}\nR0_rect: {text_of(rectification)}\nTr_velo_to_cam: {text_of(T[:3])}"
    found = read_guess(write(tmp_path, text))
    # KITTI's own formula: P2 R0_rect Tr_velo_to_cam x, against K times the point in our frame.
    points = np.column_stack(
        [rng.uniform(2.0, 40.0, (50, 1)), rng.normal(size=(50, 2)), np.ones(50)]
    )
    R0 = np.eye(4)
    R0[:3, :3] = rectification
    theirs = points @ (P2 @ R0 @ T).T
    ours = (points @ found.T)[:, :3] @ P2[:, :3].T
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    without = read_guess(write(tmp_path, f"P2: {text_of(P2)}\nTr: {text_of(T[:3])}\n"))
    np.testing.assert_allclose(without[:3, :3], T[:3, :3], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (f"T: {text_of(1000.0 * T[:3])}", "T is no rigid transform"),
        (f"T: {text_of(np.column_stack([T[:3, :3], 1000.0 * T[:3, 3]]))}", "400 m apart"),
        (f"T: {text_of(T[:3, :3])}", "T must be 3 x 4 finite numbers"),
        (f"T: {text_of(T[:3]).replace('0.03', 'nan')}", "finite numbers"),
        ("T: here", "T must be 3 x 4 finite numbers, got here"),
        ("1 2 3 4 5 6 7", "the matrix must be 3 x 4 finite numbers"),
        (f"P2: {text_of(np.zeros(12))}\nTr: {text_of(T[:3])}", "P2 is singular"),
        (f"Tr: {text_of(T[:3])}", "T_camera_lidar is missing"),
        (opencalib("a_lidar", "b_camera", 2.0 * T), "sensor_calib is no rigid transform"),
        (opencalib("a_camera", "b_lidar", 2.0 * T), "sensor_calib is no rigid transform"),
        ('{"a": {"param": {"sensor_calib": 3}}}', "sensor_calib must be 4 x 4"),
        ("a: b: c", "is not YAML"),
        ('T_camera_lidar = """a\nb"""', "finite numbers, got a b"),
        ('[cameras."a\\nb"]\n', "a.nb: T_camera_lidar is missing"),
        ("a: &a 1\nb: *a\n", "it uses aliases"),
        ("a: " + "x" * 70_000, "more than 65536"),
        (
            "".join(f"[cameras.{name}]\nT_camera_lidar = {T.tolist()}\n" for name in "ab"),
            "holds 2 cameras: a, b",
        ),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(SettingsError, match=problem) as caught:
        read_guess(write(tmp_path, text))
    assert "\n" not in str(caught.value)


@pytest.mark.data
def test_files_of_other_people(data_folder: Path) -> None:
    folder = data_folder / "real/calibration"
    street = read_extrinsics(folder / "opencalib_street/calib.txt")[None]
    np.testing.assert_allclose(street[:3, 3], [-0.0323222, -0.396685, -0.0869361])
    manual = read_extrinsics(
        folder / "opencalib_manual/top_center_lidar-to-center_camera-extrinsic.json"
    )[None]
    np.testing.assert_allclose(manual[:3, 3], [-0.0322306, -0.352079, -0.574468])
    kitti = read_extrinsics(folder / "kitti_000000/000000.txt")[None]
    for T_camera_lidar in (street, manual, kitti):
        # What lies ahead of the scanner lies ahead of the camera; up is -y.
        assert T_camera_lidar[2, 0] > 0.99
        assert T_camera_lidar[1, 2] < -0.99
    # Its translation to camera 0, and the baseline of 6 cm; the rectification turns by half a
    # degree.
    np.testing.assert_allclose(kitti[:3, 3], [-0.025 + 0.06, -0.061, -0.332 + 0.005], atol=0.005)
