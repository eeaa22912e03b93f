"""Xu 2024 §2.3.2, eq. (6): a class for each beam and each pixel of a frame.

Eq. (6) finds pairs that disagree by more than epsilon; it does not say which sensor is wrong. Here
the one whose value lies on no surface is: a LiDAR beam against which the evidence of its neighbours
in the scan, in time and in the image speaks (``evidence``), a pixel that stands alone in the 5 x 5
around it. A *burr* is a flying or mixed pixel: a value on no surface, as at an edge where a beam
meets two. The paper's types follow from the classes: ① hole on both, ② hole on one, ③ burr. A
*conflict*, which the paper lacks, is a pair in which both sides measure a surface of their own,
e.g. a table top above the LiDAR's plane: no noise.

The camera looks at the point that the beam has met. Where it sees something nearer there, this may
hide that point. Where it sees something farther, though a surface stands there that the camera
shows nowhere around, it looks through a pane: the depth is the burr.
"""

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from fusion_core.denoising.correspondence import Correspondence
from fusion_core.denoising.evidence import ranges_around, weigh_beams
from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.denoising.support import (
    count_beam_support,
    count_pixel_support,
    find_measured_pixels,
)
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.sensors import LaserScan
from fusion_core.settings import StageSettings, setting

# For the confidences, disagreements are uniform over this span: the depth of a room.
_OUTLIER_SPAN_M = 4.0
# Prior probability of a disagreement, set by hand; it enters confidences alone.
_OUTLIER_FRACTION = 0.05
# Below this fraction of supporting neighbours a pixel may be of a speckle; set by hand.
_SPECKLE_SUPPORT = 0.6
# Least fraction of valid depths around a pixel in the image before, to reject it; set by hand.
_MIN_SEEN_BEFORE = 0.8
# A robot at 0.5 m/s comes this much nearer between two images at 10 Hz.
_APPROACH_M = 0.05
# Without a value of the other sensor: a little above even odds, set by hand.
_UNPAIRED_BURR_CONFIDENCE = 0.6
# Lower support than this lowers a conflict's confidence no further; set by hand.
_MIN_CONFLICT_SUPPORT = 0.25


