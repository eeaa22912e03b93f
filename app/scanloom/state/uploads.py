"""Files that browsers upload: kept apart, limited, and deleted with the browser's session.

A browser names a file, and the name is shown, but no path is made of it: a file is kept under a
name of the server's, in a folder of the server's that nobody else may read.
"""

import errno
import os
import re
import secrets
import shutil
import tempfile
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.names import escape_undecodable

# Enough for a minute of a LiDAR and small depth images; larger files are better opened in place.
DEFAULT_LIMIT_MB = 200
# Uploads stay on the disk of temporary files.
MAX_LIMIT_MB = 10_000
DEFAULT_LIMIT_BYTES = DEFAULT_LIMIT_MB * 1_000_000
# Left free for other programs; the readers' own unpacking leaves as much.
_DISK_RESERVE_BYTES = 256 << 20
_MAX_NAME_CHARACTERS = 80
# The suffixes that readers look at, of packed files.
_SUFFIX = re.compile(r"(\.(mcap|db3|bag|log|clf|txt))?(\.(zstd|zst|lz4|gz|bz2))?", re.IGNORECASE)
_FULL = (errno.ENOSPC, errno.EDQUOT)


class UploadRefused(ScanLoomError):
    """An upload that is not taken, or not any more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadProgress:
    """``name``: for display. ``received_bytes`` of ``total_bytes``."""

    name: str
    received_bytes: int
    total_bytes: int


class UploadListener:
    """What a session hears of its uploads, in threads of the server. By default it ignores it."""

    def on_progress(self, progress: UploadProgress) -> None:
        """A part has arrived."""

    def on_refused(self, error: Exception) -> None:
        """Nothing is kept of it."""

    def on_complete(self, name: str) -> None:
        """The library has a file of this name."""


class Uploads:
    """The uploads of a server, by session. Thread-safe.

    ``limit_bytes``: of each file, and of the files of a session together; 0 takes none.
    """

    def __init__(self, limit_bytes: int = DEFAULT_LIMIT_BYTES) -> None:
        self.limit_bytes = limit_bytes
        self._lock = threading.Lock()
        self._folder: Path | None = None
        self._sessions: dict[str, SessionUploads] = {}

    def new_session(self, listener: UploadListener) -> "SessionUploads":
        """The uploads of a browser's session, which it closes at its end."""
        session = SessionUploads(self, listener)
        with self._lock:
            self._sessions[session.ticket] = session
        return session

    def session(self, ticket: str) -> "SessionUploads | None":
        """The open session with a ticket."""
        with self._lock:
            return self._sessions.get(ticket)

    def path(self, name: str) -> Path | None:
        """The file of an upload, None if there is none of that name."""
        with self._lock:
            sessions = list(self._sessions.values())
        return next((path for one in sessions if (path := one.path(name)) is not None), None)

    def holds(self, path: Path) -> bool:
        """Whether a file is an upload."""
        return self._folder is not None and self._folder in path.parents

    def folder(self) -> Path:
        """The folder of all uploads, made when it is needed first. Raises OSError."""
        with self._lock:
            if self._folder is None:
                # Nobody but this user may enter it.
                self._folder = Path(tempfile.mkdtemp(prefix="scanloom-uploads-"))
            return self._folder

    def forget(self, session: "SessionUploads") -> None:
        """A session has ended."""
        with self._lock:
            self._sessions.pop(session.ticket, None)

    def close(self) -> None:
        """Delete all."""
        with self._lock:
            sessions, folder = list(self._sessions.values()), self._folder
        for session in sessions:
            session.close()
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


class SessionUploads:
    """The uploads of one session, one at a time. Thread-safe. ``ticket``: its page's secret."""

    def __init__(self, uploads: Uploads, listener: UploadListener) -> None:
        self.ticket = secrets.token_urlsafe(24)
        self.listener = listener
        self._uploads = uploads
        self._lock = threading.Lock()
        self._kept: dict[str, Path] = {}
        self._running: Upload | None = None
        self._closed = False

    def names(self) -> list[str]:
        """The names of the complete uploads."""
        with self._lock:
            return list(self._kept)

    def path(self, name: str) -> Path | None:
        """The file of a complete upload, None if there is none of that name."""
        with self._lock:
            return self._kept.get(name)

    def label(self, name: str) -> str | None:
        """How a complete upload is called on the page, None if there is none of that name."""
        return name.rpartition(" (upload ")[0] if self.path(name) is not None else None

    def begin(self, name: str, size_bytes: int) -> "Upload":
        """Take a file of so many bytes. Raises UploadRefused."""
        label = upload_label(name)
        with self._lock:
            limit = self._uploads.limit_bytes
            if limit == 0:
                raise UploadRefused(f"{label}: this server takes no uploads.", advice=_IN_PLACE)
            if size_bytes > limit:
                raise UploadRefused(
                    f"{label} has {_in_mb(size_bytes)}; at most {_in_mb(limit)} can be uploaded.",
                    advice=_IN_PLACE,
                )
            if size_bytes <= 0:
                raise UploadRefused(f"{label} is empty.", advice="Choose another file.")
            if self._closed:
                raise UploadRefused(f"{label}: the page is closed.", advice="Open it again.")
            if self._running is not None:
                raise UploadRefused(
                    f"{label}: another file is being uploaded.", advice="Wait for it, or cancel it."
                )
            kept_bytes = sum(map(_size_of, self._kept.values()))
            if kept_bytes + size_bytes > limit:
                raise UploadRefused(
                    f"{label} has {_in_mb(size_bytes)}, and {_in_mb(kept_bytes)} of {_in_mb(limit)}"
                    " are taken by earlier uploads.",
                    advice="Reload the page, which deletes them.",
                )
            upload = self._running = Upload(self, label, size_bytes)
        try:
            upload.create(self._uploads, f"{secrets.token_hex(8)}{_suffix_of(name)}")
        except BaseException:
            self.end(upload)
            raise
        return upload

    def cancel(self) -> None:
        """Stop the running upload, if there is one."""
        with self._lock:
            if self._running is not None:
                self._running.is_cancelled = True

    def keep(self, upload: "Upload") -> str:
        """Keep a complete upload. Returns the name by which the library knows it."""
        # Not to be guessed by others of this server.
        name = f"{upload.label} (upload {secrets.token_hex(4)})"
        with self._lock:
            self._running = None
            if self._closed:
                upload.delete()
            else:
                self._kept[name] = upload.path
        return name

    def end(self, upload: "Upload") -> None:
        """Delete what there is of an upload."""
        upload.delete()
        with self._lock:
            if self._running is upload:
                self._running = None

    def discard(self, name: str) -> None:
        """Delete a complete upload; what is open can still be read."""
        with self._lock:
            path = self._kept.pop(name, None)
        if path is not None:
            path.unlink(missing_ok=True)

    def close(self) -> None:
        """Delete all and take no more."""
        with self._lock:
            self._closed = True
            names = list(self._kept)
            if self._running is not None:
                self._running.is_cancelled = True
        for name in names:
            self.discard(name)
        self._uploads.forget(self)


