"""A recording with a choice of streams, aligned once for all browsers."""

import threading
import time
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fusion_core.model.bounded_cache import BoundedCache
from fusion_core.model.errors import MissingStream, RecordingError, ScanLoomError
from fusion_core.model.progress import Progress
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import ColorImage
from fusion_core.workflows.calibrate.turning_rig import image_topic_of
from fusion_core.workflows.fuse.align import RecordingAlignment, align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.curve_in_image import SeenScan, seen_scan
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.moved_rig import move_session
from fusion_core.workflows.fuse.pairing_gaps import PairingStamps
from fusion_core.workflows.fuse.recall import RecallCurve
from fusion_core.workflows.fuse.recorded_streams import RecordedStreams
from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.lone_stream import LoneStream
from fusion_core.workflows.recorded_poses import PoseLookup, recorded_poses
from scanloom.jobs.activity import Activity
from scanloom.jobs.fair_semaphore import FairSemaphore
from scanloom.jobs.long_job import Cancelled, LongJob
from scanloom.jobs.time_left import TimeLeft
from scanloom.state.file_stamp import FileStamp
from scanloom.state.hand_pose import HandPose
from scanloom.state.raw_frame import LoneFrame, RawFrame, lone_frame, raw_frame
from scanloom.state.survey_runner import SurveyRunner

# The alignment reports often, and each report asks for the displayed frame again. A few more serve
# several browsers.
_RAW_FRAMES_KEPT = 8
# Poses set by hand, for undo: each keeps the frames that were looked at.
_MOVED_KEPT = 6
# Frames over which a pose is judged: read once, in half a second.
_SAMPLED_FRAMES = 12
# A listener redraws a progress bar: more often, it would be less readable and cost the browser.
_NOTIFIED_EVERY_S = 0.4


@dataclass(frozen=True, kw_only=True)
class AlignmentProgress:
    """Progress of a recording's alignment: ``done`` of ``total`` images (None where they are not
    counted). ``remaining_s``: how long the images still take, None where not known yet."""

    done: int
    total: int | None
    what: str
    remaining_s: float | None = None

    @property
    def fraction(self) -> float:
        """How far the counted work is, from 0 to 1; 0 where nothing is counted."""
        return min(self.done / self.total, 1.0) if self.total else 0.0


