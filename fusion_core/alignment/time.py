"""Xu 2024 §2.1: which scan belongs to a depth image.

The paper pairs by sampling rates, t = f(i) / g(j); with stamps the nearest scan is the same where
the rates are constant and right where they are not. A robot that turns at 0.5 rad/s and drives at
0.6 m/s turns by 1.4 degrees and moves by 3 cm within half a scan period, so the motion between the
two stamps is compensated (``scan_motion``). Interpolation goes one step further: the scan of the
image's own instant, from its two neighbours in time (``interpolated_scan``).
"""

from dataclasses import dataclass
from typing import Literal

from fusion_core.model.sensors import LaserScan
from fusion_core.settings import StageSettings, setting


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
        "Ranges of neighbouring beams that differ by no more are of one surface, which lies "
        "between them when the scan is seen from another place; of two scans, interpolation mixes "
        "such ranges, and takes the one nearest in time of others",
        unit="m",
        ge=1e-6,
        le=10.0,
    )
    max_turn_rate_rad_s: float = setting(
        2.0, "Fastest turn that is looked for between two scans", unit="rad/s", ge=1e-6, le=100.0
    )
    speed_sd_m_s: float = setting(
        1.0,
        "How fast robots drive (standard deviation): where scans do not show it, as along a "
        "corridor, the LiDAR is taken to stand",
        unit="m/s",
        ge=1e-6,
        le=100.0,
    )
    compensate_motion: bool = setting(
        True,
        "Take out the LiDAR's motion between the stamps of scan and image",
        formerly="compensate_turn",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanWindow:
    """The scan paired with an image, and its neighbours in time where there are any."""

    before: LaserScan | None
    scan: LaserScan
    after: LaserScan | None
