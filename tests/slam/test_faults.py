"""Faults of a drive: wherever the trajectory is wrong, it says so, and where it is right, mostly.

The truth is simulated; the method does not know of the fault.
"""

import numpy as np
import pytest

from fusion_core.model.planar_poses import compose_poses, relative_pose
from fusion_core.slam.pose_graph_slam import pose_graph_slam
from tests.benchmarks.scan_matching_room import WALLS as ROOM
from tests.benchmarks.scan_matching_room import rectangle
from tests.slam.ring import Drive, drive, scan_of

WRONG_M = 0.3
BARE = rectangle((40.0, 0.0), (80.0, 2.2), 0.0)


def slow(value):
    return pytest.param(value, marks=pytest.mark.slow)


def unnoticed_errors(result, truth):
    """Scans that are wrong by more than 30 cm and trusted all the same."""
    found, expected = (relative_pose(of[0], of) for of in (result.poses_map_scan, truth))
    away_m = np.hypot(*(found - expected)[:, :2].T)
    return int(np.count_nonzero((away_m > WRONG_M) & result.trusted))


def room(count=200, seed=4):
    """A round and a bit in the furnished room, with wheels that err by some per cent."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(count) / 150
    truth = np.stack(
        [5.6 + 1.6 * np.cos(angle), 4.0 + 1.2 * np.sin(angle), angle + 0.5 * np.pi], axis=1
    )
    steps = relative_pose(truth[:-1], truth[1:])
    steps = steps * (1.0 + rng.normal(0.02, 0.03, steps.shape))
    odometry = [truth[0]]
    for step in steps:
        odometry.append(compose_poses(odometry[-1], step))
    return Drive(
        scans=[scan_of(pose, n, rng, ROOM, 12.0) for n, pose in enumerate(truth)],
        truth=truth,
        odometry=np.array(odometry),
    )


def with_steps(whole, change):
    """The drive with the odometry's steps (N - 1, 3) changed."""
    steps = relative_pose(whole.odometry[:-1], whole.odometry[1:])
    odometry = [whole.odometry[0]]
    for step in change(steps.copy()):
        odometry.append(compose_poses(odometry[-1], step))
    return Drive(scans=whole.scans, truth=whole.truth, odometry=np.array(odometry))


def run(whole, kept=None, *, prior=True):
    kept = np.arange(len(whole.scans)) if kept is None else kept
    result = pose_graph_slam([whole.scans[n] for n in kept], whole.prior if prior else None)
    return result, whole.truth[kept]


@pytest.mark.parametrize("prior", [True, False])
def test_a_tenth_of_the_scans_lost(prior):
    kept = np.flatnonzero(np.random.default_rng(2).random(200) > 0.1)
    result, truth = run(room(), kept, prior=prior)
    assert unnoticed_errors(result, truth) == 0
    assert result.trusted.mean() > 0.9


@pytest.mark.parametrize("prior", [True, False])
@pytest.mark.parametrize("begin", [30, slow(80), slow(131)])
def test_a_second_of_no_data(begin, prior):
    kept = np.concatenate([np.arange(begin), np.arange(begin + 5, 200)])
    result, truth = run(room(), kept, prior=prior)
    assert unnoticed_errors(result, truth) == 0
    assert result.trusted.mean() > 0.9


@pytest.mark.parametrize("slip", [0.0, 2.0, -1.0])
@pytest.mark.parametrize("seed", [4, slow(5)])
def test_wheels_that_slip_for_three_seconds(slip, seed):
    def change(steps):
        steps[60:75] *= slip
        return steps

    slipping = with_steps(room(seed=seed), change)
    result, truth = run(slipping)
    assert unnoticed_errors(result, truth) == 0
    assert result.trusted.mean() > 0.9


def test_wheels_that_spin_on_the_spot():
    def change(steps):
        steps[60:75] = [0.15, 0.0, 0.05]
        return steps

    result, truth = run(with_steps(room(), change))
    assert unnoticed_errors(result, truth) == 0
    assert result.trusted.mean() > 0.9


def kidnapped(ring, begin, shift):
    """The drive, but from ``begin`` on ``shift`` scans farther on its way, of which odometry knows
    nothing."""
    numbers = np.concatenate([np.arange(begin), np.arange(begin + shift, len(ring.scans))])
    steps = relative_pose(ring.odometry[:-1], ring.odometry[1:])
    steps = np.delete(steps, slice(begin, begin + shift), axis=0)
    odometry = [ring.odometry[0]]
    for step in steps:
        odometry.append(compose_poses(odometry[-1], step))
    return numbers, np.array(odometry)