class NoiseSettings(StageSettings):
    """The threshold epsilon and what counts as support by neighbours."""

    epsilon: float = setting(2.6, "Threshold of eq. (6), in epsilon_unit", ge=1e-6, le=100.0)
    epsilon_unit: Literal["sigma", "E", "m"] = setting(
        "sigma", "Unit of epsilon: the learned noise scale, the frame's mean error E, or metres"
    )
    support_sigma: float = setting(
        2.5, "A neighbour within this many standard deviations supports a beam", ge=1e-6, le=10.0
    )
    slope_fraction: float = setting(
        0.02,
        "Change of range from beam to beam that a slanted wall may cause, where the camera sees "
        "nothing, as a fraction of the range",
        ge=0.0,
        le=0.2,
        formerly="slope_share",
    )
    pixel_tolerance_fraction: float = setting(
        0.03,
        "A neighbouring pixel within 3 cm plus this fraction of the depth supports a pixel",
        ge=0.0,
        le=1.0,
        formerly="pixel_tolerance_share",
    )
    burr_criterion: Literal["support", "rougher"] = setting(
        "support",
        "Which side of a disagreeing pair is a burr: a side without support, or the side that "
        "deviates more from its neighbours (published; there are no conflicts then)",
        formerly="fault",
    )
    burr_odds: float = setting(
        2.0,
        "Odds that a beam is a burr, before its neighbours are asked, if it disagrees with a "
        "camera that sees where it ends; even odds where something hides that from the camera",
        ge=1e-3,
        le=1e3,
    )
    pixel_support: int = setting(
        2, "Pixels of the 5 x 5 around that must support one, else it is a burr", ge=1, le=24
    )
    motion_pixels: int = setting(
        4,
        "How far a surface may have moved in the image since the one before",
        unit="px",
        ge=1,
        le=64,
    )
    pixel_support_fraction: float = setting(
        0.3,
        "Least fraction of the valid pixels around that must support one",
        ge=0.0,
        le=1.0,
        formerly="pixel_support_share",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameWindow:
    """What classes need: the pair, and each sensor's own neighbourhood.

    ``scan_before``, ``scan_after``: neighbours in time, or None. What beam b of the scan hits is
    hit by their beam b + ``shift_before`` or b + ``shift_after``. ``depth_m``: (H, W) upright view.
    ``depth_before_m``: that of the image before, or None; a surface lies ``columns_before`` columns
    farther to the right in it.
    """

    pairs: Correspondence
    scan: LaserScan
    depth_m: Float32Array
    scan_before: LaserScan | None = None
    scan_after: LaserScan | None = None
    shift_before: int = 0
    shift_after: int = 0
    depth_before_m: Float32Array | None = None
    columns_before: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Classification:
    """Codes of NoiseClass for the B beams of the pairs and for their pixels.

    ``depth_class`` is -1 where the beam has no pixel. Confidences in [0, 1]. ``epsilon_m``: (B,).
    ``lidar_steady``: beams whose value the scans before and after both confirm.

    The evidence behind the classes: ``beam_evidence`` (B, 5), of the witnesses of
    ``evidence.WITNESSES``; ``beam_support`` (B, 3), how many adjacent beams, beams two and three
    away, and scans before and after support a beam; ``pixel_support`` (B, 2), how many of the 5 x 5
    pixels around support a pixel, and how many of them have a depth; ``pixel_unconfirmed`` (B,),
    pixels of a disagreeing pair whose depth the image before does not have; ``pixel_through`` (B,),
    pixels that look through what their beam has met.
    """

    lidar_class: IntArray
    depth_class: IntArray
    lidar_confidence: FloatArray
    depth_confidence: FloatArray
    epsilon_m: FloatArray
    lidar_steady: BoolArray
    beam_evidence: FloatArray
    beam_support: IntArray
    pixel_support: IntArray
    pixel_unconfirmed: BoolArray
    pixel_through: BoolArray

    def __post_init__(self) -> None:
        for field in fields(self):
            read_only(getattr(self, field.name))


def classify(
    window: FrameWindow,
    settings: NoiseSettings,
    scale: NoiseScale,
    mean_error_m: float,
) -> Classification:
    """Class and confidence of each beam and pixel. ``mean_error_m`` is the frame's E."""
    pairs = window.pairs
    has_lidar = np.isfinite(pairs.lidar_range_m)
    has_depth = np.isfinite(pairs.depth_m)
    has_pixel = pairs.row >= 0
    sigma_m = scale.sigma_at(np.where(has_lidar, pairs.lidar_range_m, 0.0))
    epsilon_m = _epsilon(settings, sigma_m, mean_error_m)
    residual_m = np.abs(pairs.residual_m)
    disagree = has_lidar & has_depth & (residual_m > epsilon_m)

    beam_support, beam_neighbours = _beam_support(window, settings, scale)
    pixel_support, pixel_neighbours = _pixel_support(window, settings)
    near, beyond, in_time = beam_support.T
    around = _weigh_neighbours(window, settings, scale, sigma_m)
    lone_beam = around.log_odds < 0.0
    few = pixel_support < np.maximum(
        settings.pixel_support, settings.pixel_support_fraction * pixel_neighbours
    )
    small = pixel_support < _SPECKLE_SUPPORT * pixel_neighbours
    gone = _find_unconfirmed_pixels(window, disagree & small, settings)
    through = disagree & around.pixel_through
    lone_beam &= ~through
    lone_pixel = (few & ~(around.pixel_measured & (pixel_support > 0))) | gone | through
    if settings.burr_criterion == "rougher":
        rougher = _roughness(pairs.lidar_range_m) >= _roughness(pairs.depth_m)
        lone_beam, lone_pixel = rougher, ~rougher
    # Without a pixel to compare, e.g. behind glass, most neighbours must be on the beam's surface.
    beside = near + beyond
    unseen = has_lidar & ~has_depth & (settings.burr_criterion == "support")
    unseen &= (beside < 2) | (2 * beside < beam_neighbours[:, 0])

    lidar_class = np.full(pairs.beam.size, int(NoiseClass.GOOD))
    depth_class = np.full(pairs.beam.size, int(NoiseClass.GOOD))
    conflict = disagree & ~lone_beam & ~lone_pixel
    lidar_class[conflict] = depth_class[conflict] = NoiseClass.CONFLICT
    # At an edge both sensors may mix the same two surfaces, and agree on a point on neither.
    alike = has_lidar & has_depth & ~disagree & lone_beam & few
    alike &= settings.burr_criterion == "support"
    lidar_class[(disagree & lone_beam) | alike | unseen] = NoiseClass.BURR
    depth_class[(disagree & lone_pixel) | alike] = NoiseClass.BURR
    lidar_class[~has_lidar] = NoiseClass.HOLE
    depth_class[~has_depth] = NoiseClass.HOLE
    depth_class[~has_pixel] = -1

    agreement = _probability_good(residual_m, sigma_m)
    on_surface = _probability(around.log_odds)
    # Laplace's rule of succession: few neighbours tell little.
    pixel_fraction = (pixel_support + 1) / (pixel_neighbours + 2)
    pixel_fraction = np.where(through, 1.0 - _probability(around.log_odds_by_lidar), pixel_fraction)
    return Classification(
        lidar_class=lidar_class,
        depth_class=depth_class,
        lidar_confidence=_confidence(lidar_class, agreement, on_surface, has_depth),
        depth_confidence=_confidence(depth_class, agreement, pixel_fraction, has_lidar),
        epsilon_m=epsilon_m,
        lidar_steady=in_time == 2,
        beam_evidence=around.evidence,
        beam_support=beam_support,
        pixel_support=np.stack([pixel_support, pixel_neighbours], axis=1),
        pixel_unconfirmed=gone,
        pixel_through=through,
    )


def _probability(log_odds: FloatArray) -> FloatArray:
    probability: FloatArray = 1.0 / (1.0 + np.exp(-log_odds))
    return probability


@dataclass(frozen=True, slots=True, kw_only=True)
class _Neighbourhood:
    """What surrounds B pairs.

    ``evidence``: (B, 5). ``log_odds``: (B,) that a beam's value is that of a surface, and
    ``log_odds_by_lidar`` without the camera's witness. ``pixel_measured``: (B,) whether a beam
    nearby has met the pixel's surface. ``pixel_through``: (B,) whether the pixel looks through what
    its beam has met.
    """

    evidence: FloatArray
    log_odds: FloatArray
    log_odds_by_lidar: FloatArray
    pixel_measured: BoolArray
    pixel_through: BoolArray


def _weigh_neighbours(
    window: FrameWindow, settings: NoiseSettings, scale: NoiseScale, sigma_m: FloatArray
) -> _Neighbourhood:
    pairs, ranges_m = window.pairs, window.scan.ranges_m
    in_time, shifts = _scans_in_time(window)
    seen_m = ranges_around(window.depth_m, pairs.row, pairs.column, pairs.depth_as_range_m)
    # Along the curve, the camera looks at what a beam has met, unless it sees something nearer and
    # the beam goes on out of its sight. In a row it looks elsewhere.
    in_sight = (pairs.residual_m >= 0.0) | np.isfinite(pairs.camera_range_m)
    hidden = ~in_sight | (pairs.model == "row")
    evidence: FloatArray = weigh_beams(
        ranges_m,
        in_time,
        shifts,
        pairs.beam,
        pairs.camera_range_m,
        seen_m,
        hidden,
        (scale.floor_m, scale.fraction, settings.slope_fraction),
    )
    # A disagreement is expected of a hidden surface, and speaks against one in sight.
    against = np.where(hidden, 0.0, np.log(settings.burr_odds))
    tolerance_m = settings.support_sigma * sigma_m
    is_seen = np.any(
        np.abs(seen_m - pairs.lidar_range_m[:, np.newaxis]) <= tolerance_m[:, np.newaxis], axis=1
    )
    measured: BoolArray = find_measured_pixels(
        pairs.depth_as_range_m, tolerance_m, pairs.beam, ranges_m, in_time, shifts
    )
    by_lidar = evidence[:, :4].sum(axis=1) - against
    return _Neighbourhood(
        evidence=evidence,
        log_odds=by_lidar + evidence[:, 4],
        log_odds_by_lidar=by_lidar,
        pixel_measured=measured,
        pixel_through=(
            ~hidden & (pairs.residual_m > 0.0) & ~measured & ~is_seen & (by_lidar > 0.0)
        ),
    )


def _scans_in_time(window: FrameWindow) -> tuple[FloatArray, IntArray]:
    """(2, N) ranges of the scans before and after, NaN where there is none, and their shifts."""
    nothing = np.full(window.scan.ranges_m.size, np.nan)

    def in_time(scan: LaserScan | None) -> FloatArray:
        same = scan is not None and scan.ranges_m.size == nothing.size
        return scan.ranges_m if scan is not None and same else nothing

    return (
        np.stack([in_time(window.scan_before), in_time(window.scan_after)]),
        np.array([window.shift_before, window.shift_after]),
    )


def _find_unconfirmed_pixels(
    window: FrameWindow, wanted: BoolArray, settings: NoiseSettings
) -> BoolArray:
    """(B,) pixels whose depth the image before does not have at their place.

    The pixels of a speckle support each other within one image, but no speckle is in two.
    """
    gone = np.zeros(wanted.size, dtype=np.bool_)
    before = window.depth_before_m
    if before is None:
        return gone
    height, width = before.shape
    reach = settings.motion_pixels
    for index in np.flatnonzero(wanted & (window.pairs.row >= 0)):
        row = int(window.pairs.row[index])
        column = round(int(window.pairs.column[index]) + window.columns_before)
        if not reach <= row < height - reach or not reach <= column < width - reach:
            continue
        around = before[row - reach : row + reach + 1, column - reach : column + reach + 1]
        own = window.pairs.depth_m[index]
        valid = np.isfinite(around)
        near = np.abs(around - own) <= _APPROACH_M + settings.pixel_tolerance_fraction * own
        gone[index] = valid.mean() > _MIN_SEEN_BEFORE and not near.any()
    return gone


def _roughness(values_m: FloatArray) -> FloatArray:
    """(B,) distance of each value from the mean of its two neighbours, 0 where one is missing.

    At either end the value itself replaces the missing neighbour.
    """
    padded = np.concatenate([values_m[:1], values_m, values_m[-1:]])
    rough: FloatArray = np.abs(values_m - 0.5 * (padded[:-2] + padded[2:]))
    return np.nan_to_num(rough, nan=0.0)


def _epsilon(settings: NoiseSettings, sigma_m: FloatArray, mean_error_m: float) -> FloatArray:
    if settings.epsilon_unit == "sigma":
        return settings.epsilon * sigma_m
    factor_m = 1.0 if settings.epsilon_unit == "m" else mean_error_m
    return np.full(sigma_m.size, settings.epsilon * factor_m)


def _probability_good(residual_m: FloatArray, sigma_m: FloatArray) -> FloatArray:
    """Posterior that a pair agrees: a normal residual against a uniform one, 0.5 without a pair."""
    normal = np.exp(-0.5 * (residual_m / sigma_m) ** 2) / (sigma_m * np.sqrt(2.0 * np.pi))
    good = (1.0 - _OUTLIER_FRACTION) * normal
    probability: FloatArray = good / (good + _OUTLIER_FRACTION / _OUTLIER_SPAN_M)
    return np.where(np.isfinite(probability), probability, 0.5)


def _confidence(
    classes: IntArray,
    agreement: FloatArray,
    support: FloatArray,
    has_other: BoolArray,
) -> FloatArray:
    """(B,) confidence in the class: agreement or disagreement of the pair, combined with the
    fraction of neighbours that support the sample."""
    disagreement = np.where(has_other, 1.0 - agreement, _UNPAIRED_BURR_CONFIDENCE)
    good = np.where(has_other, agreement + (1.0 - agreement) * support, 0.5 + 0.5 * support)
    by_class = {
        NoiseClass.GOOD: good,
        NoiseClass.HOLE: np.ones(classes.size),
        NoiseClass.BURR: disagreement * (1.0 - support),
        NoiseClass.CONFLICT: disagreement * np.maximum(support, _MIN_CONFLICT_SUPPORT),
    }
    confidence = np.zeros(classes.size)
    for noise_class, values in by_class.items():
        confidence = np.where(classes == noise_class, values, confidence)
    return np.clip(confidence, 0.0, 1.0)


def _beam_support(
    window: FrameWindow, settings: NoiseSettings, scale: NoiseScale
) -> tuple[IntArray, IntArray]:
    """(B, 3) supporters among adjacent beams, beams two and three away, and the scans before and
    after; (B, 2) how many neighbours in the scan and in time had a value at all."""
    in_time, shifts = _scans_in_time(window)
    counted: tuple[IntArray, IntArray] = count_beam_support(
        window.scan.ranges_m,
        in_time,
        shifts,
        window.pairs.beam,
        window.pairs.camera_range_m,
        settings.support_sigma * scale.floor_m,
        settings.support_sigma * scale.fraction,
        settings.slope_fraction,
    )
    return counted


def _pixel_support(window: FrameWindow, settings: NoiseSettings) -> tuple[IntArray, IntArray]:
    """(B,) supporters among the 5 x 5 pixels around, and how many of those had a value."""
    counted: tuple[IntArray, IntArray] = count_pixel_support(
        window.depth_m,
        window.pairs.row,
        window.pairs.column,
        settings.pixel_tolerance_fraction,
    )
    return counted
