"""The recordings, shared by all browsers: opened once, and aligned once for equal settings."""

import os
import threading
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.errors import RecordingError
from fusion_core.model.given_extrinsics import GivenExtrinsics
from fusion_core.model.names import escape_undecodable
from fusion_core.model.recording import Recording
from fusion_core.workflows.fuse.recorded_streams import RecordedStreams, open_recorded_streams
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.labels.open_store import SUFFIX
from fusion_core.workflows.source import open_source
from scanloom.jobs.activity import Activity
from scanloom.jobs.fair_semaphore import FairSemaphore
from scanloom.resources import sample_path
from scanloom.state.allowed_paths import (
    path_of_shown_name,
    resolve_root,
    shown_name,
)
from scanloom.state.file_stamp import FileStamp
from scanloom.state.open_recording import OpenRecording
from scanloom.state.recording_details import DetailsReader
from scanloom.state.recording_labels import RecordingLabels
from scanloom.state.uploads import DEFAULT_LIMIT_BYTES, Uploads
from scanloom.state.view import MAX_NAME_CHARACTERS, View

# Open recordings without a viewer that are kept, for going back and for undo. The cached frames of
# each take about 200 MB.
_MAX_UNVIEWED = 3
# Time in which cancelled alignments should reach their next step.
_CANCEL_TIMEOUT_S = 5.0
# A long recording should not block a short one, and displaying frames needs processor time, too.
_MAX_PARALLEL_ALIGNMENTS = 2


