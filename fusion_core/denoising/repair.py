"""Xu 2024 §2.3.2, eqs. (7), (8): holes and burrs of one sensor repaired from the other.

A LiDAR sample is repaired from the camera (the range at which the beam meets what the camera sees,
or the paired pixel mapped back) or from its own good neighbours; a pixel from the LiDAR or from the
plane through its good neighbours in the image. The source with the smaller expected error is used,
and recorded. Nothing is filled across a depth edge or over too wide a gap.

A repair never removes an obstacle: a valid return is moved farther only where it is a burr of at
least a set confidence, and conflicts are left as they are. Nor does it invent free space: no beam
is filled behind what the LiDAR saw about its direction in this scan and the ones before and after,
or behind what the camera saw before it, and a line across a gap needs those scans' confirmation
(``nearby_returns``, ``openings``). What cannot be known stays a hole. A value that a person rejects
counts as missing, whatever speaks for it (``overruling``).
"""

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from fusion_core.denoising.correspondence import Correspondence
from fusion_core.denoising.nearby_returns import nearby_returns
from fusion_core.denoising.neighbourhood import FrameWindow
from fusion_core.denoising.noise import Classification
from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.denoising.openings import find_openings, returns_in_openings
from fusion_core.denoising.overruling import is_rejected
from fusion_core.denoising.surfaces import fit_image_planes, interpolate_gaps, smooth_ranges
from fusion_core.model.classes import NoiseClass, RepairSource, is_one_of
from fusion_core.model.conventions import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.settings import StageSettings, setting

# The mean of three beams has 1/sqrt(3) of their noise.
_GAP_SIDE_NOISE = 0.6
# Expected depth of what a gap hides, per metre of its width; set by hand.
_STRUCTURE_PER_GAP = 0.1
# Ranges farther apart than this many standard deviations contradict each other: by chance
# one in 16,000 does.
_CONTRADICTION_SIGMA = 4.0


