"""The results that the panels and the scene display for one view, computed once for all."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.labels import LabelLayer
from fusion_core.model.sensors import ColorImage
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import Session
from scanloom.jobs.long_job import Cancelled
from scanloom.jobs.time_left import time_left_text
from scanloom.state.calibration_view import CalibrationView, pose_view
from scanloom.state.frame_survey import SurveyInputs
from scanloom.state.open_recording import OpenRecording
from scanloom.state.possible_steps import why_not
from scanloom.state.raw_frame import LoneFrame, RawFrame
from scanloom.state.review_overlay import ReviewOverlay
from scanloom.state.view import View


@dataclass(frozen=True, kw_only=True)
class FrameView:
    """A view and its results. A result that could not be computed is None; ``failure`` says why.

    ``chain`` is None while the recording is being aligned, and where that failed: then ``raw`` is
    the frame as it was recorded. Of a recording without a LiDAR there is never more than ``raw``,
    of one without depth images never more than ``lone``. ``frame`` is a FrameMatch where the
    classification or the repair failed, or is hidden in a blind review. ``review``: the frame's
    labels, while it is reviewed. ``calibration``: in that step alone. ``found_pose``: of the camera
    and a turning LiDAR, once it was calibrated in this browser. ``is_dark``: whether it is shown on
    a dark page.
    """

    view: View
    open_recording: OpenRecording
    chain: CachedChain | None = None
    paired: PairedImage | None = None
    frame: FusedFrame | FrameMatch | None = None
    color: ColorImage | None = None
    failure: ScanLoomError | None = None
    is_dark: bool = False
    raw: RawFrame | None = None
    lone: LoneFrame | None = None
    review: ReviewOverlay | None = None
    calibration: CalibrationView | None = None
    found_pose: ExtrinsicsEstimate | None = None

    @property
    def is_being_aligned(self) -> bool:
        """Whether the results of all stages are still to come."""
        opened = self.open_recording
        return self.chain is None and opened.failure is None and opened.can_be_fused

    def differs_in_progress_only(self, before: "FrameView | None") -> bool:
        """Whether it shows the same as ``before``, but for the progress of the alignment."""
        return (
            before is not None
            and self.is_being_aligned
            and (self.view, self.failure) == (before.view, before.failure)
            and self.open_recording is before.open_recording
            and self.raw is before.raw
            and self.is_dark == before.is_dark
            and before.chain is None
        )

    @property
    def session(self) -> Session:
        """The depth images with their rig, where the view has it. Raises MissingStream without
        depth images."""
        if self.chain is not None:
            return self.chain.session
        return self.open_recording.session_at(self.view.hand_pose)

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


def given_extrinsics(
    frame_view: FrameView, of_server: GivenExtrinsics | None
) -> GivenExtrinsics | None:
    """The extrinsics that a person gives for a view: by hand, else ``of_server``, those with which
    its recording is opened; None where they are the recording's own."""
    if frame_view.view.hand_pose is None or not frame_view.open_recording.can_be_fused:
        return of_server
    rig = frame_view.session.rig
    assert rig.given is not None, "a moved rig is given"
    poses: dict[str | None, CameraPose] = {
        camera.topic: pose for camera, pose in zip(rig.cameras, rig.given.poses, strict=True)
    }
    return GivenExtrinsics(source=rig.given.source, cameras=poses)


def survey_inputs(frame_view: FrameView) -> SurveyInputs | None:
    """What a survey of the recording counts with the settings of a view; None before it is
    aligned."""
    chain, view = frame_view.chain, frame_view.view
    if chain is None:
        return None
    return SurveyInputs(
        chain=chain,
        settings=view.settings,
        clock_offset_ms=clock_offset_ms(view, chain),
        pairing=frame_view.open_recording.pairing,
    )


def is_blind(view: View) -> bool:
    """Whether the automatic classes are hidden."""
    return view.panel == "Review" and view.review.blind


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
    count = f", {step.done} of {step.total} images" if step.total else ""
    # numba compiles the loops on first use and caches them on disk.
    rest = "" if step.done else " The first time takes up to a minute."
    if step.remaining_s is not None:
        rest = f" {time_left_text(step.remaining_s)}"
    return f"Aligning the recording: {step.what}{count}.{rest}"


def missing_result_text(frame_view: FrameView) -> str:
    """Why a stage has no result, and what to do about it."""
    if frame_view.failure is not None:
        return f"{failure_summary(frame_view.failure)} {frame_view.failure.advice}"
    if not frame_view.open_recording.can_be_fused:
        return frame_view.open_recording.opened.why_not_fused
    if is_blind(frame_view.view):
        return "The automatic classes are hidden: this is a blind review."
    if frame_view.chain is None:
        return "The recording is still being aligned. The bar at the top says how far that is."
    return "This frame could not be classified."


def compute_frame_view(
    view: View,
    open_recording: OpenRecording,
    check: Callable[[], None] = lambda: None,
    layer_of: Callable[[str], LabelLayer] | None = None,
) -> FrameView:
    """Compute the results of a view; if a stage fails, those of earlier stages are kept.

    ``layer_of``: the layer of a name, whose labels overrule the classes where the view names one;
    not in the review, which asks about the automatic ones.

    ``check`` is called between stages and may raise Cancelled. A frame index beyond the recording's
    end, as in an old link, means the last frame.
    """
    view = view.model_copy(
        update={"frame_index": max(min(view.frame_index, len(open_recording.frames) - 1), 0)}
    )
    chain = open_recording.chain_at(view.hand_pose)
    if chain is None:
        return _raw_frame_view(view, open_recording)
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
        if not is_blind(view):
            labels = None
            if layer_of is not None and view.label_layer and view.panel != "Review":
                labels = layer_of(view.label_layer)
            frame = chain.fused(choice, view.settings, labels)
        check()
    except Cancelled:
        raise
    except Exception as error:  # noqa: BLE001  # results of earlier stages are displayed
        failure = as_failure(open_recording.explain_read_error(error))
    calibration = None
    try:
        if view.panel == "Calibrate" and paired is not None:
            calibration = _calibration_view(view, open_recording, chain, paired)
    except Exception as error:  # noqa: BLE001  # the frame itself is displayed
        failure = failure or as_failure(open_recording.explain_read_error(error))
    try:
        color = open_recording.color(choice.number)
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
        calibration=calibration,
    )


def _calibration_view(
    view: View, open_recording: OpenRecording, chain: CachedChain, paired: PairedImage
) -> CalibrationView | None:
    """None where there is nothing to calibrate."""
    if why_not("Calibrate", open_recording):
        return None
    sampled = open_recording.sampled_scans(clock_offset_ms(view, chain))
    base, before = open_recording.chain, None
    if base is not None and base is not chain:
        before = pose_view(base, paired, sampled)
    return CalibrationView(now=pose_view(chain, paired, sampled), before=before)


def _raw_frame_view(view: View, open_recording: OpenRecording) -> FrameView:
    """The frame as it was recorded, with the failure of the alignment if it has failed."""
    raw = lone = color = failure = None
    try:
        lone = open_recording.lone(view.frame_index)
        raw = open_recording.raw(view.frame_index, view.hand_pose)
        color = open_recording.color(view.frame_index)
    except Exception as error:  # noqa: BLE001  # what could be read is displayed
        failure = as_failure(open_recording.explain_read_error(error))
    if open_recording.failure is not None:
        failure = as_failure(open_recording.failure)
    return FrameView(
        view=view,
        open_recording=open_recording,
        paired=None if raw is None else raw.paired,
        color=color,
        failure=failure,
        raw=raw,
        lone=lone,
    )
