"""The package as a notebook uses it: the README's lines, and what the functions return."""

import csv
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import scanloom
from fusion_core.model.sensors import DepthImage, LaserScan

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def room(small_scene: Path) -> scanloom.FuseResult:
    return scanloom.fuse(small_scene, options=scanloom.FuseOptions(figures=False))


def test_the_lines_of_the_readme(small_scene: Path) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    assert len(blocks) == 3
    bearing_rad = -3.14159 + 0.00872665 * np.arange(720)
    # A square room of 6 m, from its middle.
    walls_m = 3.0 / np.maximum(np.abs(np.cos(bearing_rad)), np.abs(np.sin(bearing_rad)))
    names = {"first_m": walls_m, "second_m": walls_m}
    for block in blocks:
        assert block.isascii()
        exec(block.replace("samples/furnished_room.mcap", str(small_scene)), names)
    assert names["room"].frames.num_rows > 0
    assert np.allclose(names["match"].pose_first_second, 0.0, atol=1e-6)


def test_the_frames_are_those_of_the_file(room: scanloom.FuseResult) -> None:
    with (room.folder / "frames.csv").open(encoding="utf-8", newline="") as lines:
        rows = list(csv.DictReader(lines))
    assert room.frames.column_names == list(rows[0])
    scores = [float(row["score"] or "nan") for row in rows]
    assert np.array_equal(room.frames["score"].to_numpy(), scores, equal_nan=True)
    assert room.samples.num_rows > 0
    assert room.mount.yaw_rad == room.alignment["mount_used"]["yaw_rad"]
    assert room.mount.sd[0] == room.alignment["yaw_rad_sd"]


def test_maps_have_the_cells_of_a_ros_map(room: scanloom.FuseResult) -> None:
    assert room.maps.keys() == {"lidar", "camera", "fused"}
    cells = room.maps["fused"].to_numpy()
    assert cells.dtype == np.int8
    assert (cells == -1).any()
    assert (cells > 50).any()
    assert ((cells >= 0) & (cells < 50)).any()
    assert cells.min() == -1
    assert cells.max() <= 100


def test_results_live_in_a_folder_of_their_own_as_long_as_their_value(small_scene: Path) -> None:
    slam = scanloom.build_map(small_scene)
    folder = slam.folder
    assert (folder / "trajectory.tum").is_file()
    assert slam.to_numpy().shape == (slam.trajectory.num_rows, 3)
    assert np.isfinite(slam.to_numpy()).all()
    assert slam.maps.keys() == {"lidar"}
    del slam
    assert not folder.exists()


def test_a_folder_of_results_is_read_again(room: scanloom.FuseResult, tmp_path: Path) -> None:
    shutil.copytree(room.folder, tmp_path / "kept")
    again = scanloom.load(tmp_path / "kept")
    assert isinstance(again, scanloom.FuseResult)
    assert again.frames.equals(room.frames)
    assert again.samples.equals(room.samples)
    assert again.mount == room.mount


def test_a_folder_that_holds_no_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises(scanloom.ScanLoomError, match="holds no results"):
        scanloom.load(tmp_path)


def test_a_result_that_was_changed_is_refused(room: scanloom.FuseResult, tmp_path: Path) -> None:
    shutil.copytree(room.folder, tmp_path / "kept")
    with (tmp_path / "kept" / "frames.csv").open("a", encoding="utf-8") as file:
        file.write("\n")
    with pytest.raises(scanloom.ScanLoomError, match="is not as the run"):
        scanloom.load(tmp_path / "kept")


def test_what_is_inside_a_recording(small_scene: Path) -> None:
    inside = scanloom.info(small_scene)
    with scanloom.open(small_scene) as recording:
        assert inside.topics["name"].to_pylist() == [topic.name for topic in recording.topics]
        kinds = {type(message.value) for message in recording.messages()}
    assert {LaserScan, DepthImage} <= kinds
    assert inside.duration_s == inside.document["duration_s"]
    assert any("fused" in line for line in inside.can)


def test_a_recording_that_is_not_there_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(scanloom.ScanLoomError, match="does not exist"):
        scanloom.open(tmp_path / "none.mcap")


def test_a_name_that_the_package_lacks_is_an_attribute_error() -> None:
    assert not hasattr(scanloom, "fuze")


def test_the_import_is_light() -> None:
    """``--help`` imports the package: the libraries of the stages come with the first call."""
    code = "import sys, scanloom; print(*{'cv2', 'numba', 'pyarrow', 'gtsam'} & sys.modules.keys())"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ""


@pytest.mark.parametrize("name", ["open", "info", "fuse", "build_map", "load", "match_scans"])
def test_every_function_says_what_it_does(name: str) -> None:
    function = getattr(scanloom, name)
    assert "ScanLoomError" in function.__doc__
    assert set(function.__annotations__) >= {"return"}
