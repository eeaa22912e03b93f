"""What a step has found in the displayed frame: one sentence, before any number."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.conventions import wrap_angle
from fusion_core.model.extrinsics import ExtrinsicsEstimate, parameters_in_words
from fusion_core.model.labels import NO_LABEL
from fusion_core.model.number_text import counted
from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.frame import FusedFrame
from scanloom.frame_view import FrameView, failure_summary, missing_result_text
from scanloom.scene.frame_summary import (
    PairCounts,
    counts_of_beams,
    counts_of_pairs,
    counts_of_pixels,
)
from scanloom.scene.recording_text import alone_sentence, fused_sentence, notes_of_streams
from scanloom.state.possible_steps import map_mode_of, why_not
from scanloom.state.review_overlay import ReviewOverlay
from scanloom.state.slam_choices import choices_for, streams_of

# Samples: nearer than this, the peak with and without the recording's offset are the same.
_SAME_U = 2.0
_FROM_ELSEWHERE = (RepairSource.OTHER_SENSOR, RepairSource.NEIGHBOURS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """``sentence`` and ``detail`` are plain text. ``counts``: pairs by class, None without them."""

    sentence: str
    detail: str = ""
    counts: PairCounts | None = None


def verdict_of(frame_view: FrameView) -> Verdict:
    """The verdict of the view's step."""
    reason = why_not(frame_view.view.panel, frame_view.open_recording)
    if reason:
        return Verdict(sentence=reason.removesuffix("."))
    match frame_view.view.panel:
        case "Recording":
            return _recording(frame_view)
        case "Match":
            return _match(frame_view)
        case "Register":
            return _register(frame_view)
        case "Repair":
            return _repair(frame_view)
        case "Review":
            return _review(frame_view)
        case "Map":
            return _map(frame_view)
        case "Calibrate":
            return _calibrate(frame_view)


def _recording(frame_view: FrameView) -> Verdict:
    open_recording = frame_view.open_recording
    notes = notes_of_streams(open_recording)
    if not open_recording.can_be_fused:
        detail = " ".join(filter(None, [_failure_text(frame_view), notes]))
        return Verdict(sentence=alone_sentence(open_recording), detail=detail)
    sentence = fused_sentence(open_recording)
    if frame_view.chain is None:
        missing = missing_result_text(frame_view)
        return Verdict(sentence=sentence, detail=f"{missing} {notes}".rstrip())
    yaw_deg = float(np.rad2deg(wrap_angle(frame_view.chain.alignment.mount.yaw_rad)))
    side = "left" if yaw_deg > 0.0 else "right"
    who = "camera" if len(frame_view.chain.session.rig.cameras) == 1 else "rig of cameras"
    looks = "straight ahead" if abs(yaw_deg) < 0.5 else f"{abs(yaw_deg):.1f}° to the {side}"
    return Verdict(
        sentence=sentence,
        detail=f"Seen from the LiDAR, the {who} looks {looks}: {_source(frame_view.chain)}. "
        f"{notes}".rstrip(),
    )


def _source(chain: CachedChain) -> str:
    given = chain.session.rig.given
    return "found from the recording itself" if given is None else f"by {given.source}"


def _failure_text(frame_view: FrameView) -> str:
    """Why the displayed frame of a recording that is not fused is missing; empty if it is there."""
    failure = frame_view.failure
    return "" if failure is None else f"{failure_summary(failure)} {failure.advice}"


def _match(frame_view: FrameView) -> Verdict:
    match = frame_view.match
    if match is None:
        return Verdict(sentence="Not matched", detail=missing_result_text(frame_view))
    metric = frame_view.view.settings.search.metric
    peak = match.search.peaks.get(metric)
    if peak is None:
        return Verdict(
            sentence="No offset has enough samples on both sides",
            detail="Lower the minimum overlap.",
        )
    if frame_view.view.picked_offset is not None:
        u, v = frame_view.view.picked_offset
        return Verdict(
            sentence=f"Laid on row {v:.0f} by hand",
            detail=f"At offset u = {u:.1f}; the best fit is at u = {peak.u:.1f}, v = {peak.v:.0f}.",
        )
    detail = f"At offset u = {peak.u:.1f} samples; similarity {peak.score:.2f} of 1."
    alone = match.search.peaks_without_prior.get(metric)
    if alone is not None and abs(alone.u - peak.u) > _SAME_U:
        detail += (
            f" Held near the recording's offset: elsewhere this frame scores more "
            f"(u = {alone.u:.1f}, {alone.score:.2f})."
        )
    return Verdict(sentence=f"The LiDAR curve fits best at row {peak.v:.0f}", detail=detail)


def _register(frame_view: FrameView) -> Verdict:
    match = frame_view.match
    if match is None:
        return Verdict(sentence="Not registered", detail=missing_result_text(frame_view))
    found = match.registration
    if found is None:
        return Verdict(
            sentence="No transform fits this frame's pairs",
            detail=f"{match.refusal} Beams and pixels are compared without it.",
        )
    inliers = int(found.inliers.sum())
    detail = "It sends a point of the LiDAR to infinity: there is no mean difference."
    if np.isfinite(found.mean_error_m):
        error_cm = f"{100.0 * found.mean_error_m:.1f} cm"
        detail = f"After it LiDAR and camera differ by {error_cm} in the mean."
    return Verdict(
        sentence=f"{inliers} of {found.valid} pairs of beam and pixel agree on one transform",
        detail=detail,
    )


