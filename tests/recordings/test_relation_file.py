"""Relation files: stamps, poses, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from fusion_core.model.errors import RecordingError
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.recordings.relation_file import read_relations


def test_stamps_are_exact_and_angles_are_roll_pitch_yaw(tmp_path: Path) -> None:
    file = tmp_path / "log.relations"
    file.write_text(
        "# t1 t2 x y z roll pitch yaw\n"
        "976052905.167303 976052911.885496001 -0.05 0.2 0.3 0.1 -0.2 2.5\n"
        "12 3 1 0 0 0 0 -1.5\n",
        encoding="utf-8",
    )
    relations = read_relations(file)
    assert relations.first_stamps_ns.tolist() == [976_052_905_167_303_000, 12_000_000_000]
    assert relations.second_stamps_ns.tolist() == [976_052_911_885_496_001, 3_000_000_000]
    rotation = rotation_from_yaw_pitch_roll(2.5, -0.2, 0.1)
    expected = make_transform(rotation, np.array([-0.05, 0.2, 0.3]))
    assert np.allclose(relations.T_first_second[0], expected, atol=1e-12)
    flat = make_transform(rotation_from_yaw_pitch_roll(-1.5, 0.0, 0.0), np.array([1.0, 0.0, 0.0]))
    assert np.allclose(relations.T_first_second[1], flat, atol=1e-12)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("1 2 0 0 0 0 0\n", "line 1: has 7 fields, not 8"),
        ("1 2 0 0 0 0 0 0\n1 soon 0 0 0 0 0 0\n", "line 2: 'soon' is no time"),
        ("1 2 0 0 0 0 0 yaw\n", "line 1: 'yaw' is no number"),
        ("# nothing\n", "holds no lines"),
    ],
)
def test_what_is_no_relation_is_named(content: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "log.relations"
    file.write_text(content, encoding="utf-8")
    with pytest.raises(RecordingError) as refused:
        read_relations(file)
    assert words in refused.value.problem
    assert refused.value.file == str(file)
    assert refused.value.advice == "Each line holds t1 t2 x y z roll pitch yaw."
