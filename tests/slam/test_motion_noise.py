"""The particle filter's motion noise against errors of scan-matched odometry in corridors."""

import numpy as np
import pytest

from fusion_core.model.planar_poses import relative_pose
from fusion_core.slam.local_slam import LocalSlam, LocalSlamSettings
from fusion_core.slam.particle_filter import ParticleSettings
from fusion_core.slam.submaps import SubmapSettings
from tests.slam.ring import drive


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("over_scans", [10, 30])
def test_the_motion_noise_is_that_of_scan_matched_odometry(seed, over_scans):
    """Over 1 m and 3 m, with wheels that measure 6 % too much; rotation leaves room for errors."""
    ring = drive(seed=seed)
    local_slam = LocalSlam(LocalSlamSettings(), SubmapSettings())
    poses = np.array(
        [
            local_slam.add_scan(scan, ring.prior(scan.stamp_ns)).pose_local_scan
            for scan in ring.scans
        ]
    )
    true, found = (relative_pose(of[:-over_scans], of[over_scans:]) for of in (ring.truth, poses))
    errors = relative_pose(true, found)
    distance_m = 0.1 * over_scans
    sigma_m, sigma_rad = np.sqrt((errors[:, [0, 2]] ** 2).mean(axis=0) / distance_m)
    settings = ParticleSettings()
    assert 0.6 * sigma_m < settings.sigma_m_per_m < 1.3 * sigma_m
    assert 3.0 * sigma_rad < settings.sigma_rad_per_m
