"""Files that appear whole or not at all."""

import errno
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fusion_core.files import atomic
from fusion_core.files.atomic import atomic_path, atomic_stream, write_bytes, write_text
from fusion_core.model.errors import ExportError

ROOT = Path(__file__).parents[2]


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_old_file_stays_until_the_new_one_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "map.pgm"
    path.write_bytes(b"old")
    with atomic_path(path) as temporary:
        assert (temporary.parent, temporary.suffix) == (path.parent, ".pgm")
        temporary.write_bytes(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert names(tmp_path) == ["map.pgm"]


def test_an_error_leaves_the_folder_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "map.pgm"
    path.write_bytes(b"old")
    for manager in (atomic_path, atomic_stream):
        with pytest.raises(RuntimeError, match="stop"), manager(path):
            raise RuntimeError("stop")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["map.pgm"]


def test_an_interrupt_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), atomic_path(tmp_path / "a"):
        raise KeyboardInterrupt
    assert names(tmp_path) == []


def test_whole_files(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a", b"\x00\r\n")
    write_text(tmp_path / "b", "ε = 1\r\n\n")
    with atomic_stream(tmp_path / "c") as stream:
        stream.write(b"1")
        stream.write(b"2")
    assert (tmp_path / "a").read_bytes() == b"\x00\r\n"
    assert (tmp_path / "b").read_bytes() == "ε = 1\r\n\n".encode()
    assert (tmp_path / "c").read_bytes() == b"12"


def test_it_has_the_permissions_of_any_new_file(tmp_path: Path) -> None:
    write_bytes(tmp_path / "a", b"")
    (tmp_path / "b").write_bytes(b"")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "b").stat().st_mode


def test_an_unwritable_place_is_named(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"nowhere.*cannot be written: No such file"):
        write_bytes(tmp_path / "nowhere" / "a", b"")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ExportError, match=r"folder: cannot be written"):
        write_bytes(tmp_path / "folder", b"")
    assert names(tmp_path) == ["folder"]


def test_a_full_disk_is_an_export_error_and_other_errors_are_the_callers(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"a: cannot be written"), atomic_path(tmp_path / "a"):
        raise OSError(errno.ENOSPC, "No space left on device")
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "a"):
        (tmp_path / "input").read_bytes()
    assert names(tmp_path) == []


def test_the_content_is_on_disk_before_the_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    seen = []

    def flush(flushed: Path) -> None:
        seen.append((flushed.is_dir(), path.exists()))

    monkeypatch.setattr(atomic, "_flush_to_disk", flush)
    write_bytes(path, b"1")
    assert seen == [(False, False), (True, True)]


def test_what_a_killed_process_left_is_removed_and_work_in_progress_is_not(tmp_path: Path) -> None:
    path = tmp_path / "map.pgm"
    left = tmp_path / ".map.0123abcd.partial.pgm"
    left.write_bytes(b"half")
    others = [".map.0123abcd.partial.png", ".map.0123abc.partial.pgm", ".map2.0123abcd.partial.pgm"]
    for name in others:
        (tmp_path / name).write_bytes(b"")
    with atomic_path(path) as first:
        assert not left.exists()
        with atomic_path(path) as second:
            assert first.exists()
            second.write_bytes(b"2")
        first.write_bytes(b"1")
    assert path.read_bytes() == b"1"
    assert names(tmp_path) == sorted([*others, "map.pgm"])


def test_a_killed_process_leaves_no_lock(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    script = (
        "import os, signal, sys; from pathlib import Path\n"
        "from fusion_core.files.atomic import AtomicFile\n"
        "AtomicFile(Path(sys.argv[1])).temporary.write_bytes(b'half')\n"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    ended = subprocess.run([sys.executable, "-c", script, str(path)], cwd=ROOT)
    assert ended.returncode == -signal.SIGKILL
    assert len(names(tmp_path)) == 1
    write_bytes(path, b"whole")
    assert names(tmp_path) == ["a.mcap"]
