"""What surrounds the beams and pixels of a frame, in space, in time and in the other sensor."""

from dataclasses import dataclass, fields

import numpy as np

from fusion_core.alignment.moved_scan import MovedScan
from fusion_core.denoising.correspondence import Correspondence
from fusion_core.denoising.evidence import ranges_around, weigh_beams
from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.denoising.noise_settings import NoiseSettings
from fusion_core.denoising.support import (
    count_beam_support,
    count_pixel_support,
    find_measured_pixels,
)
from fusion_core.model.conventions import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)
from fusion_core.model.sensors import LaserScan

# Least fraction of valid depths around a pixel in the image before, to reject it; set by hand.
_MIN_SEEN_BEFORE = 0.8
# A robot at 0.5 m/s comes this much nearer between two images at 10 Hz.
_APPROACH_M = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameWindow:
    """What classes need: the pair, and each sensor's own neighbourhood.

    ``scan_before``, ``scan_after``: its neighbours in time as seen from its own place, or None
    where there is none or the motion is not known. ``depth_m``: (H, W) upright view.
    ``depth_before_m``: that of the image before, or None; a surface lies ``columns_before`` columns
    farther to the right in it.
    """

    pairs: Correspondence
    scan: LaserScan
    depth_m: Float32Array
    scan_before: MovedScan | None = None
    scan_after: MovedScan | None = None
    depth_before_m: Float32Array | None = None
    columns_before: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbourhood:
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

    def __post_init__(self) -> None:
        for field in fields(self):
            read_only(getattr(self, field.name))


def weigh_neighbours(
    window: FrameWindow, settings: NoiseSettings, scale: NoiseScale, sigma_m: FloatArray
) -> Neighbourhood:
    """Weigh what surrounds the pairs. ``sigma_m``: (B,) of their residuals where nothing is
    wrong."""
    pairs, ranges_m = window.pairs, window.scan.ranges_m
    in_time = _scans_in_time(window)
    seen_m = ranges_around(window.depth_m, pairs.row, pairs.column, pairs.depth_as_range_m)
    # Along the curve, the camera looks at what a beam has met, unless it sees something nearer and
    # the beam goes on out of its sight. In a row it looks elsewhere.
    in_sight = (pairs.residual_m >= 0.0) | np.isfinite(pairs.camera_range_m)
    hidden = ~in_sight | (pairs.model == "row")
    evidence: FloatArray = weigh_beams(
        ranges_m,
        in_time,
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
        pairs.depth_as_range_m, tolerance_m, pairs.beam, ranges_m, in_time
    )
    by_lidar = evidence[:, :4].sum(axis=1) - against
    return Neighbourhood(
        evidence=evidence,
        log_odds=by_lidar + evidence[:, 4],
        log_odds_by_lidar=by_lidar,
        pixel_measured=measured,
        pixel_through=(
            ~hidden & (pairs.residual_m > 0.0) & ~measured & ~is_seen & (by_lidar > 0.0)
        ),
    )


def scans_about(window: FrameWindow) -> tuple[FloatArray, BoolArray]:
    """(3, N) ranges of the scan before, the scan and the one after, NaN where there is none, and
    whether a beam looked there."""
    count = window.scan.ranges_m.size
    ranges_m, looked = np.full((3, count), np.nan), np.zeros((3, count), dtype=np.bool_)
    ranges_m[1], looked[1] = window.scan.ranges_m, True
    for place, scan in ((0, window.scan_before), (2, window.scan_after)):
        if scan is not None:
            ranges_m[place], looked[place] = scan.ranges_m, scan.looked
    return ranges_m, looked


def _scans_in_time(window: FrameWindow) -> FloatArray:
    """(2, N) ranges of the scans before and after, NaN where there is none."""
    return scans_about(window)[0][[0, 2]]


def find_unconfirmed_pixels(
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


def support_of_beams(
    window: FrameWindow, settings: NoiseSettings, scale: NoiseScale
) -> tuple[IntArray, IntArray]:
    """(B, 3) supporters among adjacent beams, beams two and three away, and the scans before and
    after; (B, 2) how many neighbours in the scan and in time had a value at all."""
    counted: tuple[IntArray, IntArray] = count_beam_support(
        window.scan.ranges_m,
        _scans_in_time(window),
        window.pairs.beam,
        window.pairs.camera_range_m,
        settings.support_sigma * scale.floor_m,
        settings.support_sigma * scale.fraction,
        settings.slope_fraction,
    )
    return counted


def support_of_pixels(window: FrameWindow, settings: NoiseSettings) -> tuple[IntArray, IntArray]:
    """(B,) supporters among the 5 x 5 pixels around, and how many of those had a value."""
    counted: tuple[IntArray, IntArray] = count_pixel_support(
        window.depth_m,
        window.pairs.row,
        window.pairs.column,
        settings.pixel_tolerance_fraction,
    )
    return counted
