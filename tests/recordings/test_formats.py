"""Formats are recognised by content; what is no recording is refused in one line."""

import os
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.model.errors import RecordingError
from fusion_core.recordings import formats
from fusion_core.recordings.formats import open_recording
from tests.hostile.files import write_crowd

NO_RECORDINGS = {
    "pairs.relations": (b"1.0 2.0 0.1 0.2 0.3 0 0 0\n", "text file"),
    "trajectory.txt": (b"# timestamp tx ty tz\n1 0 0 0 0 0 0 1\n", "text file"),
    "map.yaml": (b"image: map.pgm\nresolution: 0.05\n", "text file"),
    "cloud.pcd": (b"# .PCD v0.7\nVERSION 0.7\n", "PCD"),
    "cloud.ply": (b"ply\nformat ascii 1.0\n", "PLY"),
    "cloud.bin": (np.arange(40, dtype="<f4").tobytes(), "evaluate room"),
    "camera.yaml": (b"K: [9, 0, 4, 0, 9, 4, 0, 0, 1]\nwidth: 8\nheight: 8\n", "the intrinsics of"),
    "calib.txt": (
        b"K: 9 0 4 0 9 4 0 0 1\nT: 1 0 0 0 0 1 0 0 0 0 1 0\n",
        "the intrinsics and extrinsics of",
    ),
    "guess.json": (b'{"R": [[1,0,0],[0,1,0],[0,0,1]], "t": [0,0,0]}', "the extrinsics of a calib"),
    "picture.png": (b"\x89PNG\r\n\x1a\n" + bytes(20), "PNG"),
    "picture.jpg": (b"\xff\xd8\xff\xe0" + bytes(20), "JPEG"),
    "log.clf.bz2": (b"BZh91AY&SY" + bytes(20), "unpack"),
    "log.gz": (b"\x1f\x8b\x08" + bytes(20), "unpack"),
    "scene.zip": (b"PK\x03\x04" + bytes(20), "unpack"),
    "old.bag": (b"#ROSBAG V1.2\n", "rosbag fix"),
    "noise.bin": (bytes(range(256)), "no known format"),
    "text.bag": (b"not a bag at all\n", "text file"),
    "text.mcap": (b"not an mcap\n", "text file"),
    "empty.bag": (b"", "is empty"),
}


def refused(path: Path) -> str:
    with pytest.raises(RecordingError) as caught:
        open_recording(path)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    assert caught.value.advice
    return text


@pytest.mark.parametrize("name", NO_RECORDINGS)
def test_files_that_are_no_recordings(tmp_path: Path, name: str) -> None:
    content, said = NO_RECORDINGS[name]
    (tmp_path / name).write_bytes(content)
    assert said in refused(tmp_path / name)


def test_a_missing_path(tmp_path: Path) -> None:
    assert "does not exist" in refused(tmp_path / "nothing.bag")


def test_an_empty_folder(tmp_path: Path) -> None:
    assert "without a recording" in refused(tmp_path)


def test_a_folder_around_recordings_names_them(tmp_path: Path, build: Callable[[str], Any]) -> None:
    build("rosbag1")
    assert "sample.bag" in refused(tmp_path)


def test_two_recordings_in_one_folder(tmp_path: Path, build: Callable[[str], Any]) -> None:
    build("mcap zstd")
    build("rosbag1")
    text = refused(tmp_path)
    assert "a.mcap" in text
    assert "sample.bag" in text


def test_the_root_of_a_disk_is_a_folder_without_a_name() -> None:
    with pytest.raises(RecordingError, match="is a folder"):
        open_recording(Path("/"))


def test_a_crowded_folder_is_looked_into_within_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked = []
    could_be = formats.is_recording
    monkeypatch.setattr(formats, "is_recording", lambda path: looked.append(path) or could_be(path))
    folder = write_crowd(tmp_path / "crowd", pipes=5, files=600)
    assert "is a folder without a recording" in refused(folder)
    assert len(looked) == 500


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes")
def test_a_pipe_is_refused_without_waiting_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "neither a file nor a folder" in refused(tmp_path / "pipe")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_no_permission(tmp_path: Path) -> None:
    file = tmp_path / "secret.bag"
    file.write_bytes(b"#ROSBAG V2.0\n")
    file.chmod(0)
    assert "Permission denied" in refused(file)


def test_a_database_of_something_else(tmp_path: Path) -> None:
    connection = sqlite3.connect(tmp_path / "other.db3")
    connection.execute("CREATE TABLE people (name TEXT)")
    connection.commit()
    connection.close()
    assert "ROS 2" in refused(tmp_path / "other.db3")


@pytest.mark.parametrize("name", ["rosbag1", "mcap zstd", "db3"])
def test_the_suffix_does_not_matter(build: Callable[[str], Any], name: str) -> None:
    sample = build(name)
    renamed = sample.path.rename(sample.path.with_name("recording.txt"))
    with open_recording(renamed) as recording:
        assert sum(topic.count for topic in recording.topics) == len(sample.written)


def test_lists_without_images_are_refused(tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth/1.png").write_bytes(b"\x89PNG")
    (tmp_path / "depth.txt").write_text("# timestamp filename\n")
    assert "no images" in refused(tmp_path)
