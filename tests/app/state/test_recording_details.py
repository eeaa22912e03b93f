"""Format, length and streams of listed recordings, read in the background and kept."""

import os
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from scanloom.jobs.activity import Activity
from scanloom.state import recording_details
from scanloom.state.recording_details import DetailsReader, read_details
from tests.patience import ENOUGH_S


@pytest.fixture
def reader() -> Iterator[DetailsReader]:
    reader = DetailsReader(Activity())
    yield reader
    reader.close()


class Reads:
    """Counts how often details are read."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.paths: list[Path] = []
        self._read = recording_details.read_details
        monkeypatch.setattr(recording_details, "read_details", self)

    def __call__(self, path: Path) -> recording_details.RecordingDetails:
        self.paths.append(path)
        return self._read(path)


def read(reader: DetailsReader, *paths: Path) -> None:
    """Have them read, and wait for it."""
    ended = threading.Semaphore(0)
    reader.request("ann", paths, ended.release)
    for _ in paths:
        assert ended.acquire(timeout=ENOUGH_S)


def test_details_are_words_and_numbers(small_scene: Path) -> None:
    details = read_details(small_scene)
    assert details.format == "MCAP file"
    assert details.duration_s == pytest.approx(2.0, abs=0.2)
    assert details.streams == ("LiDAR", "depth", "colour", "odometry")
    assert details.size_bytes == small_scene.stat().st_size
    assert details.problem == ""


def test_a_damaged_file_has_a_reason_in_one_line(tmp_path: Path, small_scene: Path) -> None:
    path = tmp_path / "broken.mcap"
    path.write_bytes(small_scene.read_bytes()[:2_000])
    details = read_details(path)
    assert details.problem.startswith("is cut short or damaged")
    assert "\n" not in details.problem
    assert details.size_bytes == 2_000


def test_an_unexpected_failure_is_one_of_its_file(
    small_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(recording_details, "open_source", fail)
    assert read_details(small_scene).problem == "cannot be read (ZeroDivisionError)."


def test_large_packed_files_are_not_unpacked_for_a_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "log.gz"
    path.write_bytes(b"\x1f\x8b\x08" + b"x" * 100)
    monkeypatch.setattr(recording_details, "_MAX_PACKED_BYTES", 50)
    assert read_details(path).format == "packed: not looked into"


def test_a_file_is_read_again_only_after_a_change(
    reader: DetailsReader, tmp_path: Path, small_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads = Reads(monkeypatch)
    path = tmp_path / "a.mcap"
    shutil.copyfile(small_scene, path)
    assert reader.get(path) is None
    read(reader, path)
    read(reader, path)
    assert reads.paths == [path]
    os.truncate(path, 2_000)
    read(reader, path)
    assert reads.paths == [path, path]
    details = reader.get(path)
    assert details is not None
    assert details.problem


def test_a_later_list_takes_the_place_of_the_one_before(
    reader: DetailsReader, tmp_path: Path, small_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads = Reads(monkeypatch)
    paths = [tmp_path / f"{number}.mcap" for number in range(3)]
    for path in paths:
        shutil.copyfile(small_scene, path)
    began, go_on, ended = threading.Event(), threading.Event(), threading.Event()

    def hold() -> None:
        began.set()
        assert go_on.wait(ENOUGH_S)

    reader.request("ann", paths[:2], hold)
    assert began.wait(ENOUGH_S)
    reader.request("ann", paths[2:], ended.set)
    go_on.set()
    assert ended.wait(ENOUGH_S)
    assert reads.paths == [paths[0], paths[2]]


def test_the_oldest_details_are_dropped(
    reader: DetailsReader, tmp_path: Path, small_scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording_details, "_MAX_KEPT", 2)
    paths = [tmp_path / f"{number}.mcap" for number in range(3)]
    for path in paths:
        shutil.copyfile(small_scene, path)
    read(reader, *paths)
    assert [reader.get(path) is None for path in paths] == [True, False, False]
