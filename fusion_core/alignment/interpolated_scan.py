"""The scan of a depth image's own instant, made from its two neighbours in time."""

from dataclasses import replace

import numpy as np

from fusion_core.alignment.moved_scan import move_scan
from fusion_core.alignment.scan_motion import motion_between
from fusion_core.alignment.time import ScanWindow, TimeSettings
from fusion_core.model.conventions import NS_PER_MS, NS_PER_S
from fusion_core.model.sensors import LaserScan


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

    That scan and its neighbour on the other side of the instant are both moved to it by the motion
    measured between them. A beam's range is their mean by time where they are of one surface, else
    that of the paired scan: at edges and on moving things nothing is mixed. A range that one scan
    lacks is the other's; where both lack it, it is NaN.

    None at the scan's own stamp, without that neighbour or with one too far away, and where the
    motion between the two is not known.
    """
    scan, other = window.scan, window.after if gap_ns > 0 else window.before
    if gap_ns == 0 or other is None:
        return None
    interval_ns = abs(other.stamp_ns - scan.stamp_ns)
    # Within it, either neighbour may be the nearest scan of an image.
    if not abs(gap_ns) <= interval_ns <= 2.0 * settings.max_gap_ms * NS_PER_MS:
        return None
    first, second = (scan, other) if gap_ns > 0 else (other, scan)
    motion = motion_between(first, second, settings)
    if motion is None:
        return None
    stamp_ns = scan.stamp_ns + gap_ns
    own_m, other_m = (
        move_scan(
            source,
            motion.pose_after((stamp_ns - source.stamp_ns) / NS_PER_S),
            settings.same_surface_m,
        ).ranges_m
        for source in (scan, other)
    )
    fraction = abs(gap_ns) / interval_ns
    # NaN compares false.
    is_same = np.abs(other_m - own_m) <= settings.same_surface_m
    ranges_m = np.where(is_same, own_m + fraction * (other_m - own_m), own_m)
    ranges_m = np.where(np.isnan(own_m), other_m, ranges_m)
    return replace(scan, stamp_ns=stamp_ns, ranges_m=ranges_m, intensities=None)
