"""The recordings that all browsers share: opened once, aligned once for each choice of settings."""

import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from app.jobs.long import LongJob
from app.state.view import View
from fusion_core.model.errors import RecordingError
from fusion_core.model.recording import Recording
from fusion_core.workflows.frame_reader import FrameReader
from fusion_core.workflows.live import LiveChain
from fusion_core.workflows.poses import Poses, recorded_poses
from fusion_core.workflows.session import (
    FuseOptions,
    Session,
    align_session,
    open_session,
)
from fusion_core.workflows.source import open_source

# More files than this in a folder are no list to choose from.
_MAX_LISTED = 500


@dataclass(frozen=True, kw_only=True)
class Progressing:
    """How far the alignment of a recording is."""

    done: int
    total: int | None
    what: str


class Opened:
    """A recording with the streams of one choice, and its alignment once that is there.

    ``chain`` is None until then; ``failure`` says why it will not come.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self.frames = FrameReader(session)
        self.chain: LiveChain | None = None
        self.failure: Exception | None = None
        self.progress = Progressing(done=0, total=None, what="waiting")
        self._listeners: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._job: LongJob | None = None

    @cached_property
    def poses(self) -> Poses | None:
        """The recorded poses of the LiDAR, None where there are none."""
        session = self.session
        if session.virtual_row is not None:
            return None
        return recorded_poses(session.recording, session.streams, session.rig.lidar_frame)

    def align(self, on_change: Callable[[], None]) -> None:
        """Begin the alignment unless it runs or is done; ``on_change`` hears of every step."""
        with self._lock:
            if on_change not in self._listeners:
                self._listeners.append(on_change)
            if self._job is None:
                self._job = LongJob(
                    "alignment",
                    lambda progress: align_session(self.session, progress),
                    on_progress=self._advance,
                    on_done=self._finish,
                    on_failed=self._fail,
                    on_cancelled=lambda: None,
                )

    def forget(self, on_change: Callable[[], None]) -> None:
        """The listener has gone."""
        with self._lock:
            if on_change in self._listeners:
                self._listeners.remove(on_change)

    def close(self) -> None:
        """Stop the alignment."""
        if self._job is not None:
            self._job.cancel()
            self._job.wait(5.0)

    def _advance(self, done: int, total: int | None, what: str) -> None:
        before, self.progress = self.progress, Progressing(done=done, total=total, what=what)
        # A listener redraws a bar: one step in fifty is enough.
        if before.what != what or total is None or done * 50 // total != before.done * 50 // total:
            self._tell()

    def _finish(self, alignment: object) -> None:
        self.chain = LiveChain(self.session, self.frames, alignment)  # type: ignore[arg-type]  # a job's result is of any type
        self._tell()

    def _fail(self, error: Exception) -> None:
        self.failure = error
        self._tell()

    def _tell(self) -> None:
        with self._lock:
            listeners = list(self._listeners)
        for listener in listeners:
            listener()


class Library:
    """The recordings that may be opened: those named at the start, and those below ``roots``.

    Nothing else is: a name that is none of them is refused, whatever path it spells.
    """

    def __init__(self, recordings: list[Path], roots: list[Path]) -> None:
        self._named = {path.name: path.resolve() for path in recordings}
        if len(self._named) < len(recordings):
            self._named = {str(path): path.resolve() for path in recordings}
        self._roots = [root.resolve() for root in roots]
        self._lock = threading.Lock()
        self._recordings: dict[Path, Recording] = {}
        self._opened: dict[Hashable, Opened] = {}

    def names(self) -> list[str]:
        """What may be opened, by the name that ``open`` takes."""
        found = dict.fromkeys(self._named)
        for root in self._roots:
            for child in sorted(root.iterdir())[:_MAX_LISTED]:
                if not child.name.startswith("."):
                    found[child.name] = None
        return list(found)

    def open(self, view: View) -> Opened:
        """The recording of a view with its streams and settings.

        Raises RecordingError and MissingStream as opening a recording does.
        """
        path = self.path(view.recording)
        settings = view.aligned
        key = (
            path,
            view.lidar_topic,
            view.depth_topics,
            view.virtual_row,
            settings.time,
            settings.sampling,
            settings.search,
            settings.mount,
            settings.pairing,
        )
        with self._lock:
            if key not in self._opened:
                options = FuseOptions(
                    lidar_topic=view.lidar_topic,
                    depth_topics=view.depth_topics,
                    virtual_lidar_row=view.virtual_row,
                )
                self._opened[key] = Opened(open_session(self._recording(path), options, settings))
            return self._opened[key]

    def close(self) -> None:
        """Stop what runs and free the files."""
        for opened in self._opened.values():
            opened.close()
        for recording in self._recordings.values():
            recording.close()

    def _recording(self, path: Path) -> Recording:
        if path not in self._recordings:
            self._recordings[path] = open_source(path, None)
        return self._recordings[path]

    def path(self, name: str) -> Path:
        """Where a recording lies. Raises RecordingError for a name that may not be opened."""
        if name in self._named:
            return self._named[name]
        for root in self._roots:
            try:
                path = (root / name).resolve()
                if path != root and path.is_relative_to(root) and path.exists():
                    return path
            except (OSError, RuntimeError, ValueError):
                # A name that no file can have, or a link that leads to itself.
                continue
        raise RecordingError(
            f"{name[:200]!r} is not among the recordings of this server.",
            advice="Choose one of the list, or start scanloom view with its folder as --root.",
        )
