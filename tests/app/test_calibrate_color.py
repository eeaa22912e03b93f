"""``calibrate color`` on a scene that is drawn by hand."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tyro

from fusion_core.exporting.clouds import write_cloud
from fusion_core.model.errors import CalibrationFailed, ExportError, SettingsError
from fusion_core.model.progress import silent
from fusion_core.recordings.clouds.formats import read_cloud
from scanloom.commands.calibrate_color import CalibrateColor
from scanloom.commands.options import PARSER_CONFIG
from scanloom.commands.reports import Report

# Ahead of the LiDAR a wall, red on its left half and blue on its right; a post before it.
WALL = np.stack(
    [a.ravel() for a in np.meshgrid(4.0, np.arange(-3.0, 3.0, 0.02), np.arange(-2.0, 2.0, 0.02))],
    axis=1,
)
POST = np.stack(
    [a.ravel() for a in np.meshgrid(2.0, np.arange(-0.1, 0.1, 0.01), np.arange(-2.0, 2.0, 0.01))],
    axis=1,
)
POINTS = np.concatenate([WALL, POST])
INTENSITY = np.arange(len(POINTS), dtype=np.float32)
CALIBRATION = """\
T_camera_lidar = [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
K = [[200, 0, 159.5], [0, 200, 119.5], [0, 0, 1]]
width = 320
height = 240
"""


@pytest.fixture(autouse=True)
def in_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    image = np.zeros((240, 320, 3), np.uint8)
    image[:, :160] = 0, 0, 255
    image[:, 160:] = 255, 0, 0
    cv2.imwrite("image.png", image)
    write_cloud(Path("cloud.pcd"), POINTS, None, INTENSITY)
    Path("result.toml").write_text(CALIBRATION)


def color(*args: str) -> Report:
    command = tyro.cli(
        CalibrateColor,
        args=["cloud.pcd", "image.png", "--extrinsics", "result.toml", "-o", *args],
        config=PARSER_CONFIG,
    )
    return command.run(silent)


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_colours_and_intensity_as_open3d_reads_them(suffix: str) -> None:
    import open3d as o3d

    report = color(f"colored{suffix}")
    cloud = o3d.t.io.read_point_cloud(f"colored{suffix}")
    points_m, rgb = cloud.point.positions.numpy(), cloud.point.colors.numpy()
    left = points_m[:, 1] > 0.0
    assert np.array_equal(np.unique(rgb[left], axis=0), [[255, 0, 0]])
    assert np.array_equal(np.unique(rgb[~left], axis=0), [[0, 0, 255]])
    # What lies outside of the image is left out, and the shadow of the post: 20 cm of the wall
    # on either side of the middle.
    on_wall = points_m[:, 0] > 3.0
    assert np.abs(points_m[on_wall, 1]).min() > 0.15
    assert (on_wall & (np.abs(points_m[:, 1]) < 0.25)).any()
    assert (~on_wall).sum() > 1000
    intensity = cloud.point.intensity.numpy()[:, 0]
    np.testing.assert_allclose(POINTS[intensity.astype(int)], points_m, atol=1e-6)
    assert report.result["points"] == report.result["colored"] == len(points_m)
    assert report.result["measured"] == len(POINTS)


def test_all_points_are_kept_where_asked() -> None:
    report = color("colored.ply", "--all")
    assert len(read_cloud(Path("colored.ply")).xyz_m) == len(POINTS)
    assert 0 < report.result["colored"] < report.result["points"] == len(POINTS)
    assert report.lines[0].startswith(f"colored.ply: {len(POINTS)} points, ")


def test_settings() -> None:
    Path("open.toml").write_text("[coloring]\ndepth_tolerance = 9.0\n")
    seen = color("a.ply").result["colored"], color("b.ply", "--settings", "open.toml").result
    assert seen[0] < seen[1]["colored"]


def test_refusals() -> None:
    with pytest.raises(ExportError, match="never changed"):
        color("cloud.pcd")
    behind = CALIBRATION.replace("[[0, -1, 0, 0]", "[[0, 1, 0, 0]").replace("[1, 0,", "[-1, 0,")
    Path("result.toml").write_text(behind)
    with pytest.raises(CalibrationFailed, match=r"no point of cloud.pcd is in the image"):
        color("a.ply")
    Path("result.toml").write_text(CALIBRATION.replace("width = 320", "width = 640"))
    with pytest.raises(SettingsError, match="is for images of 640 x 240 pixels"):
        color("a.ply")
    assert not Path("a.ply").exists()