class Library:
    """The recordings that may be opened: those given at the start, those below ``roots``, and what
    browsers have uploaded.

    Any other name is refused, whatever path it spells. Hidden files and folders are excluded, and
    symbolic links are resolved. A recording stays open while it has viewers, and for a while
    after; an alignment is cancelled when its last viewer leaves. Thread-safe.

    ``label_address``: where labels are kept, a file or a database; None for beside each recording.
    ``label_folder``: for labels of uploads, which are deleted at the end, and of the built-in
    sample, which belongs to the program.

    ``given``: extrinsics of the recordings given at the start, unless a view asks for a recording's
    own.

    Raises RecordingError for a root that is no folder.
    """

    def __init__(
        self,
        recordings: list[Path],
        roots: list[Path],
        upload_limit_bytes: int = DEFAULT_LIMIT_BYTES,
        label_address: str | None = None,
        label_folder: Path | None = None,
        given: GivenExtrinsics | None = None,
    ) -> None:
        self._given = given
        self._label_address, self._label_folder = label_address, label_folder
        self._labels: dict[Path, RecordingLabels] = {}
        # What people wait for, in any recording.
        self.activity = Activity()
        # Unlike Path.resolve, realpath accepts a link to itself.
        self._named = {escape_undecodable(p.name): Path(os.path.realpath(p)) for p in recordings}
        if len(self._named) < len(recordings):
            self._named = {
                escape_undecodable(str(p)): Path(os.path.realpath(p)) for p in recordings
            }
        self.roots = tuple(resolve_root(root) for root in roots)
        self.uploads = Uploads(upload_limit_bytes)
        self.details = DetailsReader(self.activity)
        self._alignment_semaphore = FairSemaphore(_MAX_PARALLEL_ALIGNMENTS)
        self._lock = threading.Lock()
        self._closed = False
        # The most recently used last.
        self._opened: OrderedDict[_Key, OpenRecording] = OrderedDict()
        self._key_by_viewer: dict[Hashable, _Key] = {}
        self._files: dict[Path, _File] = {}
        # Replaced by other files at the same paths, but still in use.
        self._outdated: list[_File] = []

    def open(self, view: View, viewer: Hashable = None) -> OpenRecording:
        """Open the recording of a view with its streams, extrinsics and alignment settings.

        ``viewer``: keeps it open until they open another one or call ``release``. Without a viewer
        it may be closed as soon as another one is opened.

        Raises RecordingError for a file that is no recording, MissingStream for a topic that it
        has not, and SettingsError for given extrinsics that are not of its cameras.
        """
        path = self.path(view.recording)
        key = _Key(path, view.opened_by)
        file: _File | None = None
        try:
            with self._lock:
                if (opened := self._find_open(key, viewer)) is not None:
                    return opened
                file = self._files.setdefault(path, _File(path))
                file.users += 1
            with file.opening:
                with self._lock:
                    # Another thread may have opened it meanwhile.
                    if (opened := self._find_open(key, viewer)) is not None:
                        return opened
                made = OpenRecording(
                    _streams_of(file.recording(), view, self.given_of(view)),
                    file.stamp,
                    self._alignment_semaphore,
                    self.activity,
                )
                with self._lock:
                    if self._closed:
                        raise RecordingError("The server is closing.", advice="Start it again.")
                    self._opened[key] = made
                    self._find_open(key, viewer)
            return made
        finally:
            with self._lock:
                if file is not None:
                    file.users -= 1
                unused = self._take_unused()
            _close(*unused)

    def given_of(self, view: View) -> GivenExtrinsics | None:
        """The extrinsics given at the start that a view's recording is opened with, if any."""
        is_given = self._given is not None and view.recording in self._named
        return self._given if is_given and view.extrinsics != "recording" else None

    @property
    def given_file(self) -> Path | None:
        """The file of the given extrinsics, None without any."""
        return None if self._given is None else self._given.file

    def labels(self, recording: Path) -> RecordingLabels:
        """The labels of a recording, which all browsers share."""
        address = self._label_address
        is_own = recording == sample_path() or self.uploads.holds(recording)
        folder = None
        if address is None and is_own and self._label_folder is not None:
            folder = self._label_folder
            address = str(folder / f"{recording.name}{SUFFIX}")
        with self._lock:
            return self._labels.setdefault(recording, RecordingLabels(recording, address, folder))

    def release(self, viewer: Hashable) -> None:
        """A viewer no longer needs a recording."""
        with self._lock:
            self._key_by_viewer.pop(viewer, None)
            unused = self._take_unused()
        _close(*unused)

    def close(self) -> None:
        """Cancel the alignments, close the files, and delete uploads."""
        self.details.close()
        with self._lock:
            self._closed = True
            opened = list(self._opened.values())
            self._opened.clear()
            _, files = self._take_unused()
        for one in opened:
            one.cancel()
        for one in opened:
            one.wait(_CANCEL_TIMEOUT_S)
        for labels in self._labels.values():
            labels.close()
        _close([], files)
        self.uploads.close()

    def path(self, name: str) -> Path:
        """The path of a recording. Raises RecordingError for a name that may not be opened."""
        if name in self._named:
            return self._named[name]
        if (path := self.uploads.path(name)) is not None:
            return path
        for root in self.roots:
            if (path := path_of_shown_name(root, name)) is not None:
                return path
        for root in self.roots:
            prefix = f"{self.root_label(root)}/"
            inner = name.removeprefix(prefix)
            if inner != name and (path := path_of_shown_name(root, inner)) is not None:
                return path
        raise RecordingError(
            f"{name[:200]!r} is not among the recordings of this server.",
            advice="Choose one of the list, or start scanloom view with its folder as --root.",
        )

    def named(self) -> dict[str, Path]:
        """The recordings given at the start, by the names that ``open`` accepts."""
        return dict(self._named)

    def root_label(self, root: Path) -> str:
        """What browsers are told of a root: its own name, with a number if it is not the only one
        of that name."""
        same = [other for other in self.roots if other.name == root.name]
        number = f" ({same.index(root) + 1})" if len(same) > 1 else ""
        return f"{escape_undecodable(root.name)}{number}"

    def name_of(self, path: Path) -> str | None:
        """The name that ``open`` accepts for a resolved path below a root, None if there is
        none."""
        for root in self.roots:
            name = shown_name(root, path)
            if name is None:
                continue
            # Another root, or a recording given at the start, may have the shorter name.
            for candidate in (name, f"{self.root_label(root)}/{name}"):
                if len(candidate) <= MAX_NAME_CHARACTERS and self._leads_to(candidate, path):
                    return candidate
        return None

    def _leads_to(self, name: str, path: Path) -> bool:
        try:
            return self.path(name) == path
        except RecordingError:
            return False

    def _find_open(self, key: "_Key", viewer: Hashable) -> OpenRecording | None:
        """The open recording of a key, marked as recently used; None if there is none."""
        if key not in self._opened:
            return None
        # Its present viewers get a message, and keep what can still be read.
        if self._opened[key].is_outdated and self._key_by_viewer.get(viewer) != key:
            self._discard_outdated(key.path)
            return None
        self._opened.move_to_end(key)
        if viewer is not None:
            self._key_by_viewer[viewer] = key
        return self._opened[key]

    def _discard_outdated(self, path: Path) -> None:
        """Have the next request open the file again."""
        for key in [key for key in self._opened if key.path == path]:
            self._opened.pop(key).cancel()
        if path in self._files:
            self._outdated.append(self._files.pop(path))

    def _take_unused(self) -> tuple[list[OpenRecording], list["_File"]]:
        """Remove and return what the caller must close, outside of the lock."""
        viewed = set(self._key_by_viewer.values())
        unviewed = [key for key in self._opened if key not in viewed]
        # Nobody waits for these alignments.
        closing = [key for key in unviewed if self._opened[key].is_aligning]
        kept = [key for key in unviewed if key not in closing]
        closing += kept[: max(len(kept) - _MAX_UNVIEWED, 0)]
        opened = [self._opened.pop(key) for key in closing]
        needed = {key.path for key in self._opened}
        unused = [f.path for f in self._files.values() if not f.users and f.path not in needed]
        files = [file for file in self._outdated if not file.users]
        self._outdated = [file for file in self._outdated if file.users]
        return opened, files + [self._files.pop(path) for path in unused]


@dataclass(frozen=True, slots=True)
class _Key:
    """A recording and all that its alignment depends on."""

    path: Path
    options: Hashable


class _File:
    """A file shared by several ``OpenRecording``.

    ``users``: calls of ``Library.open`` in progress; ``opening``: held while it is opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.users = 0
        self.opening = threading.Lock()
        self.stamp: FileStamp | None = None
        self._recording: Recording | None = None

    def recording(self) -> Recording:
        """The recording, opened if necessary. Hold ``opening``. Raises RecordingError."""
        if self._recording is None:
            self.stamp = FileStamp.of(self.path)
            self._recording = open_source(self.path, None)
        return self._recording

    def close(self) -> None:
        """Close the file."""
        if self._recording is not None:
            self._recording.close()


def _streams_of(recording: Recording, view: View, given: GivenExtrinsics | None) -> RecordedStreams:
    options = FuseOptions(
        lidar_topic=view.lidar_topic,
        depth_topics=view.depth_topics,
        virtual_lidar_row=view.virtual_row,
    )
    return open_recorded_streams(recording, options, view.alignment_settings, given)


def _close(opened: list[OpenRecording], files: list[_File]) -> None:
    for one in opened:
        one.cancel()
    for file in files:
        file.close()
