"""A ring of corridors about a block, driven round once and a bit: truth, noisy scans, odometry.

The method does not know the noise: ranges with noise and strays, beams lost, and odometry
whose wheels differ, so that its heading drifts.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.planar_poses import compose_poses, relative_pose
from fusion_core.model.sensors import LaserScan
from tests.benchmarks.scan_matching_room import cast, rectangle

WALLS = np.concatenate(
    [rectangle((8.0, 6.0), (16.0, 12.0), 0.0), rectangle((8.0, 6.0), (11.0, 7.0), 0.0)]
    + [
        rectangle(centre, size, yaw)
        for centre, size, yaw in (
            ((3.0, 0.2), (0.6, 0.4), 0.0),
            ((7.4, 2.4), (0.8, 0.2), 0.0),
            ((12.1, 0.3), (0.9, 0.5), 0.2),
            ((15.8, 4.4), (0.4, 1.1), 0.0),
            ((13.7, 7.9), (0.3, 0.6), 0.0),
            ((11.0, 11.7), (1.2, 0.5), -0.1),
            ((5.2, 9.7), (0.6, 0.3), 0.0),
            ((0.3, 8.3), (0.5, 0.7), 0.3),
            ((0.2, 3.1), (0.4, 0.5), 0.0),
        )
    ]
)
BEAMS = 180
RANGE_MAX_M = 4.0
STEP_M = 0.1
SIGMA_M = 0.015
# Wheels smaller than odometry takes them to be.
SCALE = 0.06
STRAYS, LOST = 0.01, 0.02


@dataclass(frozen=True, kw_only=True)
class Drive:
    """N scans with the truth and the odometry of each, (N, 3) poses."""

    scans: list[LaserScan]
    truth: FloatArray
    odometry: FloatArray

    def prior(self, stamp_ns: int) -> FloatArray:
        """The odometry of the scan with that stamp."""
        return self.odometry[self.numbers[stamp_ns]]

    @property
    def numbers(self) -> dict[int, int]:
        return {scan.stamp_ns: number for number, scan in enumerate(self.scans)}

    @property
    def stamps_ns(self) -> IntArray:
        return np.array([scan.stamp_ns for scan in self.scans])


def drive(
    scans: int = 600, *, seed: int = 1, turn_bias_rad_per_m: float = 0.03, step_m: float = STEP_M
) -> Drive:
    """Anticlockwise along the middle of the corridors, from the lower left."""
    rng = np.random.default_rng(seed)
    truth = np.array([on_the_way(step_m * number) for number in range(scans)])
    steps = relative_pose(truth[:-1], truth[1:])
    steps[:, 0] *= 1.0 + rng.normal(SCALE, 0.03, scans - 1)
    steps[:, 2] += turn_bias_rad_per_m * step_m + rng.normal(0.0, 0.003, scans - 1)
    odometry = [truth[0]]
    for step in steps:
        odometry.append(compose_poses(odometry[-1], step))
    return Drive(
        scans=[scan_of(pose, number, rng) for number, pose in enumerate(truth)],
        truth=truth,
        odometry=np.array(odometry),
    )


def on_the_way(way_m: float) -> FloatArray:
    """(3,) pose on a rectangle with rounded corners about the block."""
    centre, half, radius = np.array([8.0, 6.0]), np.array([6.75, 4.75]), 0.8
    straight = 2.0 * (half - radius)
    arc = 0.5 * np.pi * radius
    way_m %= 2.0 * straight.sum() + 4.0 * arc
    corner = centre - half + [radius, 0.0]
    heading = 0.0
    for side in range(4):
        ahead = np.array([np.cos(heading), np.sin(heading)])
        if way_m <= straight[side % 2]:
            return np.array([*(corner + way_m * ahead), heading])
        way_m -= straight[side % 2]
        corner = corner + straight[side % 2] * ahead
        left = np.array([-ahead[1], ahead[0]])
        if way_m <= arc:
            turned = way_m / radius
            at = corner + radius * (np.sin(turned) * ahead + (1.0 - np.cos(turned)) * left)
            return np.array([*at, heading + turned])
        way_m -= arc
        corner = corner + radius * (ahead + left)
        heading += 0.5 * np.pi
    raise AssertionError("the path is longer than the round")


def scan_of(
    pose: FloatArray,
    number: int,
    rng: np.random.Generator,
    walls: FloatArray = WALLS,
    reach_m: float = RANGE_MAX_M,
) -> LaserScan:
    angles_rad = -0.5 * np.pi + np.pi / BEAMS * np.arange(BEAMS)
    ranges_m, _ = cast(walls, pose, angles_rad)
    ranges_m = ranges_m + rng.normal(0.0, SIGMA_M, BEAMS)
    strays = rng.random(BEAMS) < STRAYS
    ranges_m[strays] *= rng.uniform(0.2, 1.0, strays.sum())
    ranges_m[(ranges_m > reach_m) | (rng.random(BEAMS) < LOST)] = np.nan
    return scan_with(ranges_m, number)


def scan_with(ranges_m: FloatArray, number: int) -> LaserScan:
    """Five scans a second."""
    return LaserScan(
        stamp_ns=10**9 + 200_000_000 * number,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=-0.5 * np.pi,
        angle_increment_rad=np.pi / BEAMS,
        range_min_m=0.05,
        range_max_m=RANGE_MAX_M,
        ranges_m=ranges_m,
    )


def error_m(poses: FloatArray, truth: FloatArray) -> float:
    """Root mean square distance of the places, both begun at the same pose."""
    away = relative_pose(poses[0], poses)[:, :2] - relative_pose(truth[0], truth)[:, :2]
    return float(np.sqrt((away**2).sum(axis=1).mean()))


def revisit_error_m(poses: FloatArray, truth: FloatArray, round_scans: int = 446) -> float:
    """Root mean square error of where scans of the second round lie, seen from the first's."""
    later = np.arange(round_scans, len(poses))
    found, expected = (
        relative_pose(of[later - round_scans], of[later])[:, :2] for of in (poses, truth)
    )
    return float(np.sqrt(((found - expected) ** 2).sum(axis=1).mean()))
