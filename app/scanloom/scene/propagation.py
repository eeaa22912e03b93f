"""The same place in neighbouring frames: labels that a person gives once for several."""

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, wrap_angle
from fusion_core.model.geometry import (
    invert_transform,
    planar_from_transform,
    transform_from_planar,
)
from fusion_core.model.labels import CaptureLabels
from scanloom.frame_view import FrameView
from scanloom.state.frame_runs import FrameRuns
from scanloom.state.review_queue import RunTable


def labels_around(
    frame_view: FrameView, table: RunTable, number: int, part: slice, label: int, beside: int
) -> list[CaptureLabels]:
    """A label for the place of a run's ``part`` in up to ``beside`` frames before and after, for
    samples of the run's sensor and class. The run's frame is the displayed one, else nothing."""
    match, opened = frame_view.match, frame_view.open_recording
    runs, run = table.runs(number)
    frame = int(table.frame[number])
    if match is None or frame_view.view.frame_index != frame or runs.scan is None:
        return []
    kind = int(runs.sensor[run]), int(runs.noise_class[run])
    pairs = match.correspondence
    _, own, _ = np.intersect1d(pairs.beam, runs.beam[part], return_indices=True)
    range_m = np.where(np.isfinite(pairs.lidar_range_m), pairs.lidar_range_m, pairs.camera_range_m)[
        own
    ]
    here = None if opened.poses is None else opened.poses.at(runs.scan.stamp_ns)
    found = []
    for other in range(frame - beside, frame + beside + 1):
        at = table.frames[other] if 0 <= other < len(table.frames) else None
        if at is None or other == frame or at.scan is None:
            continue
        there = None if opened.poses is None else opened.poses.at(at.scan.stamp_ns)
        pose = np.zeros(3) if here is None or there is None else _seen_from(here, there)
        directions_rad = moved_azimuths(pairs.azimuth_rad[own], range_m, pose)
        labels = labels_at_place(at, kind, match.scan.angles_rad, directions_rad, label)
        if labels is not None:
            found.append(labels)
    return found


def _seen_from(here: FloatArray, there: FloatArray) -> FloatArray:
    """(x, y, yaw) of ``there`` in the frame of ``here``."""
    T = invert_transform(transform_from_planar(here)) @ transform_from_planar(there)
    return planar_from_transform(T)


def moved_azimuths(azimuth_rad: FloatArray, range_m: FloatArray, pose: FloatArray) -> FloatArray:
    """(S,) directions of points, given by (S,) azimuth and range, as seen from another LiDAR.

    ``pose``: (3,) x, y, yaw of the other LiDAR in the frame of the first. A point without a range
    (NaN) is taken for one far away: its direction turns, and does not shift.
    """
    x = range_m * np.cos(azimuth_rad) - pose[0]
    y = range_m * np.sin(azimuth_rad) - pose[1]
    seen: FloatArray = np.where(np.isfinite(range_m), np.arctan2(y, x), azimuth_rad) - pose[2]
    return seen


def labels_at_place(
    runs: FrameRuns,
    kind: tuple[int, int],
    beams_rad: FloatArray,
    directions_rad: FloatArray,
    label: int,
) -> CaptureLabels | None:
    """A label for the samples of a frame that look in the directions between given ones and have
    the same sensor and automatic class; None where there are none.

    ``kind``: index into SENSORS, and code of NoiseClass. ``beams_rad``: (N,) azimuths of all beams.
    ``directions_rad``: (S,) of neighbouring samples.
    """
    middle = float(np.angle(np.exp(1j * directions_rad).mean()))
    beside = wrap_angle(directions_rad - middle)
    half_step = 0.5 * abs(float(beams_rad[1] - beams_rad[0])) if beams_rad.size > 1 else 0.0
    low, high = beside.min() - half_step, beside.max() + half_step
    found: list[IntArray] = []
    chosen = [
        run
        for run in range(len(runs))
        if (int(runs.sensor[run]), int(runs.noise_class[run])) == kind
    ]
    for run in chosen:
        own = runs.samples(run)
        at = wrap_angle(beams_rad[runs.beam[own]] - middle)
        found.append(own.start + np.flatnonzero((at >= low) & (at <= high)))
    places = np.concatenate(found) if found else np.zeros(0, dtype=np.int64)
    if not places.size:
        return None
    capture = runs.capture(chosen[0])
    row, column = runs.row[places].astype(np.int64), runs.column[places].astype(np.int64)
    return CaptureLabels.of_samples(capture, row, column, label)
