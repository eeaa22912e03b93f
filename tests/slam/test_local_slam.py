"""Local SLAM: tracking states, and scan-matched odometry without the memory of a map."""

import numpy as np

from fusion_core.slam.local_slam import LocalSlam, LocalSlamSettings
from fusion_core.slam.submaps import SubmapSettings
from fusion_core.slam.tracking import TrackingState
from tests.slam.ring import drive

SUBMAPS = SubmapSettings(keyframes=10)


def test_dropping_the_map_does_not_change_the_poses():
    ring = drive(150)
    slam, odometry = (LocalSlam(LocalSlamSettings(), SUBMAPS) for _ in range(2))
    placed = []
    for scan, pose in zip(ring.scans, ring.odometry, strict=True):
        slam.add_scan(scan, pose)
        placed.append(odometry.add_scan(scan, pose))
        odometry.drop_map()
    local = slam.finish()
    poses = np.array([tracked.pose_local_scan for tracked in placed])
    np.testing.assert_array_equal(poses, local.poses_local_scan)
    assert all(tracked.fits for tracked in placed)
    for node, points_m in zip(local.keyframes, local.node_points_m, strict=True):
        np.testing.assert_array_equal(placed[node].points_m, points_m)
    # What is left are the two submaps that still grow.
    assert len(local.submaps) >= 10
    dropped = odometry.finish()
    assert len(dropped.submaps) <= 2
    assert sum(points_m.size for points_m in dropped.node_points_m) == 0


def test_a_scan_without_points_is_dead_reckoned():
    ring = drive(60)
    slam = LocalSlam(LocalSlamSettings(), SUBMAPS)
    states = [
        slam.add_scan(scan, pose).state
        for scan, pose in zip(ring.scans[:40], ring.odometry, strict=False)
    ]
    assert states[0] is TrackingState.INITIALISING
    assert set(states[1:]) == {TrackingState.TRACKING}
    blind = ring.scans[40].with_ranges(np.full(ring.scans[40].ranges_m.shape, np.nan), None)
    tracked = slam.add_scan(blind, ring.odometry[40])
    assert tracked.state is TrackingState.DEAD_RECKONING
    assert not tracked.fits
    assert not tracked.is_trusted
    assert tracked.points_m.shape == (0, 2)


def test_a_contradicted_scan_is_not_inserted_and_many_begin_a_segment():
    ring = drive(80)
    slam = LocalSlam(LocalSlamSettings(contradictions_max=12), SUBMAPS)
    tracked = []
    for number, (scan, pose) in enumerate(zip(ring.scans[:70], ring.odometry, strict=False)):
        # From the fortieth on, something else is close by.
        near = scan.with_ranges(np.full_like(scan.ranges_m, 0.9), None)
        tracked.append(slam.add_scan(near if number >= 40 else scan, pose))
    states = [scan.state for scan in tracked]
    assert states[41:50] == [TrackingState.CONTRADICTED] * 9
    first = next(n for n, scan in enumerate(tracked) if scan.segment == 1)
    assert 50 <= first <= 55
    local = slam.finish()
    assert not np.isin(np.arange(40, first), local.keyframes).any()
    assert local.keyframes[np.flatnonzero(local.segment == 1)[0]] == first
    assert not local.is_trusted[40:first].any()
    np.testing.assert_array_equal(local.is_trusted, [scan.is_trusted for scan in tracked])
