"""Intrinsics in everybody's files, and the ways in which they do not belong to an image."""

import json
from pathlib import Path
from typing import Any

import pytest

from fusion_core.model.errors import SettingsError
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics

K = [2100.5, 0.0, 950.25, 0.0, 2070.25, 576.5, 0.0, 0.0, 1.0]
D = [-0.125, 0.25, 0.0005, -0.00025]
ROWS = [K[0:3], K[3:6], K[6:9]]
SIZE = (1920, 1080)


def words(values: list[float]) -> str:
    return " ".join(map(str, values))


def opencalib(**param: Any) -> str:
    matrices = {
        "cam_K": {"rows": 3, "cols": 3, "type": 6, "data": ROWS},
        "cam_dist": {"rows": 1, "cols": 4, "type": 6, "data": [D]},
    }
    whole = {"img_dist_w": 1920, "img_dist_h": 1080, **matrices, **param}
    return json.dumps({"camera-intrinsic": {"param_type": "intrinsic", "param": whole}})


MANAGER = f"""\
image_width: 1920
image_height: 1080
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: {K}
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 4
  data: {D}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "camera"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        MANAGER,
        f"distortion_model: radtan\nwidth: 1920\nheight: 1080\nD: {D}\nK: {K}\n",
        f"header:\n  frame_id: camera\nheight: 1080\nwidth: 1920\nd: {D}\nk: {K}\n---\n",
        f"K = {ROWS}\nwidth = 1920\nheight = 1080\ndistortion = {D}\n",
        json.dumps({"K": ROWS, "width": 1920, "height": 1080, "distortion": D}),
        opencalib(),
        "%YAML:1.0\n---\nimage_width: 1920\nimage_height: 1080\ncamera_matrix: !!opencv-matrix\n"
        f"   rows: 3\n   cols: 3\n   dt: d\n   data: {K}\ndistortion_coefficients: "
        f"!!opencv-matrix\n   rows: 1\n   cols: 4\n   dt: d\n   data: {D}\n",
    ],
)
@pytest.mark.parametrize("image_size", [None, SIZE])
def test_forms_that_state_the_size(tmp_path: Path, text: str, image_size: Any) -> None:
    found = read_intrinsics(write(tmp_path, text), image_size)
    assert (found.fx, found.fy, found.cx, found.cy) == (2100.5, 2070.25, 950.25, 576.5)
    assert (found.width, found.height) == SIZE
    assert found.distortion == tuple(D)


P2 = [*K[0:3], 45.8, *K[3:6], -0.35, *K[6:9], 0.005]


@pytest.mark.parametrize(
    ("text", "distortion"),
    [
        (f"K: {words(K)}\nD: {words(D)}\nT: 1 0 0 0 0 1 0 0 0 0 1 0\n", tuple(D)),
        (f"P1: {words(P2)}\nP2: {words(P2)}\nR0_rect: 1 0 0 0 1 0 0 0 1\n", ()),
        (
            "fx: 2100.5\nfy: 2070.25\ncx: 950.25\ncy: 576.5\nk1: -0.125\nk2: 0.25\np1: 0.0005\n"
            "p2: -0.00025\n",
            (*D, 0.0),
        ),
        (words(K), ()),
        ("2100.5 2070.25 950.25 576.5\n", ()),
    ],
)
def test_forms_that_do_not(tmp_path: Path, text: str, distortion: tuple[float, ...]) -> None:
    path = write(tmp_path, text)
    found = read_intrinsics(path, SIZE)
    assert (found.fx, found.fy, found.cx, found.cy) == (2100.5, 2070.25, 950.25, 576.5)
    assert (found.width, found.height, found.distortion) == (*SIZE, distortion)
    with pytest.raises(SettingsError, match="does not state the size"):
        read_intrinsics(path)
    for other in ((960, 540), (3840, 2160), (1280, 720), (1080, 1920)):
        with pytest.raises(SettingsError, match=rf"far from the middle of an image of {other[0]}"):
            read_intrinsics(path, other)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (MANAGER, "is for images of 1920 x 1080 pixels, the image has 960 x 540"),
        ("width: 3\n", "fx is missing or no finite number"),
        (f"K: {words(K[:8])}", "8 numbers are no 3 x 3 matrix"),
        (f"K: {words([*K[:1], 5.0, *K[2:]])}", "no 3 x 3 matrix"),
        (f"K: {words(K).replace('950.25', 'nan')}", "K is missing or no finite number"),
        (f"K: {words([-K[0], *K[1:]])}\nwidth: 960\nheight: 540", "positive focal lengths"),
        (f"K: {words(K)}\nD: 1 2 3", "3 distortion coefficients"),
        (f"K: {words(K)}\nwidth: 960", "height is missing"),
        (f"K: {words(K)}\nwidth: 960\nheight: -4", "height -4 is no number of pixels"),
        (f"K: {words(K)}\nwidth: 960\nheight: 540\ndistortion_model: omni", "model 'omni'"),
        (
            f"K: {words(K)}\nwidth: 960\nheight: 540\ndistortion_model: fisheye\nD: 0 0 0 0 0",
            "5 distortion coefficients of the model fisheye",
        ),
        ("P2: 1 2 3", "P2 has 3 numbers, not 3 x 4"),
        (opencalib(cam_K=3), "1 numbers are no 3 x 3 matrix"),
        ('{"K": null}', "K holds no list of numbers"),
        ("", "fx is missing"),
        ("\x00", "is not TOML"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(SettingsError, match=problem) as caught:
        read_intrinsics(write(tmp_path, text), (960, 540))
    assert "\n" not in str(caught.value)


def test_opencalib_states_a_size_that_nobody_reads(tmp_path: Path) -> None:
    path, notes = write(tmp_path, opencalib()), list[str]()
    assert read_intrinsics(path, (1920, 1200), notes).height == 1200
    assert notes == [
        "camera states images of 1920 x 1080 pixels; the image has 1920 x 1200, and its middle "
        "agrees with the file's centre."
    ]
    with pytest.raises(SettingsError, match="far from the middle of an image of 960 x 600"):
        read_intrinsics(path, (960, 600))


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "size", "fx", "model", "coefficients"),
    [
        ("acfr_board/camera_info.yaml", (1920, 1208), 959.554, "fisheye", 4),
        ("kitti_000000/000000.txt", (1224, 370), 707.0493, "plumb_bob", 0),
        ("opencalib_street/calib.txt", (1920, 1200), 2152.8, "plumb_bob", 4),
        ("opencalib_manual/center_camera-intrinsic.json", (1920, 1200), 2109.75, "plumb_bob", 4),
        ("laser_pixel_pairs/config.yaml", (640, 480), 410.741321520433, "plumb_bob", 5),
    ],
)
def test_files_of_other_people(
    data_folder: Path, name: str, size: tuple[int, int], fx: float, model: str, coefficients: int
) -> None:
    found = read_intrinsics(data_folder / "real/calibration" / name, size)
    assert (found.width, found.height, found.fx, found.distortion_model) == (*size, fx, model)
    assert len(found.distortion) == coefficients
