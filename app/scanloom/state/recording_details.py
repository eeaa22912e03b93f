"""What recordings hold, read in the background for a list of them, and kept while their files are
as they were."""

import os
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.recording import Recording, Role
from fusion_core.workflows.source import is_packed, open_source
from scanloom.jobs.activity import Activity
from scanloom.state.file_stamp import FileStamp

# Ten pages of a list.
_MAX_KEPT = 500
# Files of a folder that are counted for its size.
_MAX_FILES = 20_000
# A packed file is unpacked as a whole to see what is in it: this takes a second or two.
_MAX_PACKED_BYTES = 64_000_000
# Reading gives way to what people wait for on other pages, but not for ever.
_QUIET_S, _LONGEST_WAIT_S = 0.05, 0.5

_STREAM_NAMES: dict[Role, str] = {
    "lidar": "LiDAR",
    "depth": "depth",
    "color": "colour",
    "odometry": "odometry",
    "tf": "transforms",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingDetails:
    """``duration_s``: None without a clock. ``streams``: in words. ``problem``: why it cannot be
    opened, in one line, or empty."""

    format: str = ""
    duration_s: float | None = None
    streams: tuple[str, ...] = ()
    size_bytes: int = 0
    problem: str = ""


class DetailsReader:
    """Reads details in a thread of its own, one recording at a time. Thread-safe."""

    def __init__(self, activity: Activity) -> None:
        self._activity = activity
        self._changed = threading.Condition()
        self._kept: OrderedDict[Path, tuple[FileStamp, RecordingDetails]] = OrderedDict()
        self._wanted: dict[Hashable, tuple[list[Path], Callable[[], None]]] = {}
        self._closed = False
        self._thread: threading.Thread | None = None

    def get(self, path: Path) -> RecordingDetails | None:
        """The details of a recording, None while they are not known."""
        with self._changed:
            found = self._kept.get(path)
        return found[1] if found is not None else None

    def request(self, viewer: Hashable, paths: Iterable[Path], on_read: Callable[[], None]) -> None:
        """Read the details of these recordings instead of those that ``viewer`` has wanted before.

        ``on_read`` is called after each, in the reader's thread.
        """
        with self._changed:
            self._wanted[viewer] = list(paths), on_read
            if self._thread is None and not self._closed:
                self._thread = threading.Thread(target=self._run, name="details", daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def release(self, viewer: Hashable) -> None:
        """A viewer wants no details any more."""
        with self._changed:
            self._wanted.pop(viewer, None)

    def close(self) -> None:
        """End after the recording that is being read."""
        with self._changed:
            self._closed = True
            self._wanted.clear()
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or any(self._pending()))
                if self._closed:
                    return
                viewer, path = next(self._pending())
                on_read = self._wanted[viewer][1]
            self._read(path)
            with self._changed:
                if viewer in self._wanted:
                    # Others take their turn.
                    paths, call = self._wanted.pop(viewer)
                    self._wanted[viewer] = [other for other in paths if other != path], call
            # A page may be closed meanwhile; the others want theirs.
            with suppress(Exception):
                on_read()

    def _pending(self) -> Iterator[tuple[Hashable, Path]]:
        return ((viewer, paths[0]) for viewer, (paths, _) in self._wanted.items() if paths)

    def _read(self, path: Path) -> None:
        stamp = FileStamp.of(path)
        with self._changed:
            kept = self._kept.get(path)
        if kept is not None and kept[0] == stamp:
            return
        self._activity.wait_until_quiet(_QUIET_S, _LONGEST_WAIT_S)
        details = read_details(path)
        with self._changed:
            self._kept[path] = stamp, details
            self._kept.move_to_end(path)
            while len(self._kept) > _MAX_KEPT:
                self._kept.popitem(last=False)


def read_details(path: Path) -> RecordingDetails:
    """Open a recording for a look at its index."""
    size_bytes = _size_of(path)
    try:
        if path.is_file() and size_bytes > _MAX_PACKED_BYTES and is_packed(path):
            return RecordingDetails(format="packed: not looked into", size_bytes=size_bytes)
        with open_source(path, None) as recording:
            return _details_of(recording, size_bytes)
    except ScanLoomError as error:
        problem = " ".join(error.problem.split())
    except Exception as error:  # noqa: BLE001  # one bad file must not end the list
        problem = f"cannot be read ({type(error).__name__})."
    return RecordingDetails(size_bytes=size_bytes, problem=problem)


def _details_of(recording: Recording, size_bytes: int) -> RecordingDetails:
    start_ns, end_ns = recording.start_ns, recording.end_ns
    duration_s = None
    if start_ns is not None and end_ns is not None:
        duration_s = (end_ns - start_ns) / NS_PER_S
    counts = Counter(topic.role for topic in recording.topics if topic.count)
    streams = tuple(
        f"{counts[role]} × {name}" if counts[role] > 1 and role != "tf" else name
        for role, name in _STREAM_NAMES.items()
        if counts[role] and not (role == "tf" and counts["odometry"])
    )
    return RecordingDetails(
        format=recording.format, duration_s=duration_s, streams=streams, size_bytes=size_bytes
    )


def _size_of(path: Path) -> int:
    """The size of a file, or of the files of a folder and those below."""
    if not path.is_dir():
        return _file_size(path)
    files = (Path(folder) / name for folder, _, names in os.walk(path) for name in names)
    return sum(map(_file_size, islice(files, _MAX_FILES)))


def _file_size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
