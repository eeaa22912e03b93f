"""A recording with a choice of streams, aligned once for all browsers."""

import threading
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property

from fusion_core.model.errors import RecordingError, ScanLoomError
from fusion_core.model.progress import Progress
from fusion_core.workflows.fuse.align import RecordingAlignment, align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.pairing_gaps import PairingStamps
from fusion_core.workflows.fuse.recall import RecallCurve
from fusion_core.workflows.fuse.session import (
    Session,
)
from fusion_core.workflows.recorded_poses import PoseLookup, recorded_poses
from scanloom.jobs.fair_semaphore import FairSemaphore
from scanloom.jobs.long_job import LongJob
from scanloom.state.file_stamp import FileStamp


@dataclass(frozen=True, kw_only=True)
class AlignmentProgress:
    """Progress of a recording's alignment."""

    done: int
    total: int | None
    what: str


class OpenRecording:
    """A recording with a choice of streams, and its alignment once that has been computed.

    ``chain`` is None until then; ``failure`` is the reason if the alignment failed. ``pairing``:
    the stamps of the whole recording, None until the first pass over it has ended. ``recalls``: the
    computed recall curves, by the settings that they depend on.

    ``stamp``: the recording's files as they were opened. ``semaphore``: held while it is aligned.
    """

    def __init__(
        self,
        session: Session,
        stamp: FileStamp | None = None,
        semaphore: FairSemaphore | None = None,
    ) -> None:
        self.fuse_session = session
        self._stamp = FileStamp.of(session.recording.path) if stamp is None else stamp
        self._semaphore = FairSemaphore(1) if semaphore is None else semaphore
        # Whether its files have changed since: it must be opened again.
        self.is_outdated = False
        self.frames = FrameReader(session)
        self.chain: CachedChain | None = None
        self.failure: Exception | None = None
        self.pairing: PairingStamps | None = None
        self.recalls: dict[Hashable, RecallCurve] = {}
        self.progress = AlignmentProgress(done=0, total=None, what="waiting")
        self._listeners: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._job: LongJob | None = None

    @cached_property
    def poses(self) -> PoseLookup | None:
        """The recorded poses of the LiDAR, None where there are none."""
        session = self.fuse_session
        if session.virtual_row is not None:
            return None
        return recorded_poses(session.recording, session.streams, session.rig.lidar_frame)

    def align(self, on_change: Callable[[], None]) -> None:
        """Start the alignment unless it runs or is done; ``on_change`` is called at each step."""
        with self._lock:
            if on_change not in self._listeners:
                self._listeners.append(on_change)
            if self._job is None:
                self._job = LongJob(
                    "alignment",
                    self._work,
                    on_progress=self._advance,
                    on_done=self._finish,
                    on_failed=self._fail,
                    # Remaining viewers open it again.
                    on_cancelled=self._notify_listeners,
                )

    def remove_listener(self, on_change: Callable[[], None]) -> None:
        """Call ``on_change`` no longer."""
        with self._lock:
            if on_change in self._listeners:
                self._listeners.remove(on_change)

    @property
    def is_aligning(self) -> bool:
        """Whether the alignment is running or queued."""
        return self._job is not None and self.chain is None and self.failure is None

    def explain_read_error(self, error: Exception) -> Exception:
        """``error``, or if the file has changed since it was opened, an error that says so."""
        is_reading = isinstance(error, RecordingError) or not isinstance(error, ScanLoomError)
        change = self._stamp.change() if is_reading else None
        if change is None:
            return error
        self.is_outdated = True
        return RecordingError(
            f"{change} since it was opened.",
            file=self.fuse_session.recording.path,
            advice="Reload the page: it is then opened again, as it is now.",
        )

    def cancel(self) -> None:
        """Cancel the alignment at its next step."""
        if self._job is not None:
            self._job.cancel()

    def wait(self, timeout_s: float) -> bool:
        """Whether the alignment ended within the time, or was never started."""
        return self._job is None or self._job.wait(timeout_s)

    def _work(self, progress: Progress) -> RecordingAlignment:
        stamps = PairingStamps()
        try:
            with self._semaphore.acquired(
                lambda: progress(0, None, "waiting for other alignments")
            ):
                return align_recording(self.fuse_session, progress, stamps)
        finally:
            # If the alignment failed, the stamps may show why.
            if stamps.is_complete:
                self.pairing = stamps

    def _advance(self, done: int, total: int | None, what: str) -> None:
        before, self.progress = self.progress, AlignmentProgress(done=done, total=total, what=what)
        # A listener redraws a progress bar: steps of 2 % are enough.
        if before.what != what or (total and done * 50 // total != before.done * 50 // total):
            self._notify_listeners()

    def _finish(self, alignment: object) -> None:
        self.chain = CachedChain(self.fuse_session, self.frames, alignment)  # type: ignore[arg-type]  # a job's result is of any type
        self._notify_listeners()

    def _fail(self, error: Exception) -> None:
        self.failure = self.explain_read_error(error)
        self._notify_listeners()

    def _notify_listeners(self) -> None:
        with self._lock:
            listeners = list(self._listeners)
        for listener in listeners:
            listener()
