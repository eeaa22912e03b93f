"""The results that the panels and the scene display for one view, computed once for all."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.sensors import ColorImage
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.pairing import PairedImage
from scanloom.jobs.long_job import Cancelled
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import View


@dataclass(frozen=True, kw_only=True)
class FrameView:
    """A view and its results. A result that could not be computed is None; ``failure`` says why.

    ``chain`` is None while the recording is being aligned. ``frame`` is a FrameMatch where the
    classification or the repair failed.
    """

    view: View
    open_recording: OpenRecording
    chain: CachedChain | None = None
    paired: PairedImage | None = None
    frame: FusedFrame | FrameMatch | None = None
    color: ColorImage | None = None
    failure: ScanLoomError | None = None

    @property
    def match(self) -> FrameMatch | None:
        """The matched frame, None if it could not be matched."""
        return self.frame.match if isinstance(self.frame, FusedFrame) else self.frame

    @property
    def fused(self) -> FusedFrame | None:
        """The classified and repaired frame, None if a stage failed."""
        return self.frame if isinstance(self.frame, FusedFrame) else None


def clock_offset_ms(view: View, chain: CachedChain) -> float:
    """The offset subtracted from the camera's stamps: the mount's if applied, else 0."""
    return chain.alignment.mount.clock_offset_ms if view.apply_clock_offset else 0.0


def as_failure(error: Exception) -> ScanLoomError:
    """Any exception as an error with a message for the user."""
    if isinstance(error, ScanLoomError):
        return error
    return ScanLoomError(
        f"Something failed: {type(error).__name__}: {error}.",
        advice="Go to another frame, or undo the last change.",
    )


def failure_summary(failure: ScanLoomError) -> str:
    """The problem, after the name of the file if there is one."""
    return f"{Path(failure.file).name}: {failure.problem}" if failure.file else failure.problem


def alignment_progress_text(open_recording: OpenRecording) -> str:
    """The progress of the alignment, as text."""
    step = open_recording.progress
    count = f", {step.done} of {step.total}" if step.total else ""
    # numba compiles the loops on first use and caches them on disk.
    patience = "" if step.done else " The first time takes up to a minute."
    return f"Aligning the recording: {step.what}{count}.{patience}"


def missing_result_text(frame_view: FrameView) -> str:
    """Why a stage has no result, and what to do about it."""
    if frame_view.failure is not None:
        return f"{failure_summary(frame_view.failure)} {frame_view.failure.advice}"
    if frame_view.chain is None:
        return alignment_progress_text(frame_view.open_recording)
    return "This frame could not be classified."


def compute_frame_view(
    view: View, open_recording: OpenRecording, check: Callable[[], None] = lambda: None
) -> FrameView:
    """Compute the results of a view; if a stage fails, those of earlier stages are kept.

    ``check`` is called between stages and may raise Cancelled. A frame index beyond the recording's
    end, as in an old link, means the last frame.
    """
    view = view.model_copy(
        update={"frame_index": min(view.frame_index, len(open_recording.frames) - 1)}
    )
    chain = open_recording.chain
    if chain is None:
        failure = None if open_recording.failure is None else as_failure(open_recording.failure)
        return FrameView(view=view, open_recording=open_recording, failure=failure)
    choice = FrameChoice(
        number=view.frame_index,
        clock_offset_ms=clock_offset_ms(view, chain),
        picked_offset=view.picked_offset,
    )
    paired = color = None
    frame: FusedFrame | FrameMatch | None = None
    failure = None
    try:
        paired = chain.pair(choice)
        check()
        frame = chain.match(choice, view.settings)
        check()
        frame = chain.fused(choice, view.settings)
        check()
    except Cancelled:
        raise
    except Exception as error:  # noqa: BLE001  # results of earlier stages are displayed
        failure = as_failure(open_recording.explain_read_error(error))
    try:
        color = open_recording.frames.color(choice.number)
    except Exception as error:  # noqa: BLE001  # the colour image is only displayed
        failure = failure or as_failure(open_recording.explain_read_error(error))
    return FrameView(
        view=view,
        open_recording=open_recording,
        chain=chain,
        paired=paired,
        frame=frame,
        color=color,
        failure=failure,
    )
