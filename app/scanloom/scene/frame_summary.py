"""Summary of a frame: counts by class and repair source, conflicts, and the values of one beam."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.classes import NoiseClass, RepairSource
from fusion_core.model.conventions import IntArray
from fusion_core.workflows.fuse.frame import FusedFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class Counts:
    """How many beams, or pixels, are of each class, and by source how many were repaired.

    ``without_pixel``: beams whose point lies outside the image; they have no class as a pixel.
    A sample is repaired where it was a hole or a burr and its source is another one than itself.
    """

    by_class: dict[NoiseClass, int]
    by_source: dict[RepairSource, int]
    without_pixel: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PairCounts:
    """How many pairs of beam and pixel are of each class, the worse of their two sides.

    A pair that is good has both values, on one surface. ``without_pixel``: good beams whose point
    lies outside the image, which no pixel can confirm; they are of no class here.
    """

    by_class: dict[NoiseClass, int]
    without_pixel: int

    @property
    def total(self) -> int:
        """All beams in view."""
        return sum(self.by_class.values()) + self.without_pixel


@dataclass(frozen=True, slots=True, kw_only=True)
class ConflictRun:
    """Adjacent beams in conflict: ``first`` to ``last`` in the scan, ``middle`` the one to look at.

    ``lidar_m`` and ``camera_m``: medians of the ranges by each sensor.
    """

    first: int
    last: int
    middle: int
    lidar_m: float
    camera_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleFacts:
    """One sample, a beam or its pixel: metres as it has them, NaN where missing.

    ``is_decided``: whether a person's label gives the class. ``from_other_m`` and
    ``from_neighbours_m``: expected errors of what each offered for a repair,
    infinite if it had no value, NaN if no repair was needed.
    """

    noise_class: NoiseClass
    confidence: float
    is_decided: bool
    raw_m: float
    repaired_m: float
    source: RepairSource
    from_other_m: float
    from_neighbours_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamFacts:
    """All values of a fused frame for one beam in view and for its pixel.

    ``pixel`` is None where the beam's point lies outside the image, and then ``row`` and ``column``
    are -1. ``residual_m``: compared with epsilon, NaN without a pair. ``camera_range_m``: where the
    beam meets the surface that the camera sees; ``pixel_range_m``: the pixel's depth as a range;
    ``lidar_as_depth_m``: the beam's point as a depth. ``supporters``: among adjacent beams, beams
    two and three away, scans before and after; ``pixel_supporters``: of the 5 x 5 around, and how
    many of these have a depth. ``steady``: the scans before and after have the same range there;
    ``pixel_gone``: the image before has no such surface there; ``pixel_through``: it looks through
    what the beam has met. ``evidence``: for a surface at the beam's end, from the beams beside it,
    the scans before and after, and the camera.
    """

    beam: int
    azimuth_deg: float
    row: int
    column: int
    residual_m: float
    epsilon_m: float
    camera_range_m: float
    pixel_range_m: float
    lidar_as_depth_m: float
    lidar: SampleFacts
    pixel: SampleFacts | None
    supporters: tuple[int, int, int]
    pixel_supporters: tuple[int, int]
    steady: bool
    pixel_gone: bool
    pixel_through: bool
    evidence: tuple[float, float, float]


def counts_of_beams(frame: FusedFrame) -> Counts:
    """The beams in view."""
    return _counts(frame.classes.lidar_class, frame.repair.lidar_source)


def counts_of_pixels(frame: FusedFrame) -> Counts:
    """The pixels of the beams in view."""
    return _counts(frame.classes.depth_class, frame.repair.depth_source)


def counts_of_pairs(frame: FusedFrame) -> PairCounts:
    """The beams in view, each with its pixel."""
    code = frame.pair_class
    is_alone = (code == NoiseClass.GOOD) & (frame.match.correspondence.row < 0)
    return PairCounts(
        by_class={noise: int((code[~is_alone] == noise).sum()) for noise in NoiseClass},
        without_pixel=int(is_alone.sum()),
    )


def conflict_runs(frame: FusedFrame) -> list[ConflictRun]:
    """The conflicts of a frame, those first that disagree most."""
    pairs = frame.match.correspondence
    index = np.flatnonzero(frame.classes.lidar_class == NoiseClass.CONFLICT)
    if not index.size:
        return []
    parted = np.flatnonzero(np.diff(pairs.beam[index]) != 1) + 1
    runs = []
    for run in np.split(index, parted):
        middle = run[run.size // 2]
        runs.append(
            ConflictRun(
                first=int(pairs.beam[run[0]]),
                last=int(pairs.beam[run[-1]]),
                middle=int(pairs.beam[middle]),
                lidar_m=float(np.median(pairs.lidar_range_m[run])),
                camera_m=float(np.median(pairs.depth_as_range_m[run])),
            )
        )
    return sorted(runs, key=lambda run: -abs(run.lidar_m - run.camera_m))


def facts_of_beam(frame: FusedFrame, beam: int) -> BeamFacts | None:
    """What is known of a beam of the scan, None where it is outside of the camera's view."""
    pairs, classes, repair = frame.match.correspondence, frame.classes, frame.repair
    found = np.flatnonzero(pairs.beam == beam)
    if not found.size:
        return None
    at = int(found[0])
    lidar = SampleFacts(
        noise_class=NoiseClass(classes.lidar_class[at]),
        confidence=float(classes.lidar_confidence[at]),
        is_decided=bool(classes.lidar_decided[at]),
        raw_m=float(pairs.lidar_range_m[at]),
        repaired_m=float(repair.lidar_range_m[at]),
        source=RepairSource(repair.lidar_source[at]),
        from_other_m=float(repair.lidar_errors_m[at, 0]),
        from_neighbours_m=float(repair.lidar_errors_m[at, 1]),
    )
    pixel = None
    if pairs.row[at] >= 0:
        pixel = SampleFacts(
            noise_class=NoiseClass(classes.depth_class[at]),
            confidence=float(classes.depth_confidence[at]),
            is_decided=bool(classes.depth_decided[at]),
            raw_m=float(pairs.depth_m[at]),
            repaired_m=float(repair.depth_m[at]),
            source=RepairSource(repair.depth_source[at]),
            from_other_m=float(repair.depth_errors_m[at, 0]),
            from_neighbours_m=float(repair.depth_errors_m[at, 1]),
        )
    near, beyond, in_time = classes.beam_support[at].tolist()
    around, valid = classes.pixel_support[at].tolist()
    evidence = classes.beam_evidence[at]
    return BeamFacts(
        beam=beam,
        azimuth_deg=float(np.rad2deg(pairs.azimuth_rad[at])),
        row=int(pairs.row[at]),
        column=int(pairs.column[at]),
        residual_m=float(pairs.residual_m[at]),
        epsilon_m=float(classes.epsilon_m[at]),
        camera_range_m=float(pairs.camera_range_m[at]),
        pixel_range_m=float(pairs.depth_as_range_m[at]),
        lidar_as_depth_m=float(pairs.lidar_as_depth_m[at]),
        lidar=lidar,
        pixel=pixel,
        supporters=(near, beyond, in_time),
        pixel_supporters=(around, valid),
        steady=bool(classes.lidar_steady[at]),
        pixel_gone=bool(classes.pixel_unconfirmed[at]),
        pixel_through=bool(classes.pixel_through[at]),
        evidence=(float(evidence[:2].sum()), float(evidence[2:4].sum()), float(evidence[4])),
    )


def _counts(noise_class: IntArray, source: IntArray) -> Counts:
    has_class = noise_class >= 0
    is_noise = np.isin(noise_class, (NoiseClass.HOLE, NoiseClass.BURR))
    return Counts(
        by_class={kind: int((noise_class == kind).sum()) for kind in NoiseClass},
        by_source={kind: int((is_noise & (source == kind)).sum()) for kind in RepairSource},
        without_pixel=int((~has_class).sum()),
    )
