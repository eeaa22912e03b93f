"""``calibrate intrinsics``: from images to a camera file, and one clear line for what is wrong."""

import json

import cv2
import numpy as np
import pytest

from fusion_core.model.errors import ScanLoomError
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics
from fusion_core.recordings.images.camera_files import read_camera_file
from fusion_core.workflows.calibrate.intrinsics import calibrate_intrinsics, intrinsics_lines
from tests.calibration.boards import board_image, board_pose


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    rng = np.random.default_rng(1)
    for index in range(8):
        image, _ = board_image(board_pose(rng), seed=index)
        cv2.imwrite(str(folder / f"image_{index}.png"), image)
    return folder


def test_a_folder_of_images_becomes_a_camera_file(tmp_path, folder):
    output = tmp_path / "camera.yaml"
    result = calibrate_intrinsics([folder], output, board="7x5", square_m=0.1)
    assert abs(result["values"]["fx"] - 520.0) < 5.0 * result["sd"]["fx"]
    assert abs(result["values"]["fx"] - 520.0) < 8.0
    # As other tools, and both of our own readers, take it.
    camera = read_intrinsics(output, (640, 480))
    assert camera.fx == result["values"]["fx"]
    assert read_camera_file(output).intrinsics((480, 640)).distortion == camera.distortion
    assert (tmp_path / "camera_coverage.png").read_bytes().startswith(b"\x89PNG")
    assert any("size counts inner corners" in line for line in intrinsics_lines(result))


def test_json_holds_the_same(tmp_path, folder):
    images = sorted(folder.iterdir())[:4]
    for name in ("a.json", "b.json"):
        calibrate_intrinsics(images, tmp_path / name, board="8x6", square_m=0.1, model="fisheye")
    assert (tmp_path / "a_coverage.png").read_bytes() == (tmp_path / "b_coverage.png").read_bytes()
    held = json.loads((tmp_path / "a.json").read_text())
    assert held["distortion_model"] == "equidistant"
    assert held["calibration"]["board"]["size_counts"] == "squares"
    assert read_intrinsics(tmp_path / "a.json").width == 640


def problem(images, output, **options):
    given = {"board": "7x5", "square_m": 0.1, **options}
    with pytest.raises(ScanLoomError) as caught:
        calibrate_intrinsics(images, output, **given)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_an_image_of_another_size(tmp_path, folder):
    other = tmp_path / "other.png"
    cv2.imwrite(str(other), np.zeros((240, 320), np.uint8))
    text = problem([*sorted(folder.iterdir()), other], tmp_path / "c.yaml")
    assert "other.png: has 320 x 240 pixels, image_0.png has 640 x 480" in text


def test_what_is_no_image(tmp_path, folder):
    other = tmp_path / "other.png"
    other.write_bytes(b"no image")
    assert "other.png" in problem([folder, other], tmp_path / "c.yaml")


def test_an_empty_folder(tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "empty: holds no images" in problem([empty], tmp_path / "c.yaml")


def test_a_wrong_size_of_the_board(tmp_path, folder):
    images = sorted(folder.iterdir())[:3]
    assert "Give --board 7x5" in problem(images, tmp_path / "c.yaml", board="5x4")


def test_a_name_of_no_known_form(tmp_path, folder):
    assert "End it in .yaml" in problem([folder], tmp_path / "camera.xml")


def test_two_images_only(tmp_path, folder):
    text = problem(sorted(folder.iterdir())[:2], tmp_path / "c.yaml")
    assert "2 of 2 images, at least 3" in text
