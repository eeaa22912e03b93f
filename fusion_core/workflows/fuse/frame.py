"""An image and its scan, matched, classified and repaired."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import cv2
import numpy as np

from fusion_core.alignment.scan_motion import neighbour_seen_from
from fusion_core.alignment.time import ScanWindow, TimeSettings
from fusion_core.denoising.correspondence import Correspondence, pixels_met
from fusion_core.denoising.neighbourhood import FrameWindow
from fusion_core.denoising.noise import Classification, classify
from fusion_core.denoising.noise_settings import NoiseSettings
from fusion_core.denoising.overruling import is_rejected, overrule
from fusion_core.denoising.repair import Repair, repair
from fusion_core.model.conventions import NS_PER_S, BoolArray, Float32Array, FloatArray, IntArray
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.align import RecordingAlignment, T_lidar_camera_at
from fusion_core.workflows.fuse.frame_labels import (
    FrameLabels,
    MatchLabels,
    codes_of_pixels,
)
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.match_images import match_images
from fusion_core.workflows.fuse.pairing import FramePair, UprightDepth
from fusion_core.workflows.fuse.settings import ChainSettings

_Samples = TypeVar("_Samples", Classification, Repair)


@dataclass(frozen=True, slots=True, kw_only=True)
class FusedFrame:
    """A matched depth image with its classified and repaired measurements.

    ``camera_range_m``: (B,) ranges at which the beams meet what the camera sees; NaN where they do
    not, and where a person rejects the pixel.
    """

    match: FrameMatch
    classes: Classification
    repair: Repair
    camera_range_m: FloatArray

    @property
    def epsilon_m(self) -> float:
        """Median threshold over the pairs, NaN without pairs."""
        valid = self.classes.epsilon_m[np.isfinite(self.match.correspondence.residual_m)]
        return float(np.median(valid)) if valid.size else float("nan")

    @property
    def pair_class(self) -> IntArray:
        """(B,): codes of NoiseClass, the worse of each pair's two sides.

        Burr and conflict meet in no pair but one that a person labelled: else a conflict is on both
        of its sides.
        """
        # The codes grow worse; the pixel that a beam does not have is -1.
        worse: IntArray = np.maximum(self.classes.lidar_class, self.classes.depth_class)
        return worse

    @property
    def pixel_changed(self) -> BoolArray:
        """(B,): pairs whose pixel was changed by the repair."""
        repaired_m = self.repair.depth_m
        changed: BoolArray = (self.match.correspondence.row >= 0) & np.isfinite(repaired_m)
        changed &= repaired_m != self.match.correspondence.depth_m
        return changed


def fuse_images(
    pairs: Sequence[FramePair],
    alignment: RecordingAlignment,
    settings: ChainSettings,
    labels: MatchLabels | None = None,
) -> list[FusedFrame]:
    """Match, classify and repair one image, or the images of a panorama. Raises as
    ``match_images``."""
    matches = match_images(pairs, alignment, settings)

    def judged(match: FrameMatch) -> FrameLabels | None:
        return None if labels is None else labels.of_match(match)

    if matches[0].pasted is None:
        return [classify_and_repair(match, alignment, settings, judged(match)) for match in matches]
    whole = _classify_and_repair(matches[0], alignment, settings, judged(matches[0]))
    return [_part_of(match, *whole) for match in matches]


def classify_and_repair(
    match: FrameMatch,
    alignment: RecordingAlignment,
    settings: ChainSettings,
    labels: FrameLabels | None = None,
) -> FusedFrame:
    """Classify and repair an image that is matched already; of a pasted panorama its part.

    ``labels``: a person's, which overrule the classes.
    """
    return _part_of(match, *_classify_and_repair(match, alignment, settings, labels))


def _classify_and_repair(
    match: FrameMatch,
    alignment: RecordingAlignment,
    settings: ChainSettings,
    labels: FrameLabels | None,
) -> tuple[Classification, Repair, FloatArray]:
    """Classes, repairs and the camera's ranges of an image, or of the whole panorama of which it is
    a part."""
    scans = match.pair.window
    pairs, depth_m = _pairs_and_depth(match)
    seen = _frame_window(match, scans, pairs, depth_m, settings.time)
    classes = _classify(match, seen, alignment, settings.noise)
    if labels is not None:
        upright = labels.upright()
        of_pixels = codes_of_pixels(upright, pairs.row, pairs.column)
        classes = overrule(classes, labels.of_beams(pairs.beam), of_pixels)
        # A value that a person rejects is no evidence for a repair.
        rejected = is_rejected(upright) & np.isfinite(depth_m)
        T_lidar_camera = T_lidar_camera_at(match.pair.camera, alignment.mount, match.moved)
        row, column = pixels_met(pairs, match.pair.camera, T_lidar_camera)
        meets_rejected = (row >= 0) & _spread_to_missing(rejected, depth_m)[row, column]
        depth_m = np.where(rejected, np.float32(np.nan), depth_m)
        camera_range_m = np.where(meets_rejected, np.nan, pairs.camera_range_m)
        seen = _frame_window(
            match,
            labels.without_rejected(scans),
            replace(pairs, camera_range_m=camera_range_m),
            depth_m,
            settings.time,
        )
    repaired = repair(seen, classes, alignment.scale, settings.repair)
    return classes, repaired, seen.pairs.camera_range_m


def classify_match(
    match: FrameMatch,
    alignment: RecordingAlignment,
    time: TimeSettings,
    noises: Iterable[NoiseSettings],
) -> Iterator[Classification]:
    """The automatic classes by each of some settings of an image that is matched already, of a
    pasted panorama its part."""
    seen = _frame_window(match, match.pair.window, *_pairs_and_depth(match), time)
    for noise in noises:
        classes = _classify(match, seen, alignment, noise)
        if match.pasted is not None:
            classes = _subset(classes, match.pasted.camera == match.pair.camera_index)
        yield classes


def _classify(
    match: FrameMatch, seen: FrameWindow, alignment: RecordingAlignment, noise: NoiseSettings
) -> Classification:
    registration = match.registration
    mean_error_m = float("nan") if registration is None else registration.mean_error_m
    return classify(seen, noise, alignment.scale, mean_error_m)


def _pairs_and_depth(match: FrameMatch) -> tuple[Correspondence, Float32Array]:
    """The pairs that are classified together, and the image whose pixels they name."""
    if match.pasted is None:
        return match.correspondence, match.pair.depth_m
    return match.pasted.correspondence, match.pasted.depth_m


def _spread_to_missing(rejected: BoolArray, depth_m: Float32Array) -> BoolArray:
    """(H, W) rejected pixels, and the missing ones beside them: a ray that ends on one of those
    follows the values around it."""
    beside = cv2.dilate(rejected.astype(np.uint8), np.ones((3, 3), dtype=np.uint8)) > 0
    return rejected | (np.isnan(depth_m) & beside)


def _frame_window(
    match: FrameMatch,
    scans: ScanWindow,
    pairs: Correspondence,
    depth_m: Float32Array,
    time: TimeSettings,
) -> FrameWindow:
    """The pairs of an image, or of its panorama, with what is around them in space and time."""
    pair = match.pair
    rate = float("nan") if match.motion is None else match.motion.turn_rate_rad_s
    previous = pair.previous if match.pasted is None else match.pasted.previous
    scans, pairs = _with_seam_behind(scans, pairs)
    return FrameWindow(
        pairs=pairs,
        scan=scans.scan,
        depth_m=depth_m,
        scan_before=neighbour_seen_from(scans.scan, scans.before, match.motion, time),
        scan_after=neighbour_seen_from(scans.scan, scans.after, match.motion, time),
        depth_before_m=None if previous is None else previous.depth_m,
        columns_before=_columns_turned(previous, match.stamp_ns, rate, pair.camera),
    )


def _with_seam_behind(
    window: ScanWindow, pairs: Correspondence
) -> tuple[ScanWindow, Correspondence]:
    """Full circles cut opposite to the pairs, whose beams then follow each other, and the pairs by
    the beams' new numbers; scans with ends as they are."""
    if not pairs.beam.size or not window.scan.is_full_circle:
        return window, pairs
    first = window.scan.beam_behind(float(np.median(pairs.azimuth_rad)))

    def cut(scan: LaserScan | None) -> LaserScan | None:
        return None if scan is None else scan.with_seam_at(first)

    return (
        ScanWindow(
            before=cut(window.before),
            scan=window.scan.with_seam_at(first),
            after=cut(window.after),
        ),
        replace(pairs, beam=(pairs.beam - first) % window.scan.ranges_m.size),
    )


def _part_of(
    match: FrameMatch, classes: Classification, repaired: Repair, camera_range_m: FloatArray
) -> FusedFrame:
    if match.pasted is not None:
        own = match.pasted.camera == match.pair.camera_index
        classes, repaired = _subset(classes, own), _subset(repaired, own)
        camera_range_m = camera_range_m[own]
    return FusedFrame(match=match, classes=classes, repair=repaired, camera_range_m=camera_range_m)


def _subset(of: _Samples, own: BoolArray) -> _Samples:
    return replace(of, **{field.name: getattr(of, field.name)[own] for field in fields(of)})


def _columns_turned(
    previous: UprightDepth | None, stamp_ns: int, rate_rad_s: float, camera: Camera
) -> float:
    """Shift of a surface from this image to the one before, in columns to the right."""
    if previous is None or not np.isfinite(rate_rad_s):
        return 0.0
    turned = rate_rad_s * (stamp_ns - previous.stamp_ns) / NS_PER_S
    # A camera that turns left moves what it sees to the right.
    return -turned * camera.intrinsics.fx
