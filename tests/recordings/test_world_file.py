"""World files: round trips, and a clear error for what is no world file."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.model.errors import ExportError, RecordingError
from fusion_core.model.world_outline import (
    MeasuredAngle,
    MeasuredLine,
    ObstacleOutline,
    WorldOutline,
)
from fusion_core.recordings.world_file import read_world, world_path, write_world

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])


def world() -> WorldOutline:
    return WorldOutline(
        robot_height_m=0.55,
        obstacles=(
            ObstacleOutline(
                name="box",
                z_min_m=0.0,
                z_max_m=0.4,
                outline_m=SQUARE.copy(),
                seen_by={"lidar": np.array([[0, 10], [20, 400]]), "camera": np.zeros((0, 2), int)},
            ),
        ),
        lines=(MeasuredLine(name="line", faces_m=np.stack([SQUARE[:2], SQUARE[3:1:-1]])),),
        angles=(MeasuredAngle(name="angle", arms_m=np.stack([SQUARE[:2], SQUARE[[0, 3]]])),),
    )


def test_what_is_written_is_read(tmp_path: Path) -> None:
    file = world_path(tmp_path / "room.mcap")
    assert file.name == "room.world.json"
    write_world(file, world())
    first = file.read_bytes()
    read = read_world(file)
    (box,) = read.obstacles
    assert (box.name, box.z_min_m, box.z_max_m) == ("box", 0.0, 0.4)
    np.testing.assert_array_equal(box.outline_m, SQUARE)
    assert np.flatnonzero(~box.seen_samples("lidar")).tolist() == list(range(10, 20))
    assert not box.seen_samples("camera").any()
    assert read.lines[0].length_m == pytest.approx(1.0)
    assert np.degrees(read.angles[0].angle_rad) == pytest.approx(90.0)
    write_world(file, read)
    assert file.read_bytes() == first
    assert list(tmp_path.iterdir()) == [file]


def stated(tmp_path: Path, **changes: Any) -> Path:
    file = tmp_path / "a.world.json"
    write_world(file, world())
    content = json.loads(file.read_text())
    for key, value in changes.items():
        where = content
        *path, last = key.split("__")
        for step in path:
            where = where[int(step)] if step.isdigit() else where[step]
        where[int(last) if last.isdigit() else last] = value
    file.write_text(json.dumps(content))
    return file


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"format": "something"}, "format: "),
        ({"version": 2}, "of version 2"),
        ({"version": "1"}, "version: "),
        ({"units": "mm"}, "units: "),
        ({"robot_height_m": -1.0}, "robot_height_m: "),
        ({"obstacles": {}}, "obstacles: "),
        ({"obstacles__0__outline": [[0, 0]]}, "obstacles.0.outline: "),
        ({"obstacles__0__outline": [[0, 0], [0, 0]]}, "has no length"),
        ({"obstacles__0__outline__1__0": "1"}, "obstacles.0.outline.1.0: "),
        ({"obstacles__0__outline__1__0": 1e300}, "obstacles.0.outline.1.0: "),
        ({"obstacles__0__outline__1__0": float("nan")}, "finite number"),
        ({"obstacles__0__outline": [[-1e6, 0], [1e6, 0]]}, "longer than 100000 m"),
        ({"obstacles__0__z_max_m": -1}, "has a height from 0.0 m to -1.0 m"),
        ({"obstacles__0__seen_by__lidar": [[5, 3]]}, "runs of lidar must ascend"),
        ({"obstacles__0__seen_by__lidar": [[0, 401]]}, "within 0 to 400"),
        ({"obstacles__0__seen_by__lidar": [[0, 10**30]]}, "obstacles.0.seen_by.lidar.0.1: "),
        ({"lines__0__faces__0": [[0, 0], [1, 1]]}, "faces of line are not parallel"),
        ({"angles__0__arms__1": [[0, 0], [0, 0]]}, "has no length"),
    ],
)
def test_what_is_no_world_is_named(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    file = stated(tmp_path, **changes)
    with pytest.raises(RecordingError) as caught:
        read_world(file)
    assert words in str(caught.value)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"null", b"\xff\xfe", b"[" * 100_000])
def test_what_is_no_json_object_is_named(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "bad.world.json"
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"bad\.world\.json"):
        read_world(file)


def test_a_cut_file_is_no_world(tmp_path: Path) -> None:
    file = stated(tmp_path)
    whole = file.read_bytes()
    for size in range(0, len(whole) - 2, 37):
        file.write_bytes(whole[:size])
        with pytest.raises(RecordingError):
            read_world(file)


def test_a_huge_file_is_not_read(tmp_path: Path) -> None:
    file = tmp_path / "huge.world.json"
    with file.open("wb") as stream:
        stream.truncate(1 << 32)
    with pytest.raises(OSError, match="is larger than"):
        read_world(file)


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="nowhere"):
        write_world(tmp_path / "nowhere" / "a.world.json", world())
