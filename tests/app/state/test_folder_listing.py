"""What a folder offers to open: recordings by content and folders, never what is outside."""

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fusion_core.model.errors import RecordingError
from scanloom.jobs.long_job import Cancelled
from scanloom.state import folder_listing
from scanloom.state.folder_listing import FolderPage, FolderPlace, read_page
from scanloom.state.library import Library
from scanloom.state.view import View
from tests.hostile.names import NO_UTF8, SHOWN

MCAP_MAGIC = b"\x89MCAP0\r\n"
HOSTILE = [
    '<img src=x onerror="window.taken = 1">.mcap',
    "![a](b) **bold**.mcap",
    "\"quotes\" and 'others'.mcap",
    "two\nlines\t.mcap",
    "\u202egpj.mcap",
    "\u05e9\u05dc\u05d5\u05dd.mcap",
    "a & b; c #1?x=%2e%2e.mcap",
    "a\\..\\up.mcap",
    f"{'l' * 240}.mcap",
]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A folder of recordings, of what is none, and of ways out."""
    root = tmp_path / "root"
    (root / "inner" / "deep").mkdir(parents=True)
    (root / ".hidden").mkdir()
    for name in ("a.mcap", ".b.mcap", ".hidden/c.mcap", "inner/d.mcap", "no suffix"):
        (root / name).write_bytes(MCAP_MAGIC)
    (root / "notes.mcap").write_text("only the name of a recording")
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "f.mcap").write_bytes(MCAP_MAGIC)
    (root / "to a").symlink_to(root / "a.mcap")
    (root / "to inner").symlink_to(root / "inner")
    (root / "to hidden").symlink_to(root / ".hidden")
    (root / "to outside").symlink_to(tmp_path / "outside")
    (root / "to f").symlink_to(tmp_path / "outside" / "f.mcap")
    (root / "loop").symlink_to(root / "loop")
    (root / "inner" / "back").symlink_to(root / "inner")
    os.mkfifo(root / "pipe")
    return root


def page_of(root: Path, folder: str = "", **more: Any) -> FolderPage:
    return read_page(FolderPlace(root=root, folder=root / folder, **more))


def labels(page: FolderPage) -> list[str]:
    return [row.label for row in page.rows]


def test_recordings_are_told_by_content_and_nothing_leads_out(root: Path) -> None:
    page = page_of(root)
    assert labels(page) == ["inner", "to inner", "a.mcap", "no suffix", "to a"]
    assert all(row.path.is_relative_to(root) for row in page.rows)
    assert {row.label for row in page.rows if row.is_recording} >= {"a.mcap", "no suffix", "to a"}
    assert page.left_out == 6
    assert page.next_start is None


def test_a_link_that_leads_around_is_entered_once_and_for_all(root: Path) -> None:
    (back,) = [row for row in page_of(root, "inner").rows if row.label == "back"]
    assert back.path == root / "inner"


def test_a_folder_of_bags_can_be_opened_and_entered(root: Path) -> None:
    (inner,) = [row for row in page_of(root).rows if row.label == "inner"]
    assert (inner.is_recording, inner.is_folder) == (True, True)
    # With a description it is one recording.
    (root / "inner" / "metadata.yaml").write_text("")
    (inner,) = [row for row in page_of(root).rows if row.label == "inner"]
    assert (inner.is_recording, inner.is_folder) == (True, False)


def test_a_folder_that_may_not_be_read_says_so(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Any) -> Any:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr("scanloom.state.allowed_paths.os.scandir", refuse)
    page = page_of(root)
    assert page.rows == ()
    assert page.problem == "This folder cannot be read: Permission denied."


def test_a_file_that_may_not_be_read_is_left_out(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = folder_listing.is_recording

    def refuse(path: Path) -> bool:
        if path.name == "a.mcap":
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return kept(path)

    monkeypatch.setattr(folder_listing, "is_recording", refuse)
    assert labels(page_of(root)) == ["inner", "to inner", "no suffix"]


def test_a_folder_that_has_gone_says_so(root: Path) -> None:
    shutil.rmtree(root / "inner")
    assert "No such file" in page_of(root, "inner").problem


def test_many_files_come_page_by_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(130):
        (tmp_path / f"{number:03}.mcap").write_bytes(MCAP_MAGIC)
    seen: list[str] = []
    start: int | None = 0
    pages = 0
    while start is not None:
        page = page_of(tmp_path, start=start)
        seen += labels(page)
        start = page.next_start
        pages += 1
    assert seen == [f"{number:03}.mcap" for number in range(130)]
    assert pages == 3
    # Folders of thousands of other files are not read to their end before something is shown.
    monkeypatch.setattr(folder_listing, "_MAX_EXAMINED", 40)
    page = page_of(tmp_path, start=100)
    assert (len(page.rows), page.next_start, page.count) == (30, None, 130)
    assert page_of(tmp_path).next_start == 40


def test_too_many_names_are_cut_and_it_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("allowed_paths", "folder_listing"):
        monkeypatch.setattr(f"scanloom.state.{module}.MAX_NAMES", 20)
    for number in range(30):
        (tmp_path / f"{number}.mcap").write_bytes(MCAP_MAGIC)
    page = page_of(tmp_path)
    assert page.count == 20
    assert "too many names" in page.problem


def test_names_are_found_by_a_part_of_them(root: Path) -> None:
    assert labels(page_of(root, find=" TO ")) == ["to inner", "to a"]
    assert page_of(root, find="nothing").rows == ()


def test_reading_ends_when_nobody_wants_it(root: Path) -> None:
    def check() -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        read_page(FolderPlace(root=root, folder=root), check)


# Names by which they are opened


@pytest.mark.parametrize("name", [*HOSTILE, NO_UTF8, f"{NO_UTF8}/{NO_UTF8}.mcap"])
def test_any_name_leads_to_its_file(tmp_path: Path, small_scene: Path, name: str) -> None:
    root = tmp_path.resolve()
    path = root / name
    path.parent.mkdir(exist_ok=True)
    shutil.copyfile(small_scene, path)
    library = Library([small_scene], [root])
    (row,) = page_of(root, str(Path(name).parent)).rows
    shown = library.name_of(row.path)
    assert shown is not None
    assert shown.encode("utf-8")
    assert library.path(shown) == path
    assert library.open(View(recording=shown)).fuse_session.recording.path == path
    library.close()


def test_a_name_that_leads_elsewhere_is_none(tmp_path: Path, small_scene: Path) -> None:
    (tmp_path / NO_UTF8).write_bytes(MCAP_MAGIC)
    (tmp_path / SHOWN).write_bytes(MCAP_MAGIC)
    library = Library([small_scene], [tmp_path])
    assert library.name_of(tmp_path / SHOWN) == SHOWN
    assert library.name_of(tmp_path / NO_UTF8) is None
    library.close()


def test_equal_names_in_several_roots_are_told_apart(tmp_path: Path, small_scene: Path) -> None:
    roots = [tmp_path / part / "data" for part in ("one", "two")]
    for root in roots:
        (root / "inner").mkdir(parents=True)
        (root / "inner" / "a.mcap").write_bytes(MCAP_MAGIC)
    library = Library([small_scene], roots)
    names = [library.name_of(root / "inner" / "a.mcap") for root in roots]
    assert names == ["inner/a.mcap", "data (2)/inner/a.mcap"]
    assert [library.path(str(name)) for name in names] == [
        root / "inner" / "a.mcap" for root in roots
    ]
    assert library.name_of(tmp_path / "outside.mcap") is None
    library.close()


@pytest.mark.parametrize(
    "build",
    [
        lambda base: "../outside/\\xff.mcap",
        lambda base: f"{base}/outside/\\xff.mcap",
        lambda base: "data/../../outside/\\xff.mcap",
        lambda base: "to outside/\\xff.mcap",
        lambda base: "\\xff" * 1_000,
        lambda base: ".hidden/\\xff.mcap",
    ],
)
def test_an_escaped_name_leads_nowhere_else(
    tmp_path: Path, small_scene: Path, build: Callable[[Path], str]
) -> None:
    undecodable = os.fsdecode(b"\xff.mcap")
    root = tmp_path / "data"
    for folder in (tmp_path / "outside", root / ".hidden"):
        folder.mkdir(parents=True)
        (folder / undecodable).write_bytes(MCAP_MAGIC)
    (root / "to outside").symlink_to(tmp_path / "outside")
    library = Library([small_scene], [root])
    with pytest.raises(RecordingError, match="not among the recordings"):
        library.path(build(tmp_path))
    library.close()
