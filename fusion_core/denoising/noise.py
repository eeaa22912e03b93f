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

import numpy as np

from fusion_core.denoising.neighbourhood import (
    FrameWindow,
    find_unconfirmed_pixels,
    support_of_beams,
    support_of_pixels,
    weigh_neighbours,
)
from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.denoising.noise_settings import NoiseSettings
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import (
    BoolArray,
    FloatArray,
    IntArray,
    read_only,
)

# For the confidences, disagreements are uniform over this span: the depth of a room.
_OUTLIER_SPAN_M = 4.0
# Prior probability of a disagreement, set by hand; it enters confidences alone.
_OUTLIER_FRACTION = 0.05
# Below this fraction of supporting neighbours a pixel may be of a speckle; set by hand.
_SPECKLE_SUPPORT = 0.6
# Without a value of the other sensor: a little above even odds, set by hand.
_UNPAIRED_BURR_CONFIDENCE = 0.6
# Lower support than this lowers a conflict's confidence no further; set by hand.
_MIN_CONFLICT_SUPPORT = 0.25


@dataclass(frozen=True, slots=True, kw_only=True)
class Classification:
    """Codes of NoiseClass for the B beams of the pairs and for their pixels.

    ``depth_class`` is -1 where the beam has no pixel. Confidences in [0, 1]. ``epsilon_m``: (B,).
    ``lidar_steady``: beams whose value the scans before and after both confirm. ``lidar_decided``,
    ``depth_decided``: (B,) whose class is a person's (``overruling``).

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
    lidar_decided: BoolArray
    depth_decided: BoolArray
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

    beam_support, beam_neighbours = support_of_beams(window, settings, scale)
    pixel_support, pixel_neighbours = support_of_pixels(window, settings)
    near, beyond, in_time = beam_support.T
    around = weigh_neighbours(window, settings, scale, sigma_m)
    lone_beam = around.log_odds < 0.0
    few = pixel_support < np.maximum(
        settings.pixel_support, settings.pixel_support_fraction * pixel_neighbours
    )
    small = pixel_support < _SPECKLE_SUPPORT * pixel_neighbours
    gone = find_unconfirmed_pixels(window, disagree & small, settings)
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
        lidar_decided=np.zeros(pairs.beam.size, dtype=np.bool_),
        depth_decided=np.zeros(pairs.beam.size, dtype=np.bool_),
        beam_evidence=around.evidence,
        beam_support=beam_support,
        pixel_support=np.stack([pixel_support, pixel_neighbours], axis=1),
        pixel_unconfirmed=gone,
        pixel_through=through,
    )


def _probability(log_odds: FloatArray) -> FloatArray:
    probability: FloatArray = 1.0 / (1.0 + np.exp(-log_odds))
    return probability


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
        confidence = np.where(classes == int(noise_class), values, confidence)
    return np.clip(confidence, 0.0, 1.0)
