"""Scans of a room of plane walls, whose ranges have a closed form."""

import numpy as np

from fusion_core.alignment.time import ScanWindow
from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.sensors import LaserScan

PERIOD_NS = 100_000_000
# A room with two oblique walls and a bay, counter-clockwise, in metres.
ROOM = np.array([[0, 0], [6, 0], [6, 2.5], [4.8, 3], [4.8, 4.2], [1.5, 4.2], [0, 3]], dtype=float)


def range_to_walls_m(x: float, y: float, azimuths: np.ndarray) -> np.ndarray:
    """Nearest crossing of each ray with the polygon's sides, by Cramer's rule."""
    nearest = np.full(azimuths.shape, np.inf)
    dx, dy = np.cos(azimuths), np.sin(azimuths)
    for (ax, ay), (bx, by) in zip(ROOM, np.roll(ROOM, -1, axis=0), strict=True):
        ex, ey = bx - ax, by - ay
        det = dy * ex - dx * ey
        with np.errstate(divide="ignore", invalid="ignore"):
            length = ((ay - y) * ex - (ax - x) * ey) / det
            fraction = (dx * (ay - y) - dy * (ax - x)) / det
        hit = (length > 0.0) & (fraction >= 0.0) & (fraction <= 1.0)
        nearest = np.where(hit & (length < nearest), length, nearest)
    return nearest


def scan_at(
    yaw: float,
    stamp_ns: int = 0,
    *,
    increment_deg: float = 0.5,
    beams: int = 480,
    noise_m: float = 0.0,
    holes: float = 0.0,
    seed: int = 0,
    x: float = 2.6,
    y: float = 1.9,
) -> LaserScan:
    increment = float(np.deg2rad(increment_deg))
    first = -0.5 * (beams - 1) * increment
    ranges_m = range_to_walls_m(x, y, yaw + first + increment * np.arange(beams))
    rng = np.random.default_rng(seed)
    ranges_m = ranges_m + noise_m * rng.normal(size=beams)
    ranges_m[rng.random(beams) < holes] = np.nan
    return LaserScan(
        stamp_ns=stamp_ns,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=first,
        angle_increment_rad=increment,
        range_min_m=0.05,
        range_max_m=30.0,
        ranges_m=ranges_m,
    )


def turning(rate_rad_s: float, **values: float) -> ScanWindow:
    """Three scans of a LiDAR that turns at a constant rate."""
    step_rad = rate_rad_s * PERIOD_NS / NS_PER_S
    before, scan, after = (
        scan_at(0.4 + k * step_rad, k * PERIOD_NS, seed=k, **values) for k in range(3)
    )
    return ScanWindow(before=before, scan=scan, after=after)
