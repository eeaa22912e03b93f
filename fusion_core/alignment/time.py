"""Xu 2024 §2.1: which scan belongs to a depth image, and how the LiDAR turned between the two.

The paper pairs by sampling rates, t = f(i) / g(j); with stamps the nearest scan is the same where
the rates are constant and right where they are not. A robot that turns at 0.5 rad/s turns by 1.4
degrees within half a scan period, so the turn between the two stamps is compensated, with a rate
measured from consecutive scans: no odometry is needed.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.sensors import LaserScan
from fusion_core.settings import StageSettings, setting

# A range difference beyond this is between two surfaces and does not measure the turn; set by hand.
_MAX_DIFFERENCE_M = 0.3


class TimeSettings(StageSettings):
    """How scans and depth images are paired."""

    max_gap_ms: float = setting(
        60.0, "Greatest time between a depth image and its scan", unit="ms", ge=1e-6, le=5_000.0
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
    cost = _shift_costs(first.ranges_m, second.ranges_m, reach)
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
    left, middle, right = values[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    on_slope = (left - middle) * (right - middle) < 0.0
    if not np.isfinite(curvature) or curvature == 0.0 or on_slope:
        return 0.0
    return float(np.clip(0.5 * (left - right) / curvature, -0.5, 0.5))


@compiled()
def _shift_costs(first: FloatArray, second: FloatArray, reach: int) -> FloatArray:
    """Mean capped range difference of second[i] and first[i + s] for s in -reach..reach."""
    beams = first.size
    cost = np.full(2 * reach + 1, np.nan)
    for column in range(2 * reach + 1):
        shift = column - reach
        total = 0.0
        count = 0
        for beam in range(max(0, -shift), min(beams, beams - shift)):
            difference = abs(second[beam] - first[beam + shift])
            if difference == difference:
                total += min(difference, _MAX_DIFFERENCE_M)
                count += 1
        if count * 4 >= beams:
            cost[column] = total / count
    return cost
