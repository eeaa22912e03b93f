"""Extrinsics as people write them, and the ways to write them wrongly."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import SettingsError
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.recordings.calibration_files.extrinsics import read_extrinsics

IDENTITY = np.eye(4).tolist()
angles = st.floats(-3.0, 3.0)


@given(angles, angles, angles, st.lists(st.floats(-5.0, 5.0), min_size=3, max_size=3))
def test_what_was_written_is_read(tmp_path_factory, yaw, pitch, roll, t):
    T = make_transform(rotation_from_yaw_pitch_roll(yaw, pitch, roll), np.array(t))
    path = tmp_path_factory.mktemp("extrinsics") / "file"
    for text in (
        f"T_camera_lidar = {np.round(T, 6).tolist()}",
        json.dumps({"R": T[:3, :3].tolist(), "t": T[:3, 3].tolist()}),
    ):
        path.write_text(text, encoding="utf-8")
        found = read_extrinsics(path)
        assert list(found) == [None]
        np.testing.assert_allclose(found[None], T, atol=2e-6)
        # A rotation to the last digit, whatever was rounded.
        np.testing.assert_allclose(
            found[None][:3, :3] @ found[None][:3, :3].T, np.eye(3), atol=1e-12
        )


def test_cameras_by_topic(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(
        f'[cameras."/a"]\nT_camera_lidar = {IDENTITY}\n[cameras."/b"]\nR = {np.eye(3).tolist()}\n'
        "t = [1, 2, 3]\n",
        encoding="utf-8",
    )
    found = read_extrinsics(path)
    assert list(found) == ["/a", "/b"]
    np.testing.assert_array_equal(found["/b"][:3, 3], [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "T_camera_lidar is missing"),
        ("R = [[1,0,0],[0,1,0],[0,0,1]]", "t is missing"),
        ("t = [0,0,0]", "R is missing"),
        ("T_camera_lidar = [[1,0],[0,1]]", "4 x 4 finite numbers"),
        ("T_camera_lidar = 'near'", "4 x 4 finite numbers"),
        ("T_camera_lidar = [[1,0,0,0],[0,1,0,0],[0,0,1,nan],[0,0,0,1]]", "4 x 4 finite numbers"),
        ("T_camera_lidar = [[2,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "no rigid transform"),
        ("T_camera_lidar = [[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", "determinant is -1"),
        ("T_camera_lidar = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]]", "no rigid transform"),
        ("T_camera_lidar = [[1,0,0,0],[0,1,0,0],[0,0,1,620],[0,0,0,1]]", "620 m apart"),
        ("cameras = 3", "a table for each topic"),
        ("[cameras]", "cameras is empty"),
        ("[cameras.a]", "a: T_camera_lidar is missing"),
        ("T_camera_lidar = [", "is not TOML"),
        ('{"R": ', "is not JSON"),
        ("\x00", "is not TOML"),
    ],
)
def test_a_wrong_file_says_what_is_wrong(tmp_path, text, problem):
    path = tmp_path / "wrong.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SettingsError) as caught:
        read_extrinsics(path)
    assert problem in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_files_that_are_none(tmp_path):
    with pytest.raises(SettingsError, match="cannot be read"):
        read_extrinsics(tmp_path / "missing.toml")
    with pytest.raises(SettingsError, match="cannot be read"):
        read_extrinsics(tmp_path)
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SettingsError, match="no text file"):
        read_extrinsics(tmp_path / "binary")
    (tmp_path / "large").write_bytes(b"# " + b"x" * (1 << 21))
    with pytest.raises(SettingsError, match="larger than 1048576 bytes"):
        read_extrinsics(tmp_path / "large")
