"""`info --check`: damage that an index does not show."""

import json
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, Writer

from fusion_core.recordings.formats import open_recording
from scanloom.cli import main
from tests.hostile.bags import (
    T0_NS,
    ros_time,
    small_bag,
    u32,
    write_flipped_mcap,
    write_mcap,
)

FORMATS = [
    "rosbag1",
    "rosbag1 lz4",
    "mcap zstd",
    "mcap plain",
    "mcap without summary",
    "db3",
]
PLACES = [(place + 0.5) / 12 for place in range(12)]


def info(capsys: pytest.CaptureFixture[str], *args: str) -> tuple[int, dict[str, Any]]:
    code = main(["info", *args, "--json"])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
@pytest.mark.parametrize("fraction", PLACES)
def test_a_flipped_byte_in_a_chunk_is_found(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    fraction: float,
    compression: CompressionType,
) -> None:
    path = write_flipped_mcap(tmp_path / "a.mcap", fraction, compression)
    code, quick = info(capsys, str(path))
    assert code == 0
    assert quick["check"] is None
    code, checked = info(capsys, str(path), "--check")
    assert code == 1
    # The index knows them all, but those of one chunk cannot be read.
    assert checked["topics"] == quick["topics"]
    found = checked["check"]
    assert found["damaged"]
    lost = {topic["name"]: topic["unreadable"] for topic in found["topics"]}
    assert 1 <= sum(lost.values()) == found["unreadable"] <= 6
    assert found["read"] + found["unreadable"] == 16
    for name, count in lost.items():
        reported = [
            line for line in checked["warnings"] if line.startswith(f"{name}: {count} of 8")
        ]
        assert bool(reported) == bool(count)
        assert all("the chunk at byte" in line and str(path) in line for line in reported)


