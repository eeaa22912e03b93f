"""What is known of a frame of the recording, in a line of text. For people frames count from 1."""

from fusion_core.model.classes import NoiseClass
from scanloom.plots.frame_times import FrameTimes
from scanloom.state.frame_survey import FrameCounts, FrameStatus

_UNKNOWN: dict[FrameStatus, str] = {
    FrameStatus.UNKNOWN: "not counted yet",
    FrameStatus.UNMATCHED: "not matched",
    FrameStatus.NO_SCAN: "no scan near enough in time",
    FrameStatus.UNREADABLE: "cannot be read",
}


def frame_name(frame_index: int) -> str:
    """A frame's name for people."""
    return f"frame {frame_index + 1:,}"


def frame_text(times: FrameTimes, counts: FrameCounts | None, frame_index: int) -> str:
    """A frame's number, time and noise."""
    whole = f"{frame_name(frame_index)} of {times.times_s.size:,}"
    parts = [whole, f"{times.times_s[frame_index]:.2f} s"]
    if counts is not None:
        parts.append(_noise_text(counts, frame_index))
    return " · ".join(parts)


def _noise_text(counts: FrameCounts, frame_index: int) -> str:
    status = FrameStatus(counts.status[frame_index])
    if status in _UNKNOWN:
        return _UNKNOWN[status]
    pairs = counts.counts[frame_index].astype(int)
    found = [
        f"{pairs[kind]} {kind.name.lower()}{'' if pairs[kind] == 1 else 's'}"
        for kind in (NoiseClass.HOLE, NoiseClass.BURR, NoiseClass.CONFLICT)
        if pairs[kind]
    ]
    text = f"{', '.join(found) or 'no noise'} in {pairs.sum()} pairs"
    return f"{text}, offset not trusted" if status == FrameStatus.UNTRUSTED else text


def progress_text(counts: FrameCounts | None) -> str:
    """How far the frames are counted; empty once all of a short recording are."""
    if counts is None:
        return ""
    if not counts.is_complete:
        return f"counting noise: {counts.done:,} of {counts.total:,} frames"
    if counts.is_sampled:
        return f"noise of every {round(counts.status.size / counts.total)}th frame"
    return ""
