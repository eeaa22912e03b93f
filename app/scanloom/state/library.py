"""The recordings that all browsers share: opened once, aligned once for each choice of settings."""

import os
import stat
import threading
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from fusion_core.model.errors import RecordingError
from fusion_core.model.names import escape_undecodable
from fusion_core.model.recording import Recording
from fusion_core.workflows.fuse.session import FuseOptions, Session, open_session
from fusion_core.workflows.source import open_source
from scanloom.jobs.fair_semaphore import FairSemaphore
from scanloom.state.file_stamp import FileStamp
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import View

# More files than this in a folder are no list to choose from.
_MAX_LISTED = 500
# Of what nobody looks at, the last few are kept: people go back, and an undo does. The results that
# each keeps of its frames take some 200 MB.
_MOST_UNSEEN = 3
_PARTING_S = 5.0
# One long recording holds no short one up, and what people look at meanwhile still moves.
_ALIGNMENTS_AT_ONCE = 2


class Library:
    """The recordings that may be opened: those named at the start, and those below ``roots``.

    Nothing else is: a name that is none of them is refused, whatever path it spells. Hidden files
    and folders are nobody's, and a link is what it leads to. What is opened stays so while somebody
    looks at it, and for a while after; an alignment ends with the last who waits for it. Safe for
    threads.

    Raises RecordingError for a root that is no folder.
    """

    def __init__(self, recordings: list[Path], roots: list[Path]) -> None:
        # Unlike resolve, realpath knows what to do with a link that leads to itself.
        self._named = {escape_undecodable(p.name): Path(os.path.realpath(p)) for p in recordings}
        if len(self._named) < len(recordings):
            self._named = {
                escape_undecodable(str(p)): Path(os.path.realpath(p)) for p in recordings
            }
        self._roots = [_folder(root) for root in roots]
        self._turns = FairSemaphore(_ALIGNMENTS_AT_ONCE)
        self._lock = threading.Lock()
        self._closed = False
        # What was asked for last comes last.
        self._opened: OrderedDict[_Key, OpenRecording] = OrderedDict()
        self._viewer: dict[Hashable, _Key] = {}
        self._files: dict[Path, _File] = {}
        # Not the files at their paths any more, and still in use.
        self._outdated: list[_File] = []

    def names(self) -> list[str]:
        """What may be opened, by the name that ``open`` takes."""
        found = dict.fromkeys(self._named)
        for root in self._roots:
            found.update(dict.fromkeys(_listed(root)))
        return list(found)

    def open(self, view: View, viewer: Hashable = None) -> OpenRecording:
        """The recording of a view with its streams and settings.

        ``viewer``: who looks at it, until they open another or ``leave``; what is opened for
        nobody may be closed as soon as something else is opened.

        Raises RecordingError and MissingStream as opening a recording does.
        """
        path = self.path(view.recording)
        key = _key_of(path, view)
        file: _File | None = None
        try:
            with self._lock:
                if (opened := self._look_at(key, viewer)) is not None:
                    return opened
                file = self._files.setdefault(path, _File(path))
                # A file with users stays open.
                file.users += 1
            with file.opening:
                with self._lock:
                    # Somebody may have opened it meanwhile.
                    if (opened := self._look_at(key, viewer)) is not None:
                        return opened
                made = OpenRecording(_session_of(file.recording(), view), file.stamp, self._turns)
                with self._lock:
                    if self._closed:
                        raise RecordingError("The server is closing.", advice="Start it again.")
                    self._opened[key] = made
                    self._look_at(key, viewer)
            return made
        finally:
            with self._lock:
                if file is not None:
                    file.users -= 1
                unused = self._take_unused()
            _close(*unused)

    def release(self, viewer: Hashable) -> None:
        """Somebody looks at nothing any more."""
        with self._lock:
            self._viewer.pop(viewer, None)
            unused = self._take_unused()
        _close(*unused)

    def close(self) -> None:
        """Stop what runs and free the files."""
        with self._lock:
            self._closed = True
            opened = list(self._opened.values())
            self._opened.clear()
            _, files = self._take_unused()
        for one in opened:
            one.cancel()
        for one in opened:
            one.wait(_PARTING_S)
        _close([], files)

    def path(self, name: str) -> Path:
        """Where a recording lies. Raises RecordingError for a name that may not be opened."""
        if name in self._named:
            return self._named[name]
        # A browser could not be sent it.
        roots = self._roots if name == escape_undecodable(name) else []
        for root in roots:
            if (path := _path_below(root, name) or _listed(root).get(name)) is not None:
                return path
        raise RecordingError(
            f"{name[:200]!r} is not among the recordings of this server.",
            advice="Choose one of the list, or start scanloom view with its folder as --root.",
        )

    def _look_at(self, key: "_Key", viewer: Hashable) -> OpenRecording | None:
        """What is open under a key, then the last that was asked for."""
        if key not in self._opened:
            return None
        # Who looks at it is told, and keeps what can still be read.
        if self._opened[key].is_outdated and self._viewer.get(viewer) != key:
            self._forget(key.path)
            return None
        self._opened.move_to_end(key)
        if viewer is not None:
            self._viewer[viewer] = key
        return self._opened[key]

    def _forget(self, path: Path) -> None:
        """Have a file opened again by who asks for it next."""
        for key in [key for key in self._opened if key.path == path]:
            self._opened.pop(key).cancel()
        if path in self._files:
            self._outdated.append(self._files.pop(path))

    def _take_unused(self) -> tuple[list[OpenRecording], list["_File"]]:
        """Take out what is to be closed, which may last."""
        seen = set(self._viewer.values())
        unseen = [key for key in self._opened if key not in seen]
        # Nobody waits for their alignment any more.
        going = [key for key in unseen if self._opened[key].is_aligning]
        kept = [key for key in unseen if key not in going]
        going += kept[: max(len(kept) - _MOST_UNSEEN, 0)]
        opened = [self._opened.pop(key) for key in going]
        needed = {key.path for key in self._opened}
        unused = [f.path for f in self._files.values() if not f.users and f.path not in needed]
        files = [file for file in self._outdated if not file.users]
        self._outdated = [file for file in self._outdated if file.users]
        return opened, files + [self._files.pop(path) for path in unused]