class Upload:
    """A file that is being written, part by part. Used by one thread at a time.

    ``label``: its name for display.
    """

    def __init__(self, session: SessionUploads, label: str, size_bytes: int) -> None:
        self.label = label
        self.path = Path()
        self.is_cancelled = False
        self._session = session
        self._size_bytes = size_bytes
        self._received_bytes = 0
        self._file: BinaryIO | None = None

    @property
    def is_complete(self) -> bool:
        """Whether all bytes have arrived."""
        return self._received_bytes == self._size_bytes

    def create(self, uploads: Uploads, file_name: str) -> None:
        """Create its file. Raises UploadRefused."""
        try:
            path = uploads.folder() / file_name
            free_bytes = shutil.disk_usage(path.parent).free - _DISK_RESERVE_BYTES
            if self._size_bytes > free_bytes:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
            self._file = os.fdopen(os.open(path, flags, 0o600), "wb")
            self.path = path
        except OSError as error:
            raise self._write_error(error) from error

    def write(self, part: bytes) -> None:
        """Add a part. Raises UploadRefused, and then nothing of the file is kept."""
        if self.is_cancelled:
            raise UploadRefused(f"{self.label}: the upload was cancelled.")
        self._received_bytes += len(part)
        if self._received_bytes > self._size_bytes:
            raise UploadRefused(f"{self.label} is larger than announced.", advice="Try again.")
        assert self._file is not None, "it is written after create and before finish"
        try:
            self._file.write(part)
        except OSError as error:
            raise self._write_error(error) from error
        self._session.listener.on_progress(
            UploadProgress(
                name=self.label, received_bytes=self._received_bytes, total_bytes=self._size_bytes
            )
        )

    def finish(self) -> None:
        """Keep the complete file. Raises UploadRefused."""
        assert self._file is not None, "it is finished after create"
        try:
            self._file.close()
        except OSError as error:
            raise self._write_error(error) from error
        self._session.listener.on_complete(self._session.keep(self))

    def refuse(self, error: Exception) -> None:
        """Delete it and say why."""
        self._session.end(self)
        self._session.listener.on_refused(error)

    def delete(self) -> None:
        """Delete its file."""
        if self._file is None:
            return
        # There may be no room for the rest of a part.
        with suppress(OSError):
            self._file.close()
        self.path.unlink(missing_ok=True)

    def _write_error(self, error: OSError) -> UploadRefused:
        is_full = error.errno in _FULL
        reason = "the server's disk is full" if is_full else error.strerror or str(error)
        return UploadRefused(f"{self.label} cannot be stored: {reason}.", advice=_IN_PLACE)


_IN_PLACE = "Put it into a folder that the server may open, or start scanloom view with its folder."


def upload_label(name: str) -> str:
    """A file's name for display: on one line, without control characters, shortened."""
    text = escape_undecodable(name)
    text = "".join(sign if sign.isprintable() else " " for sign in text)
    text = " ".join(text.split()) or "a file without a name"
    if len(text) > _MAX_NAME_CHARACTERS:
        half = _MAX_NAME_CHARACTERS // 2
        text = f"{text[: half - 1]}…{text[-half:]}"
    return text


def _suffix_of(name: str) -> str:
    """The suffix of a name, if it is one that readers look at."""
    last = name[-20:]
    places = (_SUFFIX.fullmatch(last[at:]) for at in range(len(last)) if last[at] == ".")
    return next((found.group().lower() for found in places if found is not None), "")


def _size_of(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _in_mb(count: int) -> str:
    return f"{count / 1e6:,.0f} MB" if count >= 1e6 else f"{count / 1e6:.1f} MB"
