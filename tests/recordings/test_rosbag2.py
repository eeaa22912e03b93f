"""ROS 2 folders whose metadata.yaml and files disagree."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.formats import open_recording


def edit(folder: Path, old: str, new: str) -> None:
    file = folder / "metadata.yaml"
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


@pytest.mark.parametrize("name", ["rosbag2 mcap", "rosbag2 sqlite"])
def test_the_files_are_right_where_counts_disagree(build: Callable[[str], Any], name: str) -> None:
    sample = build(name)
    edit(sample.path, "message_count: 13", "message_count: 0")
    with open_recording(sample.path) as recording:
        assert {t.name: t.count for t in recording.topics}["/scan"] == 13
        assert len(list(recording.messages(["/scan"]))) == 13
        assert len(recording.warnings) == 1
        assert "/scan 0 against 13" in recording.warnings[0]


def test_metadata_that_cannot_be_read(build: Callable[[str], Any]) -> None:
    sample = build("rosbag2 mcap")
    (sample.path / "metadata.yaml").write_text("a: [1, 2")
    with open_recording(sample.path) as recording:
        assert len(list(recording.messages())) == len(sample.written)
        assert "metadata.yaml cannot be read" in recording.warnings[0]


def test_a_file_that_metadata_names_and_that_is_missing(build: Callable[[str], Any]) -> None:
    sample = build("rosbag2 mcap")
    edit(sample.path, "relative_file_paths:", "relative_file_paths:\n  - lost_1.mcap")
    with open_recording(sample.path) as recording:
        assert len(list(recording.messages())) == len(sample.written)
        assert "lost_1.mcap" in recording.warnings[0]


@pytest.mark.parametrize("mode", ["file", "MESSAGE"])
def test_outer_compression_is_refused_by_name(build: Callable[[str], Any], mode: str) -> None:
    sample = build("rosbag2 mcap")
    edit(sample.path, "compression_mode: ''", f"compression_mode: {mode}")
    with pytest.raises(RecordingError, match=f"compressed by {mode.lower()}"):
        open_recording(sample.path)


def test_unrelated_files_without_metadata(build: Callable[[str], Any]) -> None:
    sample = build("split mcap, no metadata")
    (sample.path / "split_3.mcap").rename(sample.path / "another_3.mcap")
    with pytest.raises(RecordingError, match="several recordings"):
        open_recording(sample.path)
