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


def test_messages_packed_in_an_unknown_way_are_refused_by_name(build: Callable[[str], Any]) -> None:
    sample = build("rosbag2 mcap")
    edit(sample.path, "compression_mode: ''", "compression_mode: MESSAGE")
    edit(sample.path, "compression_format: ''", "compression_format: fake_comp")
    with pytest.raises(RecordingError, match="compressed by fake_comp"):
        open_recording(sample.path)


@pytest.mark.parametrize("mode", ["file", "MESSAGE"])
def test_files_are_right_where_metadata_claims_compression(
    build: Callable[[str], Any], mode: str
) -> None:
    sample = build("rosbag2 mcap")
    edit(sample.path, "compression_mode: ''", f"compression_mode: {mode}")
    edit(sample.path, "compression_format: ''", "compression_format: zstd")
    with open_recording(sample.path) as recording:
        assert len(list(recording.messages())) == len(sample.written)


def test_unrelated_files_without_metadata(build: Callable[[str], Any]) -> None:
    sample = build("split mcap, no metadata")
    (sample.path / "split_3.mcap").rename(sample.path / "another_3.mcap")
    with pytest.raises(RecordingError, match="several recordings"):
        open_recording(sample.path)


def metadata_of(folder: Path, files: list[str], more: str = "") -> None:
    listed = "".join(f"    - {file}\n" for file in files)
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 4\n  relative_file_paths:\n{listed}{more}"
    )


@pytest.mark.parametrize("named", [True, False])
def test_a_missing_part_loses_only_its_own_messages(
    build: Callable[[str], Any], named: bool
) -> None:
    sample = build("split mcap, no metadata")
    if named:
        metadata_of(sample.path, [f"split/split_{i}.mcap" for i in range(12)])
    (sample.path / "split_4.mcap").unlink()
    with open_recording(sample.path) as recording:
        assert len(list(recording.messages())) == len(sample.written) - 9
        said = "names files that are missing: split_4.mcap" if named else "are missing: split_4."
        assert any(said in warning for warning in recording.warnings)


def test_parts_that_are_missing_are_named_from_to(build: Callable[[str], Any]) -> None:
    sample = build("split mcap, no metadata")
    for part in (3, 4, 5, 9):
        (sample.path / f"split_{part}.mcap").unlink()
    with open_recording(sample.path) as recording:
        assert recording.warnings == [
            "Parts of the recording are missing: split_3 to split_5.",
            "Parts of the recording are missing: split_9.",
        ]


@pytest.mark.parametrize("content", [b"", b"text", bytes(5000)])
def test_a_damaged_part_loses_only_its_own_messages(
    build: Callable[[str], Any], content: bytes
) -> None:
    sample = build("split mcap, no metadata")
    (sample.path / "split_4.mcap").write_bytes(content)
    with open_recording(sample.path) as recording:
        assert len(list(recording.messages())) == len(sample.written) - 9
        (warning,) = recording.warnings
        assert warning.startswith("split_4.mcap is left out: ")


def test_a_folder_of_broken_parts_is_refused(build: Callable[[str], Any]) -> None:
    sample = build("split mcap, no metadata")
    for file in sample.path.iterdir():
        file.write_bytes(b"text")
    with pytest.raises(RecordingError, match="split_0"):
        open_recording(sample.path)


def test_parts_that_metadata_does_not_list(build: Callable[[str], Any]) -> None:
    sample = build("split mcap, no metadata")
    metadata_of(sample.path, ["split_0.mcap", "split_1.mcap"])
    (sample.path / "another_3.mcap").write_bytes((sample.path / "split_3.mcap").read_bytes())
    with open_recording(sample.path) as recording:
        assert len(list(recording.messages())) == len(sample.written)
        assert any("does not name split_2.mcap, " in warning for warning in recording.warnings)
        assert any("left out: another_3.mcap" in warning for warning in recording.warnings)


def merges(levels: int) -> str:
    lines = ["a0: &a0 {k: v}"]
    for i in range(1, levels):
        lines.append(f"a{i}: &a{i} {{<<: [{','.join([f'*a{i - 1}'] * 10)}]}}")
    return "\n".join(lines)


def laughs(levels: int) -> str:
    lines = ["a0: &a0 [lol, lol]"]
    lines += [f"a{i}: &a{i} [{','.join([f'*a{i - 1}'] * 10)}]" for i in range(1, levels)]
    topic = f"{{topic_metadata: {{name: *a{levels - 1}}}, message_count: 1}}"
    return "\n".join(
        [
            *lines,
            "rosbag2_bagfile_information:",
            "  relative_file_paths: [sample.mcap]",
            f"  topics_with_message_count: [{topic}]",
        ]
    )


HOSTILE_METADATA = {
    "merge keys": merges(30),
    "aliases": laughs(30),
    "nesting": "[" * 20_000,
    "a tree tied to itself": "rosbag2_bagfile_information: &a\n  relative_file_paths: [*a]",
    "a name of two lines": 'rosbag2_bagfile_information: {relative_file_paths: ["a\\nb"]}',
    "a long name": "rosbag2_bagfile_information: {relative_file_paths: [" + "a" * 5000 + "]}",
    "a huge number": "rosbag2_bagfile_information: {version: " + "9" * 100_000 + "}",
    "a count of text": "rosbag2_bagfile_information: {relative_file_paths: [sample.mcap],"
    " topics_with_message_count: [{topic_metadata: {name: a}, message_count: b}]}",
    "too long": "#" * (2 << 20),
    "no text": "\udcff\udcfe",
    "a list": "- 1",
    "nothing": "",
}


@pytest.mark.parametrize("name", HOSTILE_METADATA)
def test_hostile_metadata_is_ignored_with_a_warning(build: Callable[[str], Any], name: str) -> None:
    sample = build("rosbag2 mcap")
    text = HOSTILE_METADATA[name]
    (sample.path / "metadata.yaml").write_bytes(text.encode(errors="surrogateescape"))
    with open_recording(sample.path) as recording:
        assert len(list(recording.messages())) == len(sample.written)
        (warning,) = recording.warnings
        assert warning == "metadata.yaml cannot be read; the files themselves were scanned."


def test_names_in_metadata_stay_in_the_folder(build: Callable[[str], Any], tmp_path: Path) -> None:
    sample = build("rosbag2 mcap")
    (tmp_path / "outside.mcap").write_bytes(b"text")
    metadata_of(sample.path, ["../outside.mcap", "..", "sample.mcap"])
    with open_recording(sample.path) as recording:
        assert len(list(recording.messages())) == len(sample.written)
        assert any("missing: outside.mcap, .." in warning for warning in recording.warnings)


def test_long_lists_are_cut(build: Callable[[str], Any]) -> None:
    sample = build("rosbag2 mcap")
    metadata_of(sample.path, ["sample.mcap", *(f"lost_{i}.mcap" for i in range(5000))])
    with open_recording(sample.path) as recording:
        assert any("lost_19.mcap and 4980 more" in warning for warning in recording.warnings)
