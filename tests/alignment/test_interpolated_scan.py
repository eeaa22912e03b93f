"""Scans of an image's instant, against the closed form of the room at that instant."""

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from fusion_core.alignment import interpolated_scan
from fusion_core.alignment.interpolated_scan import scan_at_image
from fusion_core.alignment.scan_motion import ScanMotion
from fusion_core.alignment.time import ScanWindow, TimeSettings
from fusion_core.model.conventions import NS_PER_MS, NS_PER_S
from fusion_core.model.sensors import LaserScan
from tests.alignment.polygon_room import PERIOD_NS, scan_at, turning

INTERPOLATED = TimeSettings(pair_by="interpolated")


def driving_scan(seconds: float, rate_rad_s: float, **values: float) -> LaserScan:
    """A LiDAR that turns and drives at 0.5 m/s along the room, at an instant."""
    return scan_at(
        0.4 + rate_rad_s * seconds,
        round(seconds * NS_PER_S),
        x=2.2 + 0.5 * seconds,
        **values,
    )


def driving(rate_rad_s: float, **values: float) -> ScanWindow:
    before, scan, after = (driving_scan(0.1 * k, rate_rad_s, seed=k, **values) for k in range(3))
    return ScanWindow(before=before, scan=scan, after=after)


@pytest.mark.parametrize("beams", [480, 720])
@pytest.mark.parametrize("gap_ms", [-49, -30, -5, 5, 30, 49])
@pytest.mark.parametrize("rate_rad_s", [-0.8, 0.0, 0.4])
def test_an_interpolated_scan_is_that_of_its_instant(
    rate_rad_s: float, gap_ms: int, beams: int
) -> None:
    """Against the closed form of the room at that instant, and against the nearest scan."""
    window = driving(rate_rad_s, beams=beams)
    gap_ns = gap_ms * NS_PER_MS
    made = scan_at_image(window, gap_ns, INTERPOLATED)
    true_m = driving_scan(0.1 + gap_ms * 1e-3, rate_rad_s, beams=beams).ranges_m
    assert made.stamp_ns == window.scan.stamp_ns + gap_ns
    off_m = np.abs(made.ranges_m - true_m)
    nearest_m = np.abs(window.scan.ranges_m - true_m)
    # Corners are cut by less than a beam's width.
    assert np.nanmedian(off_m) < 0.003
    assert np.nanmean(off_m < 0.03) > 0.97
    if abs(gap_ms) >= 30:
        assert np.nanmean(off_m) < 0.4 * np.nanmean(nearest_m)
    # Beams that the turn brings in from beyond an end have no value.
    lost = round(abs(rate_rad_s * 0.1) / np.deg2rad(0.5)) + 1
    assert np.isnan(made.ranges_m).sum() <= (0 if beams == 720 else lost)


@pytest.mark.parametrize("gap_ms", [-40, 25])
def test_what_is_mixed_equals_a_loop_over_the_beams(gap_ms: int) -> None:
    """Of a LiDAR that stands still: means by time, except at edges and where one is missing."""
    rng = np.random.default_rng(8)
    window = turning(0.0)
    scans = []
    for scan in (window.before, window.scan, window.after):
        ranges_m = scan.ranges_m + 0.02 * rng.normal(size=480)
        ranges_m[rng.random(480) < 0.2] = np.nan
        moved = rng.random(480) < 0.1
        ranges_m[moved] -= 0.5
        scans.append(scan.with_ranges(ranges_m, None))
    window = ScanWindow(before=scans[0], scan=scans[1], after=scans[2])
    # Measured as standing: the loop below knows of no turn.
    standing = ScanMotion(velocity=np.zeros(3), turn_rate_sd_rad_s=0.0)
    with patch.object(interpolated_scan, "motion_between", lambda *_: standing):
        made = scan_at_image(window, gap_ms * NS_PER_MS, INTERPOLATED).ranges_m
    own, other = scans[1].ranges_m, scans[0 if gap_ms < 0 else 2].ranges_m
    seen = set()
    for beam in range(480):
        if np.isnan(own[beam]) and np.isnan(other[beam]):
            seen.add("neither")
            assert np.isnan(made[beam])
        elif np.isnan(own[beam]):
            seen.add("other")
            assert made[beam] == pytest.approx(other[beam], rel=1e-12)
        elif np.isnan(other[beam]) or abs(own[beam] - other[beam]) > 0.15:
            seen.add("own")
            assert made[beam] == pytest.approx(own[beam], rel=1e-12)
        else:
            seen.add("mixed")
            late = abs(gap_ms) / 100.0
            assert made[beam] == pytest.approx((1.0 - late) * own[beam] + late * other[beam])
    assert seen == {"neither", "other", "own", "mixed"}


def test_nothing_is_mixed_across_an_edge() -> None:
    """Each range is one of the two surfaces', whatever the turn."""
    angles = scan_at(0.0).angles_rad
    scans = [
        scan_at(0.0, k * PERIOD_NS).with_ranges(
            np.where(np.sin(7.0 * (angles + 0.06 * k)) > 0.0, 1.0, 2.0), None
        )
        for k in range(3)
    ]
    window = ScanWindow(before=scans[0], scan=scans[1], after=scans[2])
    for gap_ms in (-45, -20, 20, 45):
        made = scan_at_image(window, gap_ms * NS_PER_MS, INTERPOLATED).ranges_m
        made = made[np.isfinite(made)]
        assert made.size > 450
        assert (np.isclose(made, 1.0) | np.isclose(made, 2.0)).all()


def test_the_paired_scan_is_kept_where_nothing_can_be_interpolated() -> None:
    window = driving(0.3)
    blind = window.after.with_ranges(np.full(480, np.nan), None)
    far = replace(window.after, stamp_ns=window.scan.stamp_ns + 130 * NS_PER_MS)
    gap_ns = 20 * NS_PER_MS
    cases = {
        "not asked for": (window, gap_ns, TimeSettings()),
        "at its stamp": (window, 0, INTERPOLATED),
        "no scan after": (replace(window, after=None), gap_ns, INTERPOLATED),
        "no scan before": (replace(window, before=None), -gap_ns, INTERPOLATED),
        "no rate": (replace(window, after=blind), gap_ns, INTERPOLATED),
        "the next one lost": (replace(window, after=far), gap_ns, INTERPOLATED),
        "beyond the next": (window, 101 * NS_PER_MS, INTERPOLATED),
    }
    for name, (own, own_gap_ns, chosen) in cases.items():
        assert scan_at_image(own, own_gap_ns, chosen) is own.scan, name
    assert scan_at_image(window, gap_ns, INTERPOLATED) is not window.scan
