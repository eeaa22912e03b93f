"""All that the panels and the scene need to show one view: computed once, read by each of them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.sensors import ColorImage
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.frame import FrameMatch, FusedFrame
from fusion_core.workflows.fuse.pairing import PairedImage
from scanloom.jobs.long_job import Cancelled
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import View


@dataclass(frozen=True, kw_only=True)
class FrameView:
    """One view and what came of it. What could not be had is None, and ``failure`` says why.

    ``chain`` is None while the recording is being aligned.
    """

    view: View
    open_recording: OpenRecording
    chain: CachedChain | None = None
    paired: PairedImage | None = None
    match: FrameMatch | None = None
    fused: FusedFrame | None = None
    color: ColorImage | None = None
    failure: ScanLoomError | None = None


def clock_offset_ms(view: View, chain: CachedChain) -> float:
    """The offset that is taken out of the camera's stamps: the mount's, where asked for."""
    return chain.alignment.mount.clock_offset_ms if view.apply_clock_offset else 0.0


def as_failure(error: Exception) -> ScanLoomError:
    """A failure in words for a person, whatever failed."""
    if isinstance(error, ScanLoomError):
        return error
    return ScanLoomError(
        f"Something failed: {type(error).__name__}: {error}.",
        advice="Go to another frame, or take back the last change with Undo.",
    )


def failure_summary(failure: ScanLoomError) -> str:
    """What is wrong, with the name of the file where it is one: often that is the subject."""
    return f"{Path(failure.file).name}: {failure.problem}" if failure.file else failure.problem


def alignment_progress_text(open_recording: OpenRecording) -> str:
    """How far the alignment is."""
    step = open_recording.progress
    count = f", {step.done} of {step.total}" if step.total else ""
    # The loops are compiled when they are met first, and kept for later runs.
    patience = "" if step.done else " The very first time takes up to a minute."
    return f"Aligning the recording: {step.what}{count}.{patience}"


def missing_result_text(frame_view: FrameView) -> str:
    """Why a stage has nothing to show, and what to do about it."""
    if frame_view.failure is not None:
        return f"{failure_summary(frame_view.failure)} {frame_view.failure.advice}"
    if frame_view.chain is None:
        return alignment_progress_text(frame_view.open_recording)
    return "This frame could not be judged."


def compute_frame_view(
    view: View, open_recording: OpenRecording, check: Callable[[], None] = lambda: None
) -> FrameView:
    """Compute a view; a stage that fails leaves what came before it.

    ``check`` is called between the stages, and raises Cancelled where nobody looks any more.

    A frame beyond the recording's last, as an old link may ask for, is its last.
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
    paired = match = fused = color = None
    failure = None
    try:
        paired = chain.pair(choice)
        check()
        match = chain.match(choice, view.settings)
        check()
        fused = chain.fused(choice, view.settings)
        check()
    except Cancelled:
        raise
    except Exception as error:  # noqa: BLE001  # what came before the stage that fails is shown
        failure = as_failure(open_recording.explain_read_error(error))
    try:
        color = open_recording.frames.color(choice.number)
    except Exception as error:  # noqa: BLE001  # the colour image is for looking only
        failure = failure or as_failure(open_recording.explain_read_error(error))
    return FrameView(
        view=view,
        open_recording=open_recording,
        chain=chain,
        paired=paired,
        match=match,
        fused=fused,
        color=color,
        failure=failure,
    )
