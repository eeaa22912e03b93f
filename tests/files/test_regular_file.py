"""Only regular files of a bounded size are read, and opening never blocks."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from fusion_core.files.regular_file import open_regular, read_head, read_regular
from tests.hostile.files import write_loop, write_pipe


def test_the_content_of_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    assert read_regular(path, 5) == b"12345"
    assert read_head(path, 3) == b"123"
    assert read_head(path, 9) == b"12345"
    with open_regular(path, 5) as file:
        assert file.read() == b"12345"


def test_a_link_to_a_file_is_followed(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"1")
    (tmp_path / "link").symlink_to("file")
    assert read_regular(tmp_path / "link", 1) == b"1"


def test_a_larger_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    with pytest.raises(OSError, match="larger than 4 bytes"):
        read_regular(path, 4)
    with pytest.raises(OSError, match="larger than 4 bytes"):
        open_regular(path, 4)


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="there is no /proc")
def test_a_file_that_reports_no_size_is_read_up_to_the_limit() -> None:
    path = Path("/proc/self/status")
    assert path.stat().st_size == 0
    assert read_regular(path, 1 << 20)
    with pytest.raises(OSError, match="larger than 9 bytes"):
        read_regular(path, 9)


@pytest.mark.parametrize("read", [read_regular, read_head])
def test_pipes_devices_and_folders_are_refused_at_once(
    tmp_path: Path, read: Callable[[Path, int], bytes]
) -> None:
    for path in (write_pipe(tmp_path / "pipe"), tmp_path, Path(os.devnull)):
        with pytest.raises(OSError, match="not a regular file"):
            read(path, 9)
    with pytest.raises(OSError, match="symbolic links"):
        read(write_loop(tmp_path / "loop"), 9)
    with pytest.raises(FileNotFoundError):
        read(tmp_path / "nowhere", 9)
