"""The label store of a recording, and how its files are told from others without reading them."""

import os
from pathlib import Path

import numpy as np
import pytest

from fusion_core.annotation.identity import Author
from fusion_core.annotation.store import LabelStore
from fusion_core.exporting import manifest
from fusion_core.model.errors import ExportError, LabelStoreError, RecordingError
from fusion_core.model.labels import Capture, CaptureLabels
from fusion_core.recordings.formats import is_recording, open_recording
from fusion_core.workflows.labels.open_store import open_labels

LABELS = CaptureLabels.of_samples(
    Capture("lidar", "/scan", 1, 0, 1, 9), np.zeros(2, int), np.array([3, 5]), 2
)


@pytest.fixture(params=["file", "folder", "sequence"])
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A file, a folder, or a file with a folder beside it; what is in them is of no account."""
    path = (
        tmp_path
        / "given"
        / {"file": "room.mcap", "folder": "room", "sequence": "room.txt"}[request.param]
    )
    path.parent.mkdir()
    if request.param != "folder":
        path.write_bytes(b"messages")
    if request.param != "file":
        images = path.with_suffix("") / "depth"
        images.mkdir(parents=True)
        for name in ("1.png", "2.png"):
            (images / name).write_bytes(name.encode())
    return path


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files that are hashed from now on."""
    names: list[str] = []
    original = manifest.sha256_of_file

    def hashed(path: Path) -> str:
        names.append(path.name)
        return original(path)

    monkeypatch.setattr(manifest, "sha256_of_file", hashed)
    return names


def files_of(recording: Path) -> list[Path]:
    return sorted(
        file for file in recording.parent.rglob("*") if file.suffix != ".sqlite" and file.is_file()
    )


def test_the_store_lies_beside_the_recording(recording: Path) -> None:
    with pytest.raises(LabelStoreError, match="does not exist"):
        open_labels(recording, create=False)
    with open_labels(recording, create=True) as store:
        store.label("anna", [LABELS], Author("anna"))
    assert (recording.parent / f"{recording.name}.labels.sqlite").is_file()
    with open_labels(recording, create=False) as store:
        assert store.labels_of("anna", LABELS.capture).column.tolist() == [3, 5]


def test_a_second_opening_reads_nothing(recording: Path, read: list[str]) -> None:
    reported: list[int] = []
    open_labels(
        recording, create=True, progress=lambda done, total, what: reported.append(done)
    ).close()
    names = [file.name for file in files_of(recording)]
    assert sorted(read) == sorted(names)
    assert len(reported) == len(names)
    read.clear()
    open_labels(recording, create=False).close()
    assert read == []


def test_what_has_changed_is_read_again_and_refused(recording: Path, read: list[str]) -> None:
    open_labels(recording, create=True).close()
    changed = files_of(recording)[-1]
    state = changed.stat()
    read.clear()
    # As it was: only its time is another.
    os.utime(changed, ns=(state.st_atime_ns, state.st_mtime_ns + 1))
    open_labels(recording, create=False).close()
    assert read == [changed.name]
    changed.write_bytes(b"another!")
    with pytest.raises(LabelStoreError, match="holds the labels of"):
        open_labels(recording, create=True)
    changed.unlink()
    with pytest.raises((LabelStoreError, RecordingError)):
        open_labels(recording, create=True)


def test_a_store_is_no_recording(tmp_path: Path) -> None:
    (tmp_path / "room.mcap").write_bytes(b"1")
    store = Path(open_labels(tmp_path / "room.mcap", create=True).place)
    assert not is_recording(store)
    with pytest.raises(RecordingError, match="is no recording: labels of a recording"):
        open_recording(store)


def test_a_folder_with_a_file_renamed_is_another_recording(tmp_path: Path) -> None:
    recording = tmp_path / "room"
    recording.mkdir()
    (recording / "a").write_bytes(b"1")
    open_labels(recording, create=True).close()
    (recording / "a").rename(recording / "b")
    with pytest.raises(LabelStoreError, match="holds the labels of"):
        open_labels(recording, create=True)


def test_a_renamed_file_keeps_its_labels(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"1")
    open_labels(tmp_path / "a.mcap", tmp_path / "team.sqlite", create=True).close()
    (tmp_path / "a.mcap").rename(tmp_path / "b.mcap")
    open_labels(tmp_path / "b.mcap", tmp_path / "team.sqlite", create=False).close()


def test_links_to_a_recording_share_its_labels(tmp_path: Path) -> None:
    (tmp_path / "room.mcap").write_bytes(b"1")
    (tmp_path / "links").mkdir()
    link = tmp_path / "links" / "other.mcap"
    link.symlink_to(tmp_path / "room.mcap")
    open_labels(link, create=True).close()
    assert (tmp_path / "room.mcap.labels.sqlite").is_file()


def test_a_store_inside_the_recording_is_refused(tmp_path: Path) -> None:
    recording = tmp_path / "room"
    recording.mkdir()
    (recording / "a").write_bytes(b"1")
    with pytest.raises(ExportError, match="lies inside the input room"):
        open_labels(recording, recording / "labels.sqlite", create=True)
    with pytest.raises(ExportError, match="is read as the input a"):
        open_labels(recording / "a", recording / "a", create=True)
    with pytest.raises(RecordingError, match="does not exist"):
        open_labels(tmp_path / "none", create=True)
    assert [file.name for file in recording.iterdir()] == ["a"]


def test_several_copies_of_a_recording_share_one_cache(tmp_path: Path, read: list[str]) -> None:
    copies = [tmp_path / name / "room.mcap" for name in ("anna", "ben")]
    for number, copy in enumerate(copies):
        copy.parent.mkdir()
        copy.write_bytes(b"messages")
        os.utime(copy, ns=(number, number))
    team = tmp_path / "team.sqlite"
    for copy in copies * 2:
        LabelStore.close(open_labels(copy, team, create=True))
    assert read == ["room.mcap"] * 2
