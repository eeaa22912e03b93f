"""Pass 2: scans and depth images as they come, matched, classified and repaired."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np

from fusion_core.alignment.time import ScanWindow
from fusion_core.denoising.correspondence import Correspondence
from fusion_core.denoising.neighbourhood import FrameWindow
from fusion_core.denoising.noise import Classification, classify
from fusion_core.denoising.repair import Repair, repair
from fusion_core.model.conventions import NS_PER_S, BoolArray, IntArray
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.match_images import match_images, split_into_frames
from fusion_core.workflows.fuse.pairing import (
    FramePair,
    ImageGrouper,
    PairedImage,
    UprightDepth,
)
from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.fuse.settings import ChainSettings

_Samples = TypeVar("_Samples", Classification, Repair)


@dataclass(frozen=True, slots=True, kw_only=True)
class FusedFrame:
    """A matched depth image with its classified and repaired measurements."""

    match: FrameMatch
    classes: Classification
    repair: Repair

    @property
    def epsilon_m(self) -> float:
        """Median threshold over the pairs, NaN without pairs."""
        valid = self.classes.epsilon_m[np.isfinite(self.match.correspondence.residual_m)]
        return float(np.median(valid)) if valid.size else float("nan")

    @property
    def pair_class(self) -> IntArray:
        """(B,): codes of NoiseClass, the worse of each pair's two sides.

        Burr and conflict never meet in one pair: a conflict is on both of its sides.
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


def fuse_frames(
    session: Session, alignment: RecordingAlignment, clock_offset_ms: float = 0.0
) -> Iterator[LaserScan | PairedImage | FusedFrame]:
    """Pass 2: scans as they arrive, fused frames, and the images that could not be fused."""
    cameras = 1 if alignment.panorama is None else len(session.rig.cameras)
    grouper = ImageGrouper(cameras, session.settings.time.max_gap_ms)
    previous: dict[int, UprightDepth] = {}
    for entry in session.pairs(clock_offset_ms):
        if isinstance(entry, LaserScan):
            yield entry
            groups = grouper.pass_scan()
        else:
            groups = grouper.push(entry)
        for group in groups:
            yield from _fuse_group(group, previous, session, alignment)
    for group in grouper.flush():
        yield from _fuse_group(group, previous, session, alignment)


def _fuse_group(
    group: Sequence[PairedImage],
    previous: dict[int, UprightDepth],
    session: Session,
    alignment: RecordingAlignment,
) -> Iterator[PairedImage | FusedFrame]:
    """The fused images of a group, or the images that have no scan or no peak. ``previous``: each
    camera's image before, which is brought up to date."""
    for frame in split_into_frames(group, session.settings):
        pairs = [session.frame_pair(entry, previous.get(entry.camera)) for entry in frame]
        paired = [pair for pair in pairs if pair is not None]
        if not paired:
            yield from frame
            continue
        try:
            yield from fuse_images(paired, alignment, session.settings)
        except AlignmentFailed:
            yield from frame
        for pair in paired:
            previous[pair.camera_index] = pair.upright


def fuse_images(
    pairs: Sequence[FramePair], alignment: RecordingAlignment, settings: ChainSettings
) -> list[FusedFrame]:
    """Match, classify and repair one image, or the images of a panorama. Raises as
    ``match_images``."""
    matches = match_images(pairs, alignment, settings)
    if matches[0].pasted is None:
        return [classify_and_repair(match, alignment, settings) for match in matches]
    whole = _classify_and_repair(matches[0], alignment, settings)
    return [_part_of(match, *whole) for match in matches]


def classify_and_repair(
    match: FrameMatch, alignment: RecordingAlignment, settings: ChainSettings
) -> FusedFrame:
    """Classify and repair an image that is matched already; of a pasted panorama its part."""
    classes, repaired = _classify_and_repair(match, alignment, settings)
    return _part_of(match, classes, repaired)


def _classify_and_repair(
    match: FrameMatch, alignment: RecordingAlignment, settings: ChainSettings
) -> tuple[Classification, Repair]:
    """Classes and repairs of an image, or of the whole panorama of which it is a part."""
    pair, rate, pasted = match.pair, match.turn_rate_rad_s, match.pasted
    pairs, depth_m, previous = match.correspondence, pair.depth_m, pair.previous
    if pasted is not None:
        pairs, depth_m, previous = pasted.correspondence, pasted.depth_m, pasted.previous
    window, pairs = _with_seam_behind(pair.window, pairs)
    scan = window.scan
    registration = match.registration
    seen = FrameWindow(
        pairs=pairs,
        scan=scan,
        depth_m=depth_m,
        scan_before=window.before,
        scan_after=window.after,
        shift_before=_beams_turned(window.before, scan, rate),
        shift_after=_beams_turned(window.after, scan, rate),
        depth_before_m=None if previous is None else previous.depth_m,
        columns_before=_columns_turned(previous, match.stamp_ns, rate, pair.camera),
    )
    classes = classify(
        seen,
        settings.noise,
        alignment.scale,
        registration.mean_error_m if registration is not None else float("nan"),
    )
    return classes, repair(seen, classes, alignment.scale, settings.repair)


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


def _part_of(match: FrameMatch, classes: Classification, repaired: Repair) -> FusedFrame:
    if match.pasted is not None:
        own = match.pasted.camera == match.pair.camera_index
        classes, repaired = _subset(classes, own), _subset(repaired, own)
    return FusedFrame(match=match, classes=classes, repair=repaired)


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


def _beams_turned(other: LaserScan | None, scan: LaserScan, rate_rad_s: float) -> int:
    """Beams by which a surface moves from ``scan`` to its neighbour in time."""
    if other is None or not np.isfinite(rate_rad_s):
        return 0
    seconds = (other.stamp_ns - scan.stamp_ns) / NS_PER_S
    return round(-rate_rad_s * seconds / scan.angle_increment_rad)
