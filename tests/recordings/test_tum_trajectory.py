"""Trajectory files: what is read exactly, what is corrected, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.tum_trajectory import read_tum_trajectory

ORIGIN = "0 0 0 0 0 0 1"


def written(folder: Path, *lines: str) -> Path:
    file = folder / "trajectory.tum"
    file.write_text("\n".join(lines), encoding="utf-8")
    return file


def test_stamps_are_exact_and_poses_map_the_body_to_the_map(tmp_path: Path) -> None:
    file = written(
        tmp_path,
        "# timestamp tx ty tz qx qy qz qw",
        "",
        "1700000000.000000001 1 2 3 0 0 0.7071 0.7071",
        "1700000000.000000002\t-1\t0\t0 0 0 0 1",
        "1.8e9 0 0 0 1 0 0 0",
    )
    read = read_tum_trajectory(file)
    assert read.warnings == ()
    assert read.trajectory.stamps_ns.tolist() == [
        1_700_000_000_000_000_001,
        1_700_000_000_000_000_002,
        1_800_000_000_000_000_000,
    ]
    quarter_turn = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    assert np.allclose(read.trajectory.T_map_body[0], quarter_turn, atol=1e-12)
    half_turn_about_x = np.diag([1.0, -1.0, -1.0, 1.0])
    assert np.allclose(read.trajectory.T_map_body[2], half_turn_about_x, atol=1e-12)


def test_lines_are_sorted_and_the_first_of_one_stamp_is_kept(tmp_path: Path) -> None:
    moved = [f"{stamp} {x} 0 0 0 0 0 1" for stamp, x in ((3, 30), (1, 10), (3, 31), (2, 20))]
    read = read_tum_trajectory(written(tmp_path, *moved))
    assert read.trajectory.stamps_ns.tolist() == [1_000_000_000, 2_000_000_000, 3_000_000_000]
    assert read.trajectory.T_map_body[:, 0, 3].tolist() == [10.0, 20.0, 30.0]
    unsorted, repeated = read.warnings
    assert "trajectory.tum: its stamps do not ascend" in unsorted
    assert "because another has their stamp: 1." in repeated


def test_a_repeated_stamp_alone_does_not_count_as_unsorted(tmp_path: Path) -> None:
    read = read_tum_trajectory(written(tmp_path, f"1 {ORIGIN}", f"1 {ORIGIN}", f"2 {ORIGIN}"))
    assert read.warnings == ("trajectory.tum: lines left out because another has their stamp: 1.",)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 0 0 0 0 0 0", "has 7 fields, not 8"),
        ("1,0,0,0,0,0,0,1", "has 1 fields, not 8"),
        ("now " + ORIGIN, "'now' is no time in seconds"),
        ("-1 " + ORIGIN, "'-1' is no time in seconds"),
        ("1e30 " + ORIGIN, "'1e30' is no time in seconds"),
        ("1 x 0 0 0 0 0 1", "'x' is no number"),
        ("1 nan 0 0 0 0 0 1", "'nan' is not between"),
        ("1 0 inf 0 0 0 0 1", "'inf' is not between"),
        ("1 0 0 1e200 0 0 0 1", "'1e200' is not between"),
        ("1 0 0 0 0 0 0 0", "the quaternion has the length 0, not 1"),
        ("1 0 0 0 0 0 1 1", "the quaternion has the length 1.41, not 1"),
        ("1 0 0 0 0 0 0 " + "1" * 100, f"'{'1' * 40}…' is not between"),
        ("1 \udcff 0 0 0 0 0 1", "is no number"),
    ],
)
def test_a_line_that_is_no_pose_is_named(line: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "trajectory.tum"
    content = f"# comment\n0 {ORIGIN}\n{line}\n"
    file.write_bytes(content.encode(errors="surrogateescape"))
    with pytest.raises(RecordingError) as refused:
        read_tum_trajectory(file)
    assert str(refused.value).startswith(f"{file}: line 3: ")
    assert words in refused.value.problem
    assert refused.value.advice == "Each line holds stamp x y z qx qy qz qw."
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("content", ["", "# only\n\n  # comments\n"])
def test_a_file_without_poses_is_refused(content: str, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="holds no lines"):
        read_tum_trajectory(written(tmp_path, content))


def test_an_endless_line_is_refused_by_a_part_of_it(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="line 1: has 2048 fields"):
        read_tum_trajectory(written(tmp_path, "0 " * 1_000_000))
