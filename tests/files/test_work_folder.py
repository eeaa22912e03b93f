"""One run at a time works in a folder, and leaves nothing there."""

from pathlib import Path

import pytest

from fusion_core.files.work_folder import WORK_NAME, work_folder
from fusion_core.model.errors import ExportError


def test_a_new_folder_without_results_is_removed(tmp_path: Path) -> None:
    with work_folder(tmp_path / "out") as work:
        assert work.is_dir()
        (work / "a").write_text("half")
    assert list(tmp_path.iterdir()) == []


def test_existing_files_stay(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("1")
    with work_folder(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_second_run_is_refused_and_changes_nothing(tmp_path: Path) -> None:
    with work_folder(tmp_path / "out") as work:
        (work / "a").write_text("1")
        with pytest.raises(ExportError, match="is being written by another run"):
            work_folder(tmp_path / "out").__enter__()
        assert (work / "a").read_text() == "1"
    with work_folder(tmp_path / "out") as work:
        assert list(work.iterdir()) == []


def test_what_a_killed_run_left_is_cleared(tmp_path: Path) -> None:
    left = tmp_path / WORK_NAME
    (left / "results" / "figures").mkdir(parents=True)
    (left / "results" / "figures" / "1.png").write_text("half")
    (left / "manifest.json").write_text("half")
    (left / "lock").touch()
    with work_folder(tmp_path) as work:
        assert list(work.iterdir()) == []
    assert list(tmp_path.iterdir()) == []


def test_links_in_it_are_not_followed(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "a").write_text("1")
    out = tmp_path / "out"
    (out / WORK_NAME).mkdir(parents=True)
    (out / WORK_NAME / "results").symlink_to(kept)
    with work_folder(out):
        pass
    (out / WORK_NAME).symlink_to(kept)
    with pytest.raises(ExportError, match="is a link"):
        work_folder(out).__enter__()
    assert (kept / "a").read_text() == "1"


def test_a_folder_that_cannot_be_created_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to("loop")
    for name in ("file/out", "loop", "loop/out"):
        with pytest.raises(ExportError, match="cannot be made"):
            work_folder(tmp_path / name).__enter__()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "loop"]
