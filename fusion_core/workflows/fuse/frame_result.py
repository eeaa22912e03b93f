"""What the results of a run take of a fused frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fusion_core.model.classes import NoiseClass, is_one_of, is_repaired
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.session import FrameSetup
from fusion_core.workflows.fuse.table_1 import score_range
from fusion_core.workflows.fuse.tables import frame_row, sample_columns


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameResult:
    """A fused frame without its fields and images: small enough to come from another process.

    ``row``: of frames.csv; ``samples``: rows of samples.parquet. For each of the B pairs: ``beam``
    of the scan, its ``azimuth_rad``, ``lidar_repaired_m`` and ``lidar_class``; ``is_confirmed``:
    whether the camera or a person confirms the beam's return; ``camera_range_m`` as in FusedFrame.

    Of the pairs with a stored pixel: ``pixel_row``, ``pixel_column``, its ``pixel_class`` and
    ``pixel_repaired_m``, NaN where the repair did not change it.

    ``score_range``: the column of Table 1, None where an image of the same panorama is counted.
    ``rank``: how well the frame shows what the chain does; the greater is the better.
    """

    camera: int
    stamp_ns: int
    gap_ns: int
    row: dict[str, object]
    samples: dict[str, npt.NDArray[Any]]
    beam: IntArray
    azimuth_rad: FloatArray
    lidar_repaired_m: FloatArray
    lidar_class: IntArray
    is_confirmed: BoolArray
    camera_range_m: FloatArray
    pixel_row: IntArray
    pixel_column: IntArray
    pixel_class: IntArray
    pixel_repaired_m: Float32Array
    score_range: str | None
    rank: tuple[bool, int]


def results_of(
    frames: Sequence[FusedFrame], alignment: RecordingAlignment, setup: FrameSetup
) -> list[FrameResult]:
    """The results of images that were fused together."""
    results = []
    for place, frame in enumerate(frames):
        # The images of a panorama share its search.
        is_counted = any(frame.match.search is other.match.search for other in frames[:place])
        peak = frame.match.search.peaks_without_prior.get("pearson")
        results.append(
            _result_of(frame, alignment, setup, None if is_counted else score_range(peak))
        )
    return results


def _result_of(
    frame: FusedFrame, alignment: RecordingAlignment, setup: FrameSetup, scores_in: str | None
) -> FrameResult:
    match, classes = frame.match, frame.classes
    pairs, camera = match.correspondence, match.pair.camera_index
    topic = setup.rig.cameras[camera].topic
    row, column = setup.rig.views[camera].stored_pixels(pairs.row, pairs.column)
    known = row >= 0
    repaired_m = np.where(frame.pixel_changed, frame.repair.depth_m, np.nan).astype(np.float32)
    return FrameResult(
        camera=camera,
        stamp_ns=match.stamp_ns,
        gap_ns=match.pair.gap_ns,
        row=frame_row(topic, frame, alignment, setup.rig),
        samples=sample_columns(topic, frame, setup.rig),
        beam=pairs.beam,
        azimuth_rad=pairs.azimuth_rad,
        lidar_repaired_m=frame.repair.lidar_range_m,
        lidar_class=classes.lidar_class,
        is_confirmed=confirmed_beams(frame),
        camera_range_m=frame.camera_range_m,
        pixel_row=row[known],
        pixel_column=column[known],
        pixel_class=classes.depth_class[known],
        pixel_repaired_m=repaired_m[known],
        score_range=scores_in,
        rank=rank_of(frame, alignment),
    )


def confirmed_beams(frame: FusedFrame) -> BoolArray:
    """(B,) beams whose returns the camera or a person confirms."""
    classes = frame.classes
    confirmed: BoolArray = classes.lidar_class == NoiseClass.GOOD
    confirmed &= np.isfinite(frame.match.correspondence.residual_m)
    by_person = is_one_of(classes.lidar_class, NoiseClass.GOOD, NoiseClass.CONFLICT)
    return confirmed | (classes.lidar_decided & by_person)


def rank_of(frame: FusedFrame, alignment: RecordingAlignment) -> tuple[bool, int]:
    """Frames with an overlap of at least half and a registration first, then those with most
    repaired samples."""
    peak = frame.match.search.peaks.get(alignment.metric)
    is_sound = frame.match.registration is not None and peak is not None and peak.overlap >= 0.5
    sources = np.concatenate([frame.repair.lidar_source, frame.repair.depth_source])
    return is_sound, int(is_repaired(sources).sum())