class OpenRecording:
    """A recording with a choice of streams, and its alignment once that has been computed.

    ``chain`` is None until then; ``failure`` is the reason if the alignment failed. A recording
    without a LiDAR or without depth images is never aligned, and ``opened.why_not_fused`` says why.
    ``frames`` are the depth images, else the scans, else the poses of the odometry. ``pairing``:
    the stamps of the whole recording, None until the first pass over it has ended. ``recalls``: the
    computed recall curves, by the settings that they depend on.

    ``stamp``: the recording's files as they were opened. ``semaphore``: held while it is aligned.
    ``surveys`` count its frames' pairs, and give way to what ``activity`` counts.
    """

    def __init__(
        self,
        opened: RecordedStreams,
        stamp: FileStamp | None = None,
        semaphore: FairSemaphore | None = None,
        activity: Activity | None = None,
    ) -> None:
        self.opened = opened
        self._stamp = FileStamp.of(opened.recording.path) if stamp is None else stamp
        self._semaphore = FairSemaphore(1) if semaphore is None else semaphore
        # Whether its files have changed since: it must be opened again.
        self.is_outdated = False
        session, streams = opened.session, opened.streams
        self.frames: FrameReader | LoneStream = (
            LoneStream(opened.recording, streams.lidar or streams.odometry)
            if session is None
            else FrameReader(session)
        )
        self.chain: CachedChain | None = None
        self.failure: Exception | None = None
        self.pairing: PairingStamps | None = None
        self.recalls: dict[Hashable, RecallCurve] = {}
        self.progress = AlignmentProgress(done=0, total=None, what="waiting")
        self.surveys = SurveyRunner(activity)
        self._time_left = TimeLeft()
        self._notified_s = 0.0
        self._raw: BoundedCache[Hashable, RawFrame] = BoundedCache(_RAW_FRAMES_KEPT)
        self._sampled: BoundedCache[float, tuple[SeenScan, ...]] = BoundedCache(1)
        self._moved: BoundedCache[HandPose, CachedChain] = BoundedCache(_MOVED_KEPT)
        self._listeners: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._job: LongJob | None = None

    @property
    def recording(self) -> Recording:
        """The recording itself."""
        return self.opened.recording

    @property
    def can_be_fused(self) -> bool:
        """Whether it has a LiDAR and depth images; else ``opened.why_not_fused`` says why not."""
        return not self.opened.why_not_fused

    @cached_property
    def has_turning_lidar(self) -> bool:
        """Whether it is of a 3D LiDAR on a turning axis with a camera, and of no 2D LiDAR with a
        depth camera."""
        return not self.can_be_fused and bool(image_topic_of(self.recording))

    @property
    def fuse_session(self) -> Session:
        """The depth images with their rig, and the LiDAR where there is one.

        Raises MissingStream for a recording without depth images.
        """
        if self.opened.session is None:
            raise MissingStream(self.opened.why_not_fused, file=self.recording.path)
        return self.opened.session

    @cached_property
    def poses(self) -> PoseLookup | None:
        """The recorded poses of the LiDAR or, without one, of the robot; None without any."""
        opened = self.opened
        if opened.session is not None and opened.session.virtual_row is not None:
            return None
        return recorded_poses(opened.recording, opened.streams, opened.body_frame)

    def chain_at(self, pose: HandPose | None) -> CachedChain | None:
        """The chain with the camera at a pose, None for that of the alignment; None until the
        recording is aligned."""
        chain = self.chain
        if chain is None or pose is None:
            return chain
        return self._moved.get_or_compute(pose, lambda: chain.moved(pose.T_lidar_camera))

    def sampled_scans(self, clock_offset_ms: float = 0.0) -> tuple[SeenScan, ...]:
        """Scans with their images, spread over the recording. Those that cannot be read are left
        out."""
        return self._sampled.get_or_compute(
            clock_offset_ms, lambda: tuple(self._sample_scans(clock_offset_ms))
        )

    def _sample_scans(self, clock_offset_ms: float) -> Iterator[SeenScan]:
        frames = self.frames
        assert isinstance(frames, FrameReader), "poses are of depth cameras"
        count = min(_SAMPLED_FRAMES, len(frames))
        for number in np.unique(np.linspace(0, len(frames) - 1, count).round().astype(int)):
            try:
                seen = seen_scan(self.fuse_session, frames.pair(int(number), clock_offset_ms))
            except ScanLoomError:
                continue
            if seen is not None:
                yield seen

    def session_at(self, pose: HandPose | None) -> Session:
        """``fuse_session`` with the camera at a pose, None for where it is without one."""
        session = self.fuse_session
        return session if pose is None else move_session(session, pose.T_lidar_camera)

    def raw(self, number: int, pose: HandPose | None = None) -> RawFrame | None:
        """A frame without alignment, None without depth images. ``pose``: of the camera, where a
        person has set it. Raises RecordingError for one that cannot be read."""
        frames = self.frames
        if isinstance(frames, LoneStream):
            return None
        return self._raw.get_or_compute(
            (number, pose), lambda: raw_frame(self.session_at(pose), frames, number)
        )

    def lone(self, number: int) -> LoneFrame | None:
        """A frame of a recording without depth images, None of any other, and where there is none.
        Raises RecordingError for one that cannot be read."""
        frames = self.frames
        if isinstance(frames, FrameReader) or not len(frames):
            return None
        return lone_frame(frames, number)

    def color(self, number: int) -> ColorImage | None:
        """The colour image of a frame's depth camera, None where there is none."""
        return self.frames.color(number) if isinstance(self.frames, FrameReader) else None

    def camera_of(self, number: int) -> str:
        """The depth topic of a frame where there are several, else empty."""
        session = self.opened.session
        if session is None or len(session.rig.cameras) < 2 or isinstance(self.frames, LoneStream):
            return ""
        return session.rig.cameras[self.frames.camera_of(number)].topic

    def align(self, on_change: Callable[[], None]) -> None:
        """Start the alignment unless it runs or is done; ``on_change`` is called at each step.

        There is none of a recording that cannot be fused.
        """
        if not self.can_be_fused:
            return
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
            file=self.recording.path,
            advice="Reload the page: it is then opened again, as it is now.",
        )

    def cancel(self) -> None:
        """Cancel the alignment and the surveys at their next step."""
        self.surveys.close()
        if self._job is not None:
            self._job.cancel()

    def wait(self, timeout_s: float) -> bool:
        """Whether the alignment ended within the time, or was never started."""
        return self._job is None or self._job.wait(timeout_s)

    def _work(self, progress: Progress) -> CachedChain:
        alignment = self._align(progress)
        assert isinstance(self.frames, FrameReader), "what was aligned has depth images"
        chain = CachedChain(alignment.on_rig(self.fuse_session), self.frames, alignment)
        try:
            # Else the browsers' steps through the frames would wait for it.
            chain.prepare(lambda: progress(0, None, "preparing the steps"))
        except Cancelled:
            raise
        except Exception:  # noqa: BLE001  # it is reported where that frame is displayed
            pass
        return chain

    def _align(self, progress: Progress) -> RecordingAlignment:
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
        before = self.progress
        self.progress = AlignmentProgress(
            done=done, total=total, what=what, remaining_s=self._time_left.after(done, total, what)
        )
        now_s = time.monotonic()
        if before.what != what or now_s - self._notified_s > _NOTIFIED_EVERY_S:
            self._notified_s = now_s
            self._notify_listeners()

    def _finish(self, chain: object) -> None:
        assert isinstance(chain, CachedChain), "it is what the job returns"
        self.chain = chain
        self._notify_listeners()

    def _fail(self, error: Exception) -> None:
        self.failure = self.explain_read_error(error)
        self._notify_listeners()

    def _notify_listeners(self) -> None:
        with self._lock:
            listeners = list(self._listeners)
        for listener in listeners:
            listener()
