"""A frame's labels and marked samples, as its pictures show them."""

from collections.abc import Callable, Iterable

import numpy as np

from fusion_core.model.conventions import IntArray
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels
from fusion_core.workflows.fuse.captures import FrameCaptures, frame_captures
from fusion_core.workflows.fuse.frame_labels import ImageLabels
from scanloom.frame_view import FrameView
from scanloom.state.review_overlay import ReviewOverlay


def captures_of(frame_view: FrameView) -> FrameCaptures | None:
    """The captures of the displayed frame, None where it is not matched."""
    match = frame_view.match
    return None if match is None else frame_captures(match, frame_view.session)


def review_overlay(
    frame_view: FrameView,
    labels_of: Callable[[Capture], CaptureLabels],
    marked: Iterable[CaptureLabels],
) -> ReviewOverlay | None:
    """What is shown of the labels in a frame, and of the marked samples, which may be those of
    other frames. None where the frame is not matched."""
    captures, match = captures_of(frame_view), frame_view.match
    if captures is None or match is None:
        return None
    beams = match.scan.ranges_m.size
    beam_labels: IntArray = np.full(beams, NO_LABEL)
    if captures.scan is not None:
        beam_labels = labels_of(captures.scan).as_image()[0]
    chosen: dict[Capture | None, CaptureLabels] = {labels.capture: labels for labels in marked}
    selected_beams = np.zeros(beams, dtype=np.bool_)
    if (on_scan := chosen.get(captures.scan)) is not None:
        selected_beams[on_scan.column] = True
    selected = chosen.get(captures.image)
    return ReviewOverlay(
        beam_labels=beam_labels,
        pixel_labels=ImageLabels(stored=labels_of(captures.image), view=captures.view).upright(),
        selected_beams=selected_beams,
        selected_pixels=ImageLabels(stored=selected, view=captures.view).upright() != NO_LABEL,
        is_blind=frame_view.view.review.blind,
    )
