"""Xu 2024 §2.1: which scan belongs to a depth image, and how the LiDAR turned between the two.

The paper pairs by sampling rates, t = f(i) / g(j); with stamps the nearest scan is the same where
the rates are constant and right where they are not. A robot that turns at 0.5 rad/s turns by 1.4
degrees within half a scan period, so the turn between the two stamps is compensated, with a rate
measured from consecutive scans: no odometry is needed. Interpolation goes one step further: the
scan of the image's own instant, from its two neighbours in time.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import NS_PER_MS, NS_PER_S, FloatArray
from fusion_core.model.sensors import LaserScan
from fusion_core.settings import StageSettings, setting

# A range difference beyond this is between two surfaces and does not measure the turn; set by hand.
_MAX_DIFFERENCE_M = 0.3


class TimeSettings(StageSettings):
    """How scans and depth images are paired."""

    pair_by: Literal["nearest", "interpolated", "rates"] = setting(
        "nearest",
        "The scan of a depth image: the one nearest in time; interpolated: the same for values, "
        "classes and repairs, while u, v and the mount are found with a scan made from it and its "
        "neighbour on the image's other side in time; rates: as the paper, by counting messages "
        "and the ratio of the two rates, without stamps (the same where the rates are constant, "
        "so published keeps nearest)",
    )
    max_gap_ms: float = setting(
        60.0,
        "Greatest time between a depth image and its scan (not by rates)",
        unit="ms",
        ge=1e-6,
        le=5_000.0,
    )
    same_surface_m: float = setting(
        0.15,
        "Interpolation mixes two ranges that differ by no more; where they do, one is taken, that "
        "of the scan nearest in time",
        unit="m",
        ge=1e-6,
        le=10.0,
    )
    max_turn_rate_rad_s: float = setting(
        2.0, "Fastest turn that is looked for between two scans", unit="rad/s", ge=1e-6, le=100.0
    )
    compensate_turn: bool = setting(
        True, "Take out the LiDAR's turn between the stamps of scan and image"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanWindow:
    """The scan paired with an image, and its neighbours in time where there are any."""

    before: LaserScan | None
    scan: LaserScan
    after: LaserScan | None


def estimate_turn_rate_rad_s(window: ScanWindow, settings: TimeSettings) -> float:
    """Rate at which the LiDAR turns around the time of ``window.scan``, counter-clockwise.

    The mean over the two neighbours of the rotation that lays one scan on the next; NaN where
    no neighbour overlaps enough.
    """
    rates = [
        _rate_between(first, second, settings)
        for first, second in ((window.before, window.scan), (window.scan, window.after))
        if first is not None and second is not None
    ]
    known = [rate for rate in rates if np.isfinite(rate)]
    return float(np.mean(known)) if known else float("nan")


def _rate_between(first: LaserScan, second: LaserScan, settings: TimeSettings) -> float:
    seconds = (second.stamp_ns - first.stamp_ns) / NS_PER_S
    comparable = (
        first.ranges_m.size == second.ranges_m.size
        and first.angle_increment_rad == second.angle_increment_rad
    )
    if not comparable or not 0.0 < seconds < 1.0:
        return float("nan")
    step_rad = first.angle_increment_rad
    reach = int(np.ceil(settings.max_turn_rate_rad_s * seconds / abs(step_rad)))
    reach = min(max(reach, 2), first.ranges_m.size // 4)
    cost = _shift_costs(first.ranges_m, second.ranges_m, reach, first.is_full_circle)
    if not np.isfinite(cost).any():
        return float("nan")
    best = int(np.nanargmin(cost))
    shift = best - reach + parabola_offset(cost, best)
    # A LiDAR that turns left by s beams sees at beam i what it saw at beam i + s.
    return float(shift * step_rad / seconds)


def parabola_offset(values: FloatArray, best: int) -> float:
    """Offset in [-0.5, 0.5] of the extremum of the parabola through three neighbours of ``best``.

    0 at the ends, where a neighbour is missing, and on a slope, where ``best`` is no extremum.
    """
    if best == 0 or best == values.size - 1:
        return 0.0
    left, middle, right = values[best - 1 : best + 2].tolist()
    curvature = left - 2.0 * middle + right
    on_slope = (left - middle) * (right - middle) < 0.0
    if not math.isfinite(curvature) or curvature == 0.0 or on_slope:
        return 0.0
    return float(min(0.5, max(-0.5, 0.5 * (left - right) / curvature)))


def scan_at_image(window: ScanWindow, gap_ns: int, settings: TimeSettings) -> LaserScan:
    """The scan with which a depth image is aligned: the paired one or, where ``settings`` ask for
    it and the neighbours allow it, one made for the image's instant.

    ``gap_ns``: image stamp - stamp of the paired scan, on one clock.
    """
    if settings.pair_by != "interpolated":
        return window.scan
    made = interpolate_scan(window, gap_ns, settings)
    return window.scan if made is None else made


def interpolate_scan(window: ScanWindow, gap_ns: int, settings: TimeSettings) -> LaserScan | None:
    """The scan that the LiDAR would have taken ``gap_ns`` after ``window.scan``.

    That scan and its neighbour on the other side of the instant are both turned to it by the rate
    measured between them. A beam's range is their mean by time where they are of one surface, else
    that of the paired scan: at edges and on moving things nothing is mixed. A range that one scan
    lacks is the other's; where both lack it, it is NaN.

    None at the scan's own stamp, without that neighbour or with one too far away, and where the
    rate between the two is not known.
    """
    scan, other = window.scan, window.after if gap_ns > 0 else window.before
    if gap_ns == 0 or other is None:
        return None
    interval_ns = abs(other.stamp_ns - scan.stamp_ns)
    # Within it, either neighbour may be the nearest scan of an image.
    if not abs(gap_ns) <= interval_ns <= 2.0 * settings.max_gap_ms * NS_PER_MS:
        return None
    first, second = (scan, other) if gap_ns > 0 else (other, scan)
    rate_rad_s = _rate_between(first, second, settings)
    if not np.isfinite(rate_rad_s):
        return None
    stamp_ns = scan.stamp_ns + gap_ns
    own_m, other_m = (
        _turned_ranges_m(
            source,
            rate_rad_s * (stamp_ns - source.stamp_ns) / NS_PER_S,
            settings.same_surface_m,
        )
        for source in (scan, other)
    )
    fraction = abs(gap_ns) / interval_ns
    ranges_m = _mix_m(own_m, other_m, fraction, settings.same_surface_m)
    ranges_m = np.where(np.isnan(own_m), other_m, ranges_m)
    return replace(scan, stamp_ns=stamp_ns, ranges_m=ranges_m, intensities=None)


def _turned_ranges_m(scan: LaserScan, turned_rad: float, same_surface_m: float) -> FloatArray:
    """(N,) what the beams would have met, had the LiDAR turned left by ``turned_rad`` before."""
    count = scan.ranges_m.size
    place = np.arange(count) + turned_rad / scan.angle_increment_rad
    right = np.floor(place).astype(np.int64)
    right_m, left_m = scan.ranges_at(right), scan.ranges_at(right + 1)
    fraction = place - right
    nearest_is_right = fraction < 0.5
    nearest_m = np.where(nearest_is_right, right_m, left_m)
    farther_m = np.where(nearest_is_right, left_m, right_m)
    return _mix_m(nearest_m, farther_m, np.minimum(fraction, 1.0 - fraction), same_surface_m)


def _mix_m(
    own_m: FloatArray, other_m: FloatArray, fraction: FloatArray | float, same_surface_m: float
) -> FloatArray:
    """``own_m`` moved by ``fraction`` towards ``other_m`` where both are of one surface."""
    # NaN compares false.
    is_same = np.abs(other_m - own_m) <= same_surface_m
    return np.where(is_same, own_m + fraction * (other_m - own_m), own_m)


@compiled()
def _shift_costs(
    first: FloatArray, second: FloatArray, reach: int, is_full_circle: bool
) -> FloatArray:
    """Mean capped range difference of second[i] and first[i + s] for s in -reach..reach."""
    beams = first.size
    # Beam 0 of ``first`` at index ``reach``, so that every shift is a slice.
    padded = np.full(beams + 2 * reach, np.nan)
    for place in range(padded.size):
        beam = place - reach
        if is_full_circle:
            beam %= beams
        if 0 <= beam < beams:
            padded[place] = first[beam]
    totals, counts = np.zeros(2 * reach + 1), np.zeros(2 * reach + 1)
    for beam in range(beams):
        own, others = second[beam], padded[beam : beam + 2 * reach + 1]
        for column in range(2 * reach + 1):
            difference = abs(own - others[column])
            is_known = difference == difference
            totals[column] += min(difference, _MAX_DIFFERENCE_M) if is_known else 0.0
            counts[column] += 1.0 if is_known else 0.0
    costs = np.full(2 * reach + 1, np.nan)
    for column in range(2 * reach + 1):
        if counts[column] * 4.0 >= beams:
            costs[column] = totals[column] / max(counts[column], 1.0)
    return costs