@dataclass(frozen=True, slots=True)
class _Key:
    """A recording and all that its alignment depends on."""

    path: Path
    asked: Hashable


def _key_of(path: Path, view: View) -> _Key:
    settings = view.alignment_settings
    asked = (
        view.lidar_topic,
        view.depth_topics,
        view.virtual_row,
        settings.time,
        settings.sampling,
        settings.search,
        settings.mount,
        settings.pairing,
    )
    return _Key(path, asked)


class _File:
    """A recording that several ``Opened`` share. ``users``: how many are about to be made;
    ``opening`` is held by the one that is being made."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.users = 0
        self.opening = threading.Lock()
        self.stamp: FileStamp | None = None
        self._recording: Recording | None = None

    def recording(self) -> Recording:
        """The opened file, for the holder of ``opening``. Raises RecordingError."""
        if self._recording is None:
            self.stamp = FileStamp.of(self.path)
            self._recording = open_source(self.path, None)
        return self._recording

    def close(self) -> None:
        """Free it."""
        if self._recording is not None:
            self._recording.close()


def _folder(root: Path) -> Path:
    if not root.is_dir():
        raise RecordingError(
            "is no folder.", file=root, advice="Name one that holds recordings as --root."
        )
    return Path(os.path.realpath(root))


def _listed(root: Path) -> dict[str, Path]:
    """What may be opened in a root, by the name that browsers are sent."""
    try:
        children = sorted(child.name for child in root.iterdir())
    except OSError:
        # It was there at the start.
        return {}
    below = ((escape_undecodable(name), _path_below(root, name)) for name in children)
    return dict(islice(((name, path) for name, path in below if path is not None), _MAX_LISTED))


def _path_below(root: Path, name: str) -> Path | None:
    """Where a name below a root leads, None where that is not to be opened.

    To be opened are files and folders below the root that are not hidden, nor lie in what is.
    """
    if any(part.startswith(".") for part in Path(name).parts):
        return None
    try:
        path = (root / name).resolve()
        inner = path.relative_to(root).parts
        if not inner or any(part.startswith(".") for part in inner):
            return None
        mode = path.stat().st_mode
    except (OSError, RuntimeError, ValueError):
        # A name that no file can have, a link that leads out or to itself, or nothing at all.
        return None
    return path if stat.S_ISREG(mode) or stat.S_ISDIR(mode) else None


def _session_of(recording: Recording, view: View) -> Session:
    options = FuseOptions(
        lidar_topic=view.lidar_topic,
        depth_topics=view.depth_topics,
        virtual_lidar_row=view.virtual_row,
    )
    return open_session(recording, options, view.alignment_settings)


def _close(opened: list[OpenRecording], files: list[_File]) -> None:
    for one in opened:
        one.cancel()
    for file in files:
        file.close()