class RepairSettings(StageSettings):
    """Where a repair may come from, and what it may change."""

    prefer: Literal["smaller_error", "other_sensor"] = setting(
        "smaller_error", "Source where there are two; published: always the other sensor"
    )
    max_gap_deg: float = setting(
        8.0,
        "Widest gap of the LiDAR curve filled from its own neighbours",
        unit="deg",
        ge=0.0,
        le=360.0,
    )
    lidar_burr_confidence: float = setting(
        0.98,
        "Least confidence of a beam that is a burr beside its pixel, and repaired",
        ge=0.0,
        le=1.0,
    )
    depth_burr_confidence: float = setting(
        0.8, "Least confidence of a burr in the depth image that is repaired", ge=0.0, le=1.0
    )
    lidar_confidence: float = setting(
        0.8, "Least confidence of a good beam from which a pixel is repaired", ge=0.0, le=1.0
    )
    narrow_gap_deg: float = setting(
        1.5,
        "Up to here a gap's own sides are believed against the other sensor",
        unit="deg",
        ge=0.0,
        le=360.0,
    )
    max_gap_pixels: int = setting(
        24, "Farthest good pixel that a pixel is filled from", unit="px", ge=1, le=100
    )
    edge_m: float = setting(
        0.25,
        "Sides of a gap farther apart than this are an edge, not a surface",
        unit="m",
        ge=1e-6,
        le=100.0,
    )
    farther_confidence: float = setting(
        0.7, "Least confidence of a burr that a repair moves farther", ge=0.0, le=1.0
    )
    check_nearby: bool = setting(
        True,
        "Fill no beam behind what either sensor saw about its direction, and none from its own "
        "neighbours unless the scans before and after confirm it; published: fill them all",
    )
    confirm_line: float = setting(
        0.5,
        "Of the beams about a direction in the scans before and after, least fraction that must "
        "return anything, and of those next to it the line across a gap",
        ge=0.0,
        le=1.0,
    )
    confirm_in_time: float = setting(
        0.8,
        "The same for the mean of both scans, which fills the beam where no line crosses the gap; "
        "and of all returns in an opening, least fraction from the line across it",
        ge=0.0,
        le=1.0,
    )
    pane_passes: float = setting(
        0.17,
        "Greatest fraction of the beams on a pane that return from behind it, set by hand: a "
        "surface that loses most beams is told from a pane by returning more",
        ge=0.0,
        le=1.0,
    )
    pane_doubt: float = setting(
        0.005,
        "Greatest probability that a pane passes as many beams as are taken for such a surface",
        ge=0.0,
        le=1.0,
    )
    camera_noise_fraction: float = setting(
        0.5,
        "Fraction of a good pair's noise that is the camera's",
        ge=1e-6,
        le=1.0,
        formerly="camera_noise_share",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Repair:
    """Repaired values of the B beams and their pixels; untouched means repaired = raw.

    ``lidar_range_m``: horizontal ranges; ``depth_m``: along the optical axis; NaN where missing
    and not repaired. ``lidar_source``, ``depth_source``: codes of RepairSource.
    ``lidar_errors_m``, ``depth_errors_m``: (B, 2) expected errors of the other sensor and of
    the neighbours, infinite where there is no estimate, NaN where none was needed.
    """

    lidar_range_m: FloatArray
    lidar_source: IntArray
    lidar_errors_m: FloatArray
    depth_m: FloatArray
    depth_source: IntArray
    depth_errors_m: FloatArray

    def __post_init__(self) -> None:
        for field in fields(self):
            read_only(getattr(self, field.name))


def repair(
    window: FrameWindow, classes: Classification, scale: NoiseScale, settings: RepairSettings
) -> Repair:
    """Repair the holes and burrs of one frame, whose ``classes`` are those of ``window``."""
    lidar, lidar_source, lidar_errors = _repair_lidar(window, classes, scale, settings)
    depth, depth_source, depth_errors = _repair_depth(
        window.pairs, classes, window.depth_m, scale, settings
    )
    return Repair(
        lidar_range_m=lidar,
        lidar_source=lidar_source,
        lidar_errors_m=lidar_errors,
        depth_m=depth,
        depth_source=depth_source,
        depth_errors_m=depth_errors,
    )


def _repair_lidar(
    window: FrameWindow, classes: Classification, scale: NoiseScale, settings: RepairSettings
) -> tuple[FloatArray, IntArray, FloatArray]:
    pairs = window.pairs
    raw = _unless_rejected(pairs.lidar_range_m, classes.lidar_class, classes.lidar_decided)
    burr = classes.lidar_class == NoiseClass.BURR
    if settings.prefer == "smaller_error":
        # A return that three consecutive scans confirm is kept, even if classified as a burr.
        burr &= ~classes.lidar_steady | classes.lidar_decided
        # So is one whose range the camera sees beside it.
        burr &= (classes.beam_evidence[:, -1] <= 0.0) | classes.lidar_decided
    # More than even odds name a burr; to change what a sensor measured asks for more.
    paired = np.isfinite(raw) & np.isfinite(pairs.depth_m)
    burr &= ~paired | (classes.lidar_confidence >= settings.lidar_burr_confidence)
    noisy = burr | (classes.lidar_class == NoiseClass.HOLE)
    support = is_one_of(classes.lidar_class, NoiseClass.GOOD, NoiseClass.CONFLICT)
    support &= np.isfinite(raw)
    neighbours, gap_rad = interpolate_gaps(pairs.azimuth_rad, raw, support, settings.edge_m)
    neighbours = np.where(gap_rad <= np.deg2rad(settings.max_gap_deg), neighbours, np.nan)
    camera = pairs.camera_range_m
    camera_error = settings.camera_noise_fraction * scale.sigma_at(camera)
    # A wider gap hides larger structures; its sides are means of three beams.
    neighbour_error = _GAP_SIDE_NOISE * scale.sigma_at(neighbours) + (
        _STRUCTURE_PER_GAP * gap_rad * neighbours
    )
    # Where both disagree over a narrow gap, an edge in the image is probably one beam off.
    narrow = gap_rad <= np.deg2rad(settings.narrow_gap_deg)
    contradict = np.abs(camera - neighbours) > _CONTRADICTION_SIGMA * scale.sigma_at(neighbours)
    inconsistent = narrow & contradict & (settings.prefer == "smaller_error")
    camera_error = np.where(inconsistent, np.inf, camera_error)
    samples = _NoisySamples(
        raw=raw, is_noisy=noisy, is_burr=burr, confidence=classes.lidar_confidence
    )
    from_camera = _Estimate(value=camera, error=camera_error)
    from_neighbours = _Estimate(value=neighbours, error=neighbour_error)
    if settings.check_nearby:
        from_camera, from_neighbours = _known_free_before(
            window, from_camera, from_neighbours, scale, settings
        )
    return _choose_source(samples, from_camera, from_neighbours, settings)


def _known_free_before(
    window: FrameWindow,
    camera: "_Estimate",
    line: "_Estimate",
    scale: NoiseScale,
    settings: RepairSettings,
) -> "tuple[_Estimate, _Estimate]":
    """The estimates from the camera and from neighbours before which nothing was seen.

    The neighbours are the line across the gap or, where it is not confirmed, the scans before and
    after.
    """
    every_beam = nearby_returns(window)
    nearby = every_beam.about(window.pairs.beam)

    def tolerance_m(value_m: FloatArray) -> FloatArray:
        return _CONTRADICTION_SIGMA * scale.sigma_at(value_m)

    def confirmed(value_m: FloatArray, least: float) -> BoolArray:
        enough = nearby.returned_fraction >= least
        enough &= nearby.confirmed_fraction(value_m, tolerance_m(value_m)) >= least
        return enough

    openings = find_openings(
        window,
        every_beam,
        tolerance_m(window.scan.ranges_m),
        settings.confirm_line,
        settings.edge_m,
    )
    across_m, wall_m = openings.across_m[window.pairs.beam], openings.wall_m[window.pairs.beam]
    # As far to either side as the middle of the widest gap that is filled.
    in_openings = returns_in_openings(
        window,
        openings.across_m,
        tolerance_m(openings.across_m),
        np.deg2rad(0.5 * settings.max_gap_deg),
    ).about(window.pairs.beam)
    is_surface = in_openings.is_surface(
        settings.pane_passes, settings.pane_doubt, settings.confirm_in_time
    )
    is_surface &= np.abs(line.value - across_m) <= tolerance_m(line.value)
    is_surface |= confirmed(line.value, settings.confirm_line)
    line_m = np.where(is_surface, line.value, np.nan)
    between_m = nearby.between_scans_m()
    is_steady = confirmed(between_m, settings.confirm_in_time)
    in_time_m = np.where(is_steady, between_m, np.nan)
    # Beside the edge of something nearer, that has moved over this direction since.
    in_time_m = np.where(nearby.any_beside_behind(in_time_m + settings.edge_m), np.nan, in_time_m)
    has_line = np.isfinite(line_m)
    neighbours_m = np.where(has_line, line_m, in_time_m)
    neighbour_error = np.where(has_line, line.error, scale.sigma_at(in_time_m))

    def unless_behind(value_m: FloatArray) -> FloatArray:
        return np.where(nearby.any_before(value_m - settings.edge_m), np.nan, value_m)

    # Few beams go through a pane, and those of an open door return.
    behind_pane = nearby.returned_fraction < settings.confirm_line
    behind_pane &= camera.value > wall_m + settings.edge_m
    hides = window.pairs.camera_blocked | behind_pane
    camera_m = np.where(hides, np.nan, camera.value)
    return (
        _Estimate(value=unless_behind(camera_m), error=camera.error),
        _Estimate(value=unless_behind(neighbours_m), error=neighbour_error),
    )


def _repair_depth(
    pairs: Correspondence,
    classes: Classification,
    depth_m: Float32Array,
    scale: NoiseScale,
    settings: RepairSettings,
) -> tuple[FloatArray, IntArray, FloatArray]:
    raw = _unless_rejected(pairs.depth_m, classes.depth_class, classes.depth_decided)
    burr = classes.depth_class == NoiseClass.BURR
    burr &= classes.depth_confidence >= settings.depth_burr_confidence
    noisy = burr | (classes.depth_class == NoiseClass.HOLE)
    reliable = classes.lidar_class == NoiseClass.GOOD
    reliable &= classes.lidar_confidence >= settings.lidar_confidence
    lidar = np.where(reliable, pairs.lidar_as_depth_m, np.nan)
    lidar_error = scale.sigma_at(lidar)
    if settings.prefer == "smaller_error":
        # Averaging over the surface shared with adjacent beams reduces the noise of a single beam.
        smooth = smooth_ranges(
            pairs.azimuth_rad,
            np.where(reliable, pairs.lidar_range_m, np.nan),
            scale.sigma_at(pairs.lidar_range_m),
        )
        lidar = lidar * smooth.range_m / pairs.lidar_range_m
        lidar_error = np.minimum(lidar_error, smooth.error_m)

    def planes_near(expected_m: FloatArray, wanted: BoolArray) -> FloatArray:
        found = np.full((raw.size, 2), np.nan)
        found[wanted] = fit_image_planes(
            depth_m,
            pairs.row[wanted],
            pairs.column[wanted],
            expected_m[wanted],
            settings.max_gap_pixels,
            settings.edge_m,
        )
        return found

    planes = planes_near(lidar, noisy)
    # Where the image has no surface at the LiDAR's depth, a nearer one may occlude it, such as a
    # table top above the LiDAR's plane.
    alone = noisy & ~np.isfinite(planes[:, 0])
    if settings.prefer == "other_sensor":
        alone &= ~np.isfinite(lidar)
    image_only = planes_near(np.full(raw.size, np.nan), alone)
    hides = alone & ~(image_only[:, 0] > lidar - settings.edge_m)
    planes = np.where(hides[:, np.newaxis], image_only, planes)
    lidar = np.where(hides & np.isfinite(image_only[:, 0]), np.nan, lidar)
    samples = _NoisySamples(
        raw=raw, is_noisy=noisy, is_burr=burr, confidence=classes.depth_confidence
    )
    from_lidar = _Estimate(value=lidar, error=lidar_error)
    from_neighbours = _Estimate(value=planes[:, 0], error=planes[:, 1])
    return _choose_source(samples, from_lidar, from_neighbours, settings)


def _unless_rejected(value_m: FloatArray, classes: IntArray, decided: BoolArray) -> FloatArray:
    """(B,) values, NaN where a person calls them a hole or a burr."""
    return np.where(decided & is_rejected(classes), np.nan, value_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class _NoisySamples:
    """(B,) samples of one sensor: raw values (m), and which of them need a repair."""

    raw: FloatArray
    is_noisy: BoolArray
    is_burr: BoolArray
    confidence: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class _Estimate:
    """(B,) replacement values (m), NaN where there is none, and their expected errors (m)."""

    value: FloatArray
    error: FloatArray


def _choose_source(
    samples: _NoisySamples, other: _Estimate, neighbours: _Estimate, settings: RepairSettings
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Replace each noisy sample by the other sensor's value or by that of its neighbours.

    Returns (B,) values, (B,) codes of RepairSource and (B, 2) expected errors, NaN where the sample
    is not noisy.
    """
    raw, noisy = samples.raw, samples.is_noisy
    # A map A may place a value behind the sensor; such a value is not used.
    usable = np.isfinite(other.value) & (other.value > 0.0)
    other_error = np.where(usable, other.error, np.inf)
    neighbour_error = np.where(np.isfinite(neighbours.value), neighbours.error, np.inf)
    better = (other_error <= neighbour_error) | (settings.prefer == "other_sensor")
    from_other = noisy & np.isfinite(other_error) & better
    from_neighbours = noisy & np.isfinite(neighbour_error) & ~from_other
    value = np.where(from_other, other.value, np.where(from_neighbours, neighbours.value, raw))
    source = np.full(raw.size, int(RepairSource.RAW))
    source[from_other] = RepairSource.OTHER_SENSOR
    source[from_neighbours] = RepairSource.NEIGHBOURS
    farther = samples.is_burr & (value > raw)
    farther &= samples.confidence < settings.farther_confidence
    value[farther] = raw[farther]
    source[farther] = RepairSource.RAW
    source[~np.isfinite(value)] = RepairSource.NONE
    errors = np.stack([other_error, neighbour_error], axis=1)
    return value, source, np.where(noisy[:, np.newaxis], errors, np.nan)