@pytest.mark.parametrize("shift", [slow(60), 100, slow(170)])
def test_a_kidnapped_robot(shift):
    ring = drive(300)
    numbers, odometry = kidnapped(ring, 100, shift)
    kept = [ring.scans[n] for n in numbers]
    number_of = {scan.stamp_ns: n for n, scan in enumerate(kept)}
    result = pose_graph_slam(kept, lambda stamp_ns: odometry[number_of[stamp_ns]])
    assert unnoticed_errors(result, ring.truth[numbers]) == 0
    assert result.trusted[:100].mean() > 0.9
    assert not result.trusted[100:].any()


@pytest.mark.parametrize("prior", [True, False])
@pytest.mark.parametrize("shift", [30, slow(50), slow(90)])
def test_a_robot_kidnapped_within_a_room(shift, prior):
    whole = room(200)
    numbers, odometry = kidnapped(whole, 60, shift)
    kept = [whole.scans[n] for n in numbers]
    number_of = {scan.stamp_ns: n for n, scan in enumerate(kept)}
    result = pose_graph_slam(
        kept, (lambda stamp_ns: odometry[number_of[stamp_ns]]) if prior else None
    )
    assert unnoticed_errors(result, whole.truth[numbers]) == 0
    assert result.trusted[:60].mean() > 0.9


def test_a_kidnapped_robot_that_returns_to_where_it_was():
    ring = drive(900, turn_bias_rad_per_m=0.005)
    numbers, odometry = kidnapped(ring, 250, 130)
    kept = [ring.scans[n] for n in numbers]
    number_of = {scan.stamp_ns: n for n, scan in enumerate(kept)}
    result = pose_graph_slam(kept, lambda stamp_ns: odometry[number_of[stamp_ns]])
    found, expected = (
        relative_pose(of[0], of) for of in (result.poses_map_scan, ring.truth[numbers])
    )
    away_m = np.hypot(*(found - expected)[:, :2].T)
    assert np.hypot(*(relative_pose(odometry[0], odometry) - expected)[:, :2].T)[280:].min() > 1.0
    assert result.trusted[280:].mean() > 0.9
    assert np.median(away_m[280:]) < 0.3
    assert unnoticed_errors(result, ring.truth[numbers]) == 0


@pytest.mark.parametrize("reach_m", [4.0, slow(10.0)])
def test_a_bare_corridor_without_odometry_has_no_length(reach_m):
    rng = np.random.default_rng(3)
    number = np.arange(250)
    truth = np.stack(
        [3.0 + 0.1 * number, 0.1 * np.sin(0.03 * number), 0.03 * np.cos(0.03 * number)], axis=1
    )
    scans = [scan_of(pose, n, rng, BARE, reach_m) for n, pose in enumerate(truth)]
    whole = Drive(scans=scans, truth=truth, odometry=truth)
    blind, _ = run(whole, prior=False)
    # At the very first scans the map is too small to distinguish a corridor from a room.
    assert unnoticed_errors(blind, truth) <= 3
    assert blind.trusted.mean() < 0.2
    # With odometry it has.
    result, _ = run(whole)
    assert result.trusted.mean() > 0.9
    length_m = np.hypot(*(result.poses_map_scan[-1] - result.poses_map_scan[0])[:2])
    assert length_m == pytest.approx(0.1 * 249, rel=0.1)


def contradicted(ring, begin, end):
    """The drive with scans that see something else close by, as on a ramp; odometry stays."""
    scans = [
        scan.with_ranges(np.full_like(scan.ranges_m, 0.9), None) if begin <= n < end else scan
        for n, scan in enumerate(ring.scans)
    ]
    return Drive(scans=scans, truth=ring.truth, odometry=ring.odometry)


def test_a_ramp_where_the_laser_sees_the_floor_is_bridged_by_odometry_when_a_loop_confirms_it():
    ring = contradicted(drive(650, turn_bias_rad_per_m=0.003), 200, 214)
    result, truth = run(ring)
    assert not result.trusted[201:210].any()
    # The loop lies after the tracking loss; what is between depends on odometry, which it confirms.
    assert result.trusted[230:].mean() > 0.9
    assert unnoticed_errors(result, truth) == 0
    # Before the place is seen again, a ramp cannot be distinguished from another building.
    early, _ = run(ring, np.arange(400))
    assert not early.trusted[220:].any()
