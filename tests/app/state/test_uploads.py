"""Uploaded files: limited, kept apart under names of the server's, and deleted."""

import errno
import os
import shutil
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from scanloom.state import uploads as module
from scanloom.state.uploads import (
    SessionUploads,
    UploadListener,
    UploadProgress,
    UploadRefused,
    Uploads,
    upload_label,
)

LIMIT = 1_000


class Listener(UploadListener):
    """Keeps what it hears."""

    def __init__(self) -> None:
        self.refused: list[str] = []
        self.complete: list[str] = []
        self.progress: list[int] = []

    def on_progress(self, progress: UploadProgress) -> None:
        self.progress.append(progress.received_bytes)

    def on_refused(self, error: Exception) -> None:
        self.refused.append(str(error))

    def on_complete(self, name: str) -> None:
        self.complete.append(name)


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The system's folder of temporary files."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


@pytest.fixture
def uploads() -> Iterator[Uploads]:
    uploads = Uploads(LIMIT)
    yield uploads
    uploads.close()


@pytest.fixture
def listener() -> Listener:
    return Listener()


@pytest.fixture
def session(uploads: Uploads, listener: Listener) -> SessionUploads:
    return uploads.new_session(listener)


def put(session: SessionUploads, name: str, content: bytes = b"x" * 100) -> None:
    upload = session.begin(name, len(content))
    upload.write(content[:60])
    upload.write(content[60:])
    assert upload.is_complete
    upload.finish()


def files_below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("room.mcap", "room.mcap"),
        ("../../etc/passwd", "../../etc/passwd"),
        ("/etc/passwd", "/etc/passwd"),
        ("..", ".."),
        ("", "a file without a name"),
        ("\x00\n\t", "a file without a name"),
        ("two\nlines.bag", "two lines.bag"),
        ("<img src=x onerror=alert(1)>", "<img src=x onerror=alert(1)>"),
        ("\u202egpj.mcap", "gpj.mcap"),
        ("a\udcffb", "a\\xffb"),
        ("l" * 4_000, "l" * 39 + "…" + "l" * 40),
    ],
)
def test_a_name_is_shown_and_never_a_path(
    uploads: Uploads, session: SessionUploads, listener: Listener, name: str, label: str
) -> None:
    put(session, name)
    (known,) = listener.complete
    assert session.label(known) == label == upload_label(name)
    path = uploads.path(known)
    assert path is not None
    assert path.parent == uploads.folder()
    assert path.stem.split(".")[0].isalnum()
    assert path.read_bytes() == b"x" * 100
    assert known.encode("utf-8")


@pytest.mark.parametrize(
    ("name", "suffix"),
    [
        ("a.mcap", ".mcap"),
        ("a.b.DB3.ZSTD", ".db3.zstd"),
        ("log.clf.bz2", ".clf.bz2"),
        ("log.gz", ".gz"),
        ("a.exe", ""),
        ("a.mcap/../x", ""),
        ("mcap", ""),
    ],
)
def test_only_suffixes_that_readers_know_are_kept(
    uploads: Uploads, session: SessionUploads, listener: Listener, name: str, suffix: str
) -> None:
    put(session, name)
    path = uploads.path(listener.complete[0])
    assert path is not None
    assert "".join(path.suffixes) == suffix


def test_nobody_else_may_read_it(
    uploads: Uploads, session: SessionUploads, listener: Listener
) -> None:
    put(session, "a.mcap")
    path = uploads.path(listener.complete[0])
    assert path is not None
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_too_large_is_refused_before_anything_is_written(
    session: SessionUploads, temporary: Path
) -> None:
    with pytest.raises(UploadRefused, match="2,000 MB; at most"):
        session.begin("huge.bag", 2_000_000_000)
    assert list(temporary.iterdir()) == []


def test_all_files_of_a_session_share_its_limit(
    uploads: Uploads, session: SessionUploads, listener: Listener
) -> None:
    put(session, "a.mcap", b"x" * 600)
    with pytest.raises(UploadRefused, match="taken by earlier uploads"):
        session.begin("b.mcap", 600)
    session.discard(listener.complete[0])
    put(session, "b.mcap", b"x" * 600)
    put(uploads.new_session(Listener()), "c.mcap", b"x" * 600)


def test_one_at_a_time(session: SessionUploads) -> None:
    first = session.begin("a.mcap", 100)
    with pytest.raises(UploadRefused, match="another file is being uploaded"):
        session.begin("b.mcap", 100)
    session.end(first)
    put(session, "b.mcap")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda session, upload: upload.write(b"x" * 101), "larger than announced"),
        (lambda session, upload: (session.cancel(), upload.write(b"x")), "was cancelled"),
        (lambda session, upload: (session.close(), upload.write(b"x")), "was cancelled"),
    ],
)
def test_what_is_not_taken_is_deleted(
    session: SessionUploads,
    listener: Listener,
    temporary: Path,
    spoil: Callable[[SessionUploads, Any], None],
    words: str,
) -> None:
    upload = session.begin("a.mcap", 100)
    with pytest.raises(UploadRefused, match=words) as refused:
        spoil(session, upload)
    upload.refuse(refused.value)
    assert words in listener.refused[0]
    assert files_below(temporary) == []


def test_a_full_disk_is_named(
    session: SessionUploads, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(temporary)
    with monkeypatch.context() as full:
        full.setattr(module.shutil, "disk_usage", lambda _: usage._replace(free=1_000))
        with pytest.raises(UploadRefused, match="the server's disk is full"):
            session.begin("a.mcap", 100)
    upload = session.begin("a.mcap", 100)

    class Full:
        def write(self, _: bytes) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        def close(self) -> None:
            return

    assert upload._file is not None
    upload._file.close()
    upload._file = Full()  # type: ignore[assignment]  # writes are all that matters
    with pytest.raises(UploadRefused, match="the server's disk is full") as refused:
        upload.write(b"x")
    upload.refuse(refused.value)
    assert files_below(temporary) == []


def test_a_server_without_a_place_for_temporary_files_says_so(
    session: SessionUploads, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as nowhere:
        nowhere.setattr("tempfile.tempdir", str(tmp_path / "gone"))
        with pytest.raises(UploadRefused, match="cannot be stored: No such file or directory"):
            session.begin("a.mcap", 100)
    # Nothing of it is left running.
    session.end(session.begin("a.mcap", 100))


def test_none_are_taken_where_the_limit_is_0() -> None:
    session = Uploads(0).new_session(Listener())
    with pytest.raises(UploadRefused, match="takes no uploads"):
        session.begin("a.mcap", 1)


def test_files_go_with_their_session_and_the_folder_with_the_server(
    uploads: Uploads, temporary: Path
) -> None:
    listeners = Listener(), Listener()
    first, second = (uploads.new_session(listener) for listener in listeners)
    put(first, "a.mcap")
    put(second, "b.mcap")
    first.close()
    assert uploads.path(listeners[0].complete[0]) is None
    assert uploads.session(first.ticket) is None
    assert len(files_below(temporary)) == 1
    with pytest.raises(UploadRefused, match="the page is closed"):
        first.begin("c.mcap", 1)
    uploads.close()
    assert list(temporary.iterdir()) == []


def test_an_upload_that_ends_after_its_session_is_deleted(
    session: SessionUploads, temporary: Path
) -> None:
    upload = session.begin("a.mcap", 1)
    upload.write(b"x")
    session.close()
    upload.finish()
    assert files_below(temporary) == []
