"""A recording with depth alone: a folder in the layout of 7-Scenes, its LiDAR cut from a row."""

import csv
import json

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader

from fusion_core.model.errors import MissingStream, SettingsError
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.units import millimetres_from_depth_m
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions

ROW, WIDTH, HEIGHT, FOCAL = 60, 160, 120, 144.0


@pytest.fixture(scope="module")
def folder(scenes, tmp_path_factory):
    """Depth of a simulated room as PNG files, without colour or poses."""
    path = tmp_path_factory.mktemp("frames")
    with open_recording(scenes("bedroom")) as recording:
        messages = recording.messages(["/camera/depth/image_raw"])
        for number, message in enumerate(messages):
            depth_mm = millimetres_from_depth_m(message.value.depth_m)
            assert cv2.imwrite(str(path / f"frame-{number:06d}.depth.png"), depth_mm)
    lens = np.array([[FOCAL, 0.0, 79.5], [0.0, FOCAL, 59.5], [0.0, 0.0, 1.0]])
    np.savetxt(path / "camera-intrinsics.txt", lens)
    return path


@pytest.fixture(scope="module")
def results(folder, tmp_path_factory):
    output = tmp_path_factory.mktemp("virtual") / "out"
    summary = fuse(folder, output, FuseOptions(virtual_lidar_row=ROW, figures=False))
    return output, summary


def test_the_offset_is_where_the_crop_put_it(results):
    output, summary = results
    half_rad = np.arctan2(WIDTH / 2, FOCAL)
    # The rows are the middle 60 % of the columns, so they start this far into the curve.
    expected = np.rad2deg(half_rad - np.arctan2(0.6 * WIDTH / 2, FOCAL))
    assert summary.document["u"] == pytest.approx(expected, abs=1.0)
    with (output / "frames.csv").open(newline="", encoding="utf-8") as file:
        frames = list(csv.DictReader(file))
    assert len(frames) == 45
    u = np.array([float(frame["u"]) for frame in frames if frame["u"]])
    v = np.array([float(frame["v"]) for frame in frames if frame["v"]])
    assert u.size >= 0.9 * len(frames)
    assert (np.abs(u - expected) <= 1.0).mean() >= 0.95
    # The rows around the cut are no answer: they are the curve itself.
    assert (np.abs(v - ROW) > 3.0).all()


def test_it_is_called_virtual_everywhere(results):
    output, summary = results
    document = json.loads((output / "alignment.json").read_text())
    assert document["virtual_lidar"] is True
    assert "virtual" in summary.lines()[0]
    with (output / "fused.mcap").open("rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    assert {channel.topic for channel in channels} == {
        "/virtual_lidar/scan",
        "/camera/depth/image_raw",
    }
    assert not list(output.glob("map_*"))


def test_depth_alone_needs_the_option(folder, tmp_path):
    with pytest.raises(MissingStream, match="no 2D LiDAR"):
        fuse(folder, tmp_path / "out", FuseOptions(figures=False))


def test_a_row_that_the_image_lacks_is_refused(folder, tmp_path):
    with pytest.raises(SettingsError, match="rows 0 to 119"):
        fuse(folder, tmp_path / "out", FuseOptions(virtual_lidar_row=HEIGHT, figures=False))


def test_one_of_several_cameras_is_cut(scenes, tmp_path):
    recording = scenes("robot_at_home", duration_s=2.0)
    summary = fuse(
        recording, tmp_path / "out", FuseOptions(virtual_lidar_row=80, maps=False, figures=False)
    )
    assert summary.frames == summary.paired == 21
    assert any("/camera_1/depth/image_raw" in note for note in summary.notes)
