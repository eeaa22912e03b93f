"""A person's labels of the samples that a frame is made of."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fusion_core.alignment.time import ScanWindow
from fusion_core.alignment.upright import UprightView
from fusion_core.denoising.overruling import is_rejected
from fusion_core.model.conventions import IntArray
from fusion_core.model.labels import NO_LABEL, CaptureLabels, LabelLayer
from fusion_core.model.sensors import DepthImage, LaserScan
from fusion_core.workflows.fuse.captures import image_capture, scan_capture
from fusion_core.workflows.fuse.frame_match import FrameMatch
from fusion_core.workflows.fuse.pairing import FramePair, PairedImage
from fusion_core.workflows.fuse.session import Session


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanWindowLabels:
    """The labels of a scan and of its neighbours in time, None where there are none."""

    before: CaptureLabels | None
    scan: CaptureLabels | None
    after: CaptureLabels | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageLabels:
    """The labels of a stored image, None where there are none, and the view that shows it."""

    stored: CaptureLabels | None
    view: UprightView

    def upright(self) -> IntArray:
        """(H', W') codes of Label in the upright view."""
        shape = (self.view.intrinsics.height, self.view.intrinsics.width)
        if self.stored is None:
            return np.full(shape, NO_LABEL)
        row, column = self.view.stored_pixel_maps()
        return np.where(row >= 0, self.stored.as_image()[row, column], NO_LABEL)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameLabels:
    """The labels of a frame, at least one.

    ``images``: of the image, or of all those of a pasted panorama, from left to right.
    """

    scans: ScanWindowLabels
    images: tuple[ImageLabels, ...]

    def parts(self) -> Iterator[CaptureLabels | None]:
        """The labels of each capture, None for those without any."""
        yield from (self.scans.before, self.scans.scan, self.scans.after)
        yield from (image.stored for image in self.images)

    @property
    def sha256(self) -> str:
        """Digest: frames of equal digests have the same labels on the same samples."""
        digest = hashlib.sha256()
        for labels in self.parts():
            if labels is None:
                digest.update(b"none;")
                continue
            digest.update(f"{labels.capture!r}, {labels.row.size};".encode())
            for array in (labels.row, labels.column, labels.label):
                digest.update(np.ascontiguousarray(array, dtype=np.int64).tobytes())
        return digest.hexdigest()

    def upright(self) -> IntArray:
        """(H, W) codes of Label in the image whose pixels the pairs name."""
        return np.hstack([image.upright() for image in self.images])

    def of_beams(self, beam: IntArray) -> IntArray:
        """(B,) codes of Label of some of the scan's beams."""
        return _codes_of_beams(self.scans.scan, beam)

    def without_rejected(self, window: ScanWindow) -> ScanWindow:
        """The scans without the ranges that are labelled as holes or burrs (NaN there)."""
        scans = self.scans
        scan = _without_rejected_beams(window.scan, scans.scan)
        return ScanWindow(
            before=_without_rejected_beams(window.before, scans.before),
            scan=window.scan if scan is None else scan,
            after=_without_rejected_beams(window.after, scans.after),
        )


class MatchLabels(Protocol):
    """Finds the labels of matched frames."""

    def of_match(self, match: FrameMatch) -> FrameLabels | None:
        """The labels of a frame, of a pasted panorama all; None where there are none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairLabels:
    """The labels of an image, as it is stored, and of the scans of its pair."""

    scans: ScanWindowLabels
    stored: CaptureLabels | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TaskLabels:
    """The labels of the images that are fused together, by the number of the camera. ``views``:
    those of all cameras of the rig."""

    of_camera: Mapping[int, PairLabels]
    views: Sequence[UprightView]

    def of_match(self, match: FrameMatch) -> FrameLabels | None:
        """As MatchLabels."""
        cameras = [pair.camera_index for pair in _pairs_judged(match)]
        labels = FrameLabels(
            scans=self.of_camera[match.pair.camera_index].scans,
            images=tuple(
                ImageLabels(stored=self.of_camera[camera].stored, view=self.views[camera])
                for camera in cameras
            ),
        )
        return labels if any(part is not None for part in labels.parts()) else None


def _pairs_judged(match: FrameMatch) -> list[FramePair]:
    """The pairs whose samples are classified together, from left to right."""
    if match.pasted is None:
        return [match.pair]
    own = {pair.camera.topic: pair for pair in match.pasted.images}
    return [own[camera.topic] for camera in match.pasted.panorama.from_left]


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionLabels:
    """A layer of labels on the recording of a session."""

    session: Session
    layer: LabelLayer

    def of_scan(self, scan: LaserScan | None) -> CaptureLabels | None:
        """The labels of a recorded scan, None where there are none."""
        capture = None if scan is None else scan_capture(scan, self.session)
        return None if capture is None else _unless_empty(self.layer.labels_of(capture))

    def of_image(self, image: DepthImage, camera: int) -> CaptureLabels | None:
        """The labels of a stored image, None where there are none."""
        capture = image_capture(image, camera, self.session)
        return _unless_empty(self.layer.labels_of(capture))

    def are_on(self, paired: PairedImage) -> bool:
        """Whether an image or its scan has labels."""
        scan = None if paired.window is None else paired.window.scan
        image = self.of_image(paired.image, paired.camera)
        return image is not None or self.of_scan(scan) is not None

    def of_pairs(self, match: FrameMatch) -> tuple[IntArray, IntArray]:
        """(B,) codes of Label of the beams and of the pixels of an image's own pairs."""
        pairs, pair = match.correspondence, match.pair
        scan = self.of_scan(match.scan)
        image = ImageLabels(
            stored=self.of_image(pair.image, pair.camera_index),
            view=self.session.rig.views[pair.camera_index],
        )
        return (
            _codes_of_beams(scan, pairs.beam),
            codes_of_pixels(image.upright(), pairs.row, pairs.column),
        )

    def of_pair(self, window: ScanWindow, image: DepthImage, camera: int) -> PairLabels:
        """The labels of a stored image and of its scans."""
        return PairLabels(
            scans=ScanWindowLabels(
                before=self.of_scan(window.before),
                scan=self.of_scan(window.scan),
                after=self.of_scan(window.after),
            ),
            stored=self.of_image(image, camera),
        )

    def of_match(self, match: FrameMatch) -> FrameLabels | None:
        """As MatchLabels."""
        of_camera = {
            pair.camera_index: self.of_pair(pair.window, pair.image, pair.camera_index)
            for pair in _pairs_judged(match)
        }
        return TaskLabels(of_camera=of_camera, views=self.session.rig.views).of_match(match)


def _codes_of_beams(scan: CaptureLabels | None, beam: IntArray) -> IntArray:
    return np.full(beam.shape, NO_LABEL) if scan is None else scan.as_image()[0, beam]


def codes_of_pixels(upright: IntArray, row: IntArray, column: IntArray) -> IntArray:
    """(B,) codes of Label of pixels of an (H, W) image of codes, NO_LABEL for row -1."""
    codes: IntArray = np.where(row >= 0, upright[row, column], NO_LABEL)
    return codes


def _without_rejected_beams(
    scan: LaserScan | None, labels: CaptureLabels | None
) -> LaserScan | None:
    if scan is None or labels is None:
        return scan
    rejected = is_rejected(labels.as_image()[0])
    return scan.with_ranges(np.where(rejected, np.nan, scan.ranges_m), scan.intensities)


def _unless_empty(labels: CaptureLabels) -> CaptureLabels | None:
    return labels if labels.row.size else None