def test_the_report_says_what_was_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.mcap"
    write_mcap(path)
    assert main(["info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "\nchecked   no: --check reads every message and verifies all checksums" in shown
    assert main(["info", str(path), "--check"]) == 0
    shown = capsys.readouterr().out
    assert "\nchecked   whole: 16 messages read, 0 unreadable; checksums correct: 5\n" in shown
    write_mcap(path, with_checksums=False)
    assert main(["info", str(path), "--check"]) == 0
    assert "no checksums, so changed values are not detected" in capsys.readouterr().out
    write_flipped_mcap(path, 0.5)
    assert main(["info", str(path), "--check"]) == 1
    shown = capsys.readouterr().out
    assert "\nchecked   damaged: 10 messages read, 6 unreadable; checksums correct: 4\n" in shown
    assert "/scan  lidar  8      3           10.00" in shown


@pytest.mark.parametrize("name", FORMATS)
def test_undamaged_recordings_of_every_format_pass(
    build: Callable[[str], Any], capsys: pytest.CaptureFixture[str], name: str
) -> None:
    sample = build(name)
    with open_recording(sample.path) as recording:
        read = sum(1 for _ in recording.messages())
        quick = [*recording.warnings]
    code, checked = info(capsys, str(sample.path), "--check")
    assert code == (1 if quick else 0)
    assert checked["check"]["unreadable"] == 0
    assert checked["check"]["read"] == read == len(sample.written)


def test_index_data_that_contradict_a_chunk(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = small_bag()
    path = tmp_path / "a.bag"
    # The second scan's log time, in the index behind its chunk alone.
    right = ros_time(T0_NS + 10**8)
    at = whole.content.rindex(right, 0, whole.chunk_starts[1])
    wrong = ros_time(T0_NS + 10**8 + 1)
    path.write_bytes(whole.content[:at] + wrong + whole.content[at + 8 :])
    code, quick = info(capsys, str(path))
    assert (code, quick["warnings"]) == (0, [])
    code, checked = info(capsys, str(path), "--check")
    assert code == 1
    assert checked["check"]["unreadable"] == 0
    assert checked["check"]["damage"] == [
        "a.bag: Damaged: the chunk at byte 4109: its index is wrong about 1 of its 5 messages."
    ]
    path.write_bytes(whole.content)
    code, checked = info(capsys, str(path), "--check")
    assert (code, checked["check"]["damaged"], checked["check"]["unguarded"]) == (0, False, 4)


def test_a_chunk_of_a_bag_with_a_checksum(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = small_bag(b"lz4")
    path = tmp_path / "a.bag"
    path.write_bytes(whole.content)
    code, checked = info(capsys, str(path), "--check")
    assert (code, checked["check"]["checksums"], checked["check"]["unguarded"]) == (0, 4, 0)
    at = whole.chunk_starts[1] + 400
    flipped = bytes([whole.content[at] ^ 1])
    path.write_bytes(whole.content[:at] + flipped + whole.content[at + 1 :])
    code, quick = info(capsys, str(path))
    assert (code, quick["warnings"]) == (0, [])
    code, checked = info(capsys, str(path), "--check")
    assert (code, checked["check"]["unreadable"], checked["check"]["checksums"]) == (1, 5, 3)


def test_a_database_whose_index_disagrees_with_its_rows(
    build: Callable[[str], Any], capsys: pytest.CaptureFixture[str]
) -> None:
    path = build("db3").path
    connection = sqlite3.connect(path)
    connection.execute("CREATE INDEX by_time ON messages (timestamp ASC)")
    connection.commit()
    (page,) = connection.execute(
        "SELECT rootpage FROM sqlite_master WHERE name = 'by_time'"
    ).fetchone()
    (size,) = connection.execute("PRAGMA page_size").fetchone()
    connection.close()
    code, whole = info(capsys, str(path), "--check")
    assert (code, whole["check"]["damage"]) == (0, [])
    content = bytearray(path.read_bytes())
    content[page * size - 3] ^= 1
    path.write_bytes(content)
    code, quick = info(capsys, str(path))
    assert (code, quick["warnings"]) == (0, [])
    code, checked = info(capsys, str(path), "--check")
    assert code == 1
    assert "by_time" in checked["check"]["damage"][0]
    assert checked["check"]["unreadable"] == 0


def test_a_truncated_image(build: Callable[[str], Any], capsys: pytest.CaptureFixture[str]) -> None:
    sample = build("TUM RGB-D")
    image = sorted((sample.path / "depth").iterdir())[1]
    image.write_bytes(image.read_bytes()[:40])
    code, quick = info(capsys, str(sample.path))
    assert (code, quick["check"]) == (0, None)
    code, checked = info(capsys, str(sample.path), "--check")
    assert code == 1
    assert checked["check"]["unreadable"] == 1
    assert any(image.name in warning for warning in checked["warnings"])


def test_the_checksum_of_all_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # The flipped byte is in no chunk and not used by a reader.
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, enable_data_crcs=True)
        writer.start(profile="ros2", library="library of the test")
        writer.finish()
    code, checked = info(capsys, str(path), "--check")
    assert (code, checked["check"]["checksums"]) == (0, 2)
    path.write_bytes(path.read_bytes().replace(b"library of", b"librarx of"))
    code, checked = info(capsys, str(path), "--check")
    assert code == 1
    assert "the checksum of its first" in checked["check"]["damage"][0]


@pytest.mark.parametrize("with_checksums", [True, False])
def test_a_topic_renamed_in_a_summary_keeps_its_name(tmp_path: Path, with_checksums: bool) -> None:
    path = tmp_path / "a.mcap"
    write_mcap(path, with_checksums=with_checksums)
    content = path.read_bytes()
    name = u32(3) + b"/tf"
    at = content.rindex(name)
    assert content.count(name) == 2
    path.write_bytes(content[:at] + u32(3) + b"/uo" + content[at + 7 :])
    with open_recording(path) as recording:
        assert {topic.name: topic.count for topic in recording.topics} == {"/scan": 8, "/tf": 8}
        assert len(list(recording.messages())) == 16
        (warning,) = recording.warnings
        assert "and none is lost" in warning
