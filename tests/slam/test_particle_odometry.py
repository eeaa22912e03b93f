"""The particles' odometry is local SLAM without its memory."""

import numpy as np

from fusion_core.slam.local_slam import LocalSlam, LocalSlamSettings
from fusion_core.slam.particle_odometry import ScanMatchedOdometry
from fusion_core.slam.submaps import SubmapSettings
from tests.slam.ring import drive

SUBMAPS = SubmapSettings(key_scans=10)


def test_it_places_scans_as_local_slam_does():
    ring = drive(150)
    slam = LocalSlam(LocalSlamSettings(), SUBMAPS)
    odometry = ScanMatchedOdometry(LocalSlamSettings(), SUBMAPS)
    placed = []
    for scan, pose in zip(ring.scans, ring.odometry, strict=True):
        slam.add_scan(scan, pose)
        placed.append(odometry.place(scan, pose))
    local = slam.finish()
    poses = np.array([local_pose.pose_local_scan for local_pose in placed])
    np.testing.assert_array_equal(poses, local.poses_local_scan)
    assert all(local_pose.is_sure for local_pose in placed)
    for node, points_m in zip(local.key_scans, local.node_points_m, strict=True):
        np.testing.assert_array_equal(placed[node].points_m, points_m)
    # What is left are the two submaps that still grow.
    assert len(local.submaps) >= 10
    forgotten = odometry.finish()
    assert len(forgotten.submaps) <= 2
    assert sum(points_m.size for points_m in forgotten.node_points_m) == 0


def test_a_scan_that_fits_nothing_is_not_sure():
    ring = drive(60)
    odometry = ScanMatchedOdometry(LocalSlamSettings(), SUBMAPS)
    for scan, pose in zip(ring.scans[:40], ring.odometry, strict=False):
        odometry.place(scan, pose)
    blind = ring.scans[40].with_ranges(np.full(ring.scans[40].ranges_m.shape, np.nan), None)
    placed = odometry.place(blind, ring.odometry[40])
    assert not placed.is_sure
    assert placed.points_m.shape == placed.wall_points_m.shape == (0, 2)