def _repair(frame_view: FrameView) -> Verdict:
    fused = frame_view.fused
    if fused is None:
        return Verdict(sentence="Not classified", detail=missing_result_text(frame_view))
    pairs = counts_of_pairs(fused)
    return Verdict(
        sentence=f"{pairs.by_class[NoiseClass.GOOD]} of {pairs.total} beams agree with the camera",
        detail=_repaired_text(fused, pairs.without_pixel),
        counts=pairs,
    )


def _repaired_text(fused: FusedFrame, without_pixel: int) -> str:
    filled = []
    for counts, what in ((counts_of_beams(fused), "range"), (counts_of_pixels(fused), "depth")):
        missing_or_wrong = sum(counts.by_source.values())
        changed = (counts.by_source[source] for source in _FROM_ELSEWHERE)
        if missing_or_wrong:
            filled.append(f"{sum(changed)} of {counted(missing_or_wrong, what)}")
    text = f"Filled or corrected: {', '.join(filled)}." if filled else "There is nothing to repair."
    if without_pixel:
        text += f" {counted(without_pixel, 'good beam')} outside the image."
    return text


def _review(frame_view: FrameView) -> Verdict:
    review = frame_view.review
    if review is None:
        return Verdict(
            sentence="Say what is noise, and what is not",
            detail="Run after run, by one key each. Your labels are kept as you give them, and a "
            "repair can follow them.",
        )
    beams = int((review.beam_labels != NO_LABEL).sum())
    pixels = int((review.pixel_labels != NO_LABEL).sum())
    detail = missing_result_text(frame_view) if frame_view.fused is None else ""
    if not beams and not pixels:
        return Verdict(sentence="Nothing of this frame is labelled yet", detail=detail)
    return Verdict(
        sentence=f"{counted(beams, 'beam')} and {counted(pixels, 'pixel')} of this frame labelled",
        detail=f"{_unpaired_text(frame_view, review)} {detail}".strip(),
    )


def _unpaired_text(frame_view: FrameView, review: ReviewOverlay) -> str:
    """Labels that belong to no pair of the frame, as the mount and the settings are now."""
    match = frame_view.match
    if match is None:
        return ""
    pairs = match.correspondence
    is_beam, is_pixel = review.beam_labels != NO_LABEL, review.pixel_labels != NO_LABEL
    is_beam[pairs.beam] = False
    has_pixel = pairs.row >= 0
    is_pixel[pairs.row[has_pixel], pairs.column[has_pixel]] = False
    beams, pixels = int(is_beam.sum()), int(is_pixel.sum())
    said = [
        counted(number, what) for number, what in ((beams, "beam"), (pixels, "pixel")) if number
    ]
    return f"Of these {' and '.join(said)} without a pair now." if said else ""


def _map(frame_view: FrameView) -> Verdict:
    is_slam = map_mode_of(frame_view.view, frame_view.open_recording) == "SLAM"
    held = streams_of(frame_view.open_recording.opened)
    if is_slam and choices_for(frame_view.view.slam, held).is_visual:
        return Verdict(
            sentence="Build a map in space by visual SLAM",
            detail="Of the whole recording: the pose of every image, and what they show.",
        )
    if is_slam:
        return Verdict(
            sentence="Build a map by SLAM",
            detail="Of the whole recording: the pose of every scan, and the map that they make.",
        )
    if frame_view.chain is None:
        return Verdict(sentence="No map yet", detail=missing_result_text(frame_view))
    return Verdict(
        sentence="Build the map of the whole recording",
        detail="From the LiDAR alone, the camera alone, and both.",
    )


def _calibrate(frame_view: FrameView) -> Verdict:
    shown = frame_view.calibration
    if frame_view.open_recording.has_turning_lidar:
        if frame_view.found_pose is not None:
            return _found(frame_view.found_pose)
        return Verdict(
            sentence="A turning LiDAR and a camera: find their pose",
            detail="From what both see of the scene, without a target.",
        )
    if shown is None:
        return Verdict(sentence="No pose yet", detail=missing_result_text(frame_view))
    now = shown.now.agreement
    if not now.on_depth:
        return Verdict(
            sentence="By this pose the camera sees nothing that the LiDAR measures",
            detail="Undo, or reset the pose.",
        )
    where = f"of the LiDAR's points in {counted(now.frames, 'image')} lie on what the camera sees"
    detail = (
        f"Of {now.on_depth:,} points where the image has depth; half of them differ by less than "
        f"{100.0 * now.median_m:.1f} cm."
    )
    before = None if shown.before is None else shown.before.agreement
    if before is not None and before.on_depth:
        detail += (
            f" Before: {before.fraction:.0%}, {100.0 * before.median_m:.1f} cm. "
            "All steps use the pose as it is now."
        )
    return Verdict(sentence=f"{now.fraction:.0%} {where}", detail=detail)


def _found(estimate: ExtrinsicsEstimate) -> Verdict:
    """What a calibration of a turning LiDAR and a camera has found."""
    if estimate.T_guess is not None and not estimate.improved:
        return Verdict(sentence="The guess is kept: no better pose was found")
    sentence = "The camera's pose is found"
    if estimate.reprojection_rms_px is not None:
        error_px = f"{estimate.reprojection_rms_px:.2f} px"
        sentence += f": pairs that were held out are {error_px} off (RMS)"
    unknown = parameters_in_words(estimate.unobservable)
    how_sure = f"Not observable: {unknown}. " if unknown else ""
    return Verdict(
        sentence=sentence,
        detail=f"{how_sure}The evidence is below; saved as a file, the pose serves other "
        "recordings of this rig.",
    )
