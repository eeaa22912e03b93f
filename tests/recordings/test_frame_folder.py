"""Folders of images: a bad file loses only itself, or the intrinsics."""

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.formats import open_recording

DEPTH, COLOR, POSE = "/camera/depth/image_raw", "/camera/color/image_raw", "/camera/pose"


def names(path: Path) -> set[str]:
    with open_recording(path) as recording:
        return {topic.name for topic in recording.topics}


def test_without_intrinsics_there_is_no_camera_info(build: Callable[[str], Any]) -> None:
    sample = build("7-Scenes")
    (sample.path / "camera-intrinsics.txt").unlink()
    assert names(sample.path) == {DEPTH, COLOR, POSE}


@pytest.mark.parametrize("text", ["1 2 3", "a b c", "nan 0 0 0 nan 0 0 0 1"])
def test_intrinsics_that_cannot_be_read(build: Callable[[str], Any], text: str) -> None:
    sample = build("7-Scenes")
    (sample.path / "camera-intrinsics.txt").write_text(text)
    with open_recording(sample.path) as recording:
        assert "/camera/depth/camera_info" not in {t.name for t in recording.topics}
        assert "camera-intrinsics.txt" in recording.warnings[0]


def test_intrinsics_of_another_image_size(build: Callable[[str], Any]) -> None:
    sample = build("Redwood")
    file = sample.path / "camera_primesense.json"
    file.write_text(file.read_text().replace('"width": 4', '"width": 5'))
    with open_recording(sample.path) as recording:
        assert "/camera/depth/camera_info" not in {t.name for t in recording.topics}
        assert "(5, 3)" in recording.warnings[0]


@pytest.mark.parametrize(
    ("row", "problem"),
    [
        ("nan nan nan nan\n" * 4, "not a rigid"),
        ("1 0 0 1e300\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "lies farther than"),
        ("1 0 0 0\n0 1 0 0\n0 0 -1 0\n0 0 0 1\n", "not a rigid"),
        ("2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n", "not a rigid"),
        ("1 0 0 0\n", "4 x 4"),
        ("-1.#IND 0 0 0\n" * 4, "no table of numbers"),
    ],
)
def test_a_bad_pose_loses_only_its_frame(
    build: Callable[[str], Any], row: str, problem: str
) -> None:
    sample = build("7-Scenes")
    (sample.path / "frame-000004.pose.txt").write_text(row)
    with open_recording(sample.path) as recording:
        assert [m.index for m in recording.messages([POSE])] == [0, 2, 3, 4]
        assert recording.warnings[0].startswith(f"{POSE}: 1 of 5 messages are left out")
        assert problem in recording.warnings[0]
        with pytest.raises(RecordingError, match=problem):
            recording.read(POSE, 1)


def test_a_truncated_image_loses_only_its_frame(build: Callable[[str], Any]) -> None:
    sample = build("7-Scenes")
    file = sample.path / "frame-000006.depth.png"
    file.write_bytes(file.read_bytes()[:40])
    with open_recording(sample.path) as recording:
        assert [m.index for m in recording.messages([DEPTH])] == [0, 1, 3, 4]
        assert "frame-000006.depth.png" in recording.warnings[0]


def test_an_image_that_claims_to_be_huge(build: Callable[[str], Any]) -> None:
    sample = build("7-Scenes")
    file = sample.path / "frame-000006.depth.png"
    content = bytearray(file.read_bytes())
    content[16:20] = (1 << 26).to_bytes(4, "big")
    content[29:33] = zlib.crc32(content[12:29]).to_bytes(4, "big")
    file.write_bytes(content)
    with (
        open_recording(sample.path) as recording,
        pytest.raises(RecordingError, match="claims 67108864 x 3 pixels"),
    ):
        recording.read(DEPTH, 2)


def test_a_chunk_that_claims_to_be_huge(build: Callable[[str], Any]) -> None:
    sample = build("7-Scenes")
    file = sample.path / "frame-000006.depth.png"
    content = bytearray(file.read_bytes())
    # The length of the chunk precedes its name.
    at = content.index(b"IDAT") - 4
    content[at : at + 4] = (2**31 - 1).to_bytes(4, "big")
    file.write_bytes(content)
    with (
        open_recording(sample.path) as recording,
        pytest.raises(RecordingError, match="cut short"),
    ):
        recording.read(DEPTH, 2)


def test_eight_bit_depth_is_refused(build: Callable[[str], Any]) -> None:
    sample = build("slambook")
    assert cv2.imwrite(str(sample.path / "depth/2.png"), np.ones((3, 4), np.uint8))
    with (
        open_recording(sample.path) as recording,
        pytest.raises(RecordingError, match="uint8"),
    ):
        recording.read(DEPTH, 1)


def test_fewer_poses_than_frames(build: Callable[[str], Any]) -> None:
    sample = build("slambook")
    file = sample.path / "pose.txt"
    file.write_text("".join(file.read_text().splitlines(keepends=True)[:4]))
    with open_recording(sample.path) as recording:
        assert {t.name: t.count for t in recording.topics}[POSE] == 4
        assert "4 poses for 12 depth images" in recording.warnings[0]


@pytest.mark.parametrize(
    ("name", "file"), [("slambook", "pose.txt"), ("Redwood", "trajectory.log")]
)
def test_a_pose_file_of_another_kind(build: Callable[[str], Any], name: str, file: str) -> None:
    sample = build(name)
    (sample.path / file).write_text("1 2 3\n")
    with open_recording(sample.path) as recording:
        assert any("after 0 poses" in line for line in recording.warnings)
        assert all(topic.role != "pose" for topic in recording.topics)


@pytest.mark.parametrize(
    ("name", "file", "whole"), [("slambook", "pose.txt", 7), ("Redwood", "trajectory.log", 19)]
)
def test_a_truncated_pose_file_keeps_its_whole_poses(
    build: Callable[[str], Any], name: str, file: str, whole: int
) -> None:
    sample = build(name)
    words = (sample.path / file).read_text().split()
    (sample.path / file).write_text(" ".join(words[: 2 * whole + 3]) + " 5.0e-")
    with open_recording(sample.path) as recording:
        assert any("after 2 poses" in line for line in recording.warnings)
        poses = [topic for topic in recording.topics if topic.role == "pose"]
        assert [topic.count for topic in poses] == [2]


def test_no_depth_images(build: Callable[[str], Any]) -> None:
    sample = build("slambook")
    for file in (sample.path / "depth").iterdir():
        file.unlink()
    with pytest.raises(RecordingError, match="no depth images"):
        open_recording(sample.path)
