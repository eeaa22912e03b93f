"""What is known of the sample under the pointer, in a few lines of text."""

from dataclasses import replace

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.workflows.fuse.frame import FusedFrame
from scanloom.frame_view import FrameView
from scanloom.state.hover import Hover


def linked(frame_view: FrameView, hover: Hover) -> Hover:
    """``hover`` with what the displayed frame knows of the same sample in the other views."""
    match = frame_view.match
    if match is None or hover.beam is None or hover.row is not None:
        return hover
    pairs = match.correspondence
    at = np.flatnonzero((pairs.beam == hover.beam) & (pairs.row >= 0))
    if not at.size:
        return hover
    row, column = int(pairs.row[at[0]]), int(pairs.column[at[0]])
    return replace(hover, row=row, column=column, v=float(row))


def readout_text(frame_view: FrameView, hover: Hover) -> str:
    """The read-out of a sample, in lines; empty where nothing is known.

    The pointer may be on a picture of another frame: the place need not be in this one.
    """
    lines = []
    if hover.source == "similarity":
        lines += _of_offset(frame_view, hover)
    elif hover.row is not None and hover.column is not None:
        lines += _of_pixel(frame_view, hover.row, hover.column)
    if hover.beam is not None:
        lines += _of_beam(frame_view, hover.beam)
    return "\n".join(lines)


def _of_offset(frame_view: FrameView, hover: Hover) -> list[str]:
    match = frame_view.match
    if match is None or hover.u is None or hover.v is None:
        return []
    place = f"offset u = {hover.u:.0f} samples, row v = {hover.v:.0f}"
    if frame_view.view.field_scope != "frame":
        return [place]
    field = match.search.fields[frame_view.view.settings.search.metric]
    v, column = round(hover.v), round(hover.u) - field.u_first
    rows, columns = field.scores.shape
    if not (0 <= v < rows and 0 <= column < columns):
        return [place]
    score = float(field.scores[v, column])
    if np.isnan(score):
        return [place, "no score: too few samples on both sides"]
    return [place, f"similarity {score:.2f} of 1"]


def _of_pixel(frame_view: FrameView, row: int, column: int) -> list[str]:
    match, place = frame_view.match, f"row {row}, column {column}"
    if match is None:
        return [place]
    rows, columns = match.depth_m.shape
    if not (0 <= row < rows and 0 <= column < columns):
        return [place]
    depth_m = float(match.depth_m[row, column])
    depth = "no depth" if np.isnan(depth_m) else f"depth {depth_m:.2f} m"
    return [f"{place}: {depth}"]


def _of_beam(frame_view: FrameView, beam: int) -> list[str]:
    match, fused = frame_view.match, frame_view.fused
    if match is None:
        return []
    pairs = match.correspondence
    found = np.flatnonzero(pairs.beam == beam)
    if not found.size:
        scan = match.scan
        if beam >= scan.ranges_m.size:
            return []
        return [f"beam {beam}: LiDAR {_length(scan.ranges_m[beam])}, outside the camera's view"]
    at = int(found[0])
    azimuth_deg = float(np.rad2deg(pairs.azimuth_rad[at]))
    side = "left" if azimuth_deg >= 0.0 else "right"
    lines = [
        f"beam {beam}, {abs(azimuth_deg):.1f}° {side}",
        f"LiDAR {_length(pairs.lidar_range_m[at])}, camera {_length(pairs.depth_as_range_m[at])}",
    ]
    return lines if fused is None else [*lines, _classes(fused, at)]


def _classes(fused: FusedFrame, at: int) -> str:
    beam, pixel = int(fused.classes.lidar_class[at]), int(fused.classes.depth_class[at])
    text = f"beam: {NoiseClass(beam).name.lower()}"
    return text if pixel < 0 else f"{text}, pixel: {NoiseClass(pixel).name.lower()}"


def _length(length_m: float) -> str:
    return f"{length_m:.2f} m" if np.isfinite(length_m) else "nothing"
