"""Paths turn both ways, close, and touch nothing."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.simulation import worlds
from fusion_core.simulation.odometry import DriftingOdometry, OdometryNoise
from fusion_core.simulation.paths import WeavingPath, closed_curve

MAKERS = [
    worlds.furnished_room,
    worlds.room_with_person,
    worlds.open_corridor,
    worlds.bedroom,
    worlds.two_rooms,
]


def poses(world, duration_s=60.0, step_s=0.05, start=0.0):
    path = WeavingPath(world.route_m, speed_m_s=0.3, start=start)
    return np.array([path.pose(t) for t in np.arange(0.0, duration_s, step_s)])


def gap_m(points, footprint):
    """Distance from each point to a rectangle, by its nearest point."""
    x0, y0, x1, y1 = footprint
    nearest = np.stack([np.clip(points[:, 0], x0, x1), np.clip(points[:, 1], y0, y1)], axis=1)
    return np.linalg.norm(points - nearest, axis=1)


@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("seed", range(6))
def test_the_robot_touches_nothing(make, seed):
    world = make(seed)
    at = poses(world)[:, :2]
    assert (at > 0.3).all()
    assert (at < np.array(world.size_m) - 0.3).all()
    assert len(world.blocks_m) >= 3
    for block in world.blocks_m:
        assert gap_m(at, block).min() > 0.24
    for walker in world.walkers:
        for time_s in np.arange(0.0, 20.0, 1.0):
            x, y = walker.mesh_at(time_s).corners_m[..., :2].reshape(-1, 2).T
            assert gap_m(at, (x.min(), y.min(), x.max(), y.max())).min() > 0.2


@pytest.mark.parametrize("make", MAKERS)
def test_furniture_does_not_overlap(make):
    for seed in range(6):
        blocks = make(seed).blocks_m
        for i, a in enumerate(blocks):
            for b in blocks[:i]:
                shared_x = min(a[2], b[2]) - max(a[0], b[0])
                shared_y = min(a[3], b[3]) - max(a[1], b[1])
                assert min(shared_x, shared_y) <= 1e-9


@pytest.mark.parametrize("make", MAKERS)
def test_the_robot_turns_both_ways_within_seconds(make):
    yaw = np.unwrap(poses(make(1), duration_s=8.0)[:, 2])
    rate = np.diff(yaw) / 0.05
    assert rate.max() > 0.3
    assert rate.min() < -0.3


def test_speed_is_constant_and_the_heading_is_the_tangent():
    step = 0.01
    at = poses(worlds.furnished_room(0), duration_s=30.0, step_s=step)
    moved = np.diff(at[:, :2], axis=0)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1) / step, 0.3, rtol=0.02)
    between = np.exp(0.5j * (at[1:, 2] + at[:-1, 2]))
    direction = (moved[:, 0] + 1j * moved[:, 1]) / (0.3 * step)
    wrapped = np.abs(np.diff(at[:, 2])) > 3
    np.testing.assert_allclose(direction[~wrapped], between[~wrapped], atol=0.03)


@given(st.floats(0.0, 200.0), st.floats(0.0, 0.999))
def test_a_path_repeats_after_one_round(time_s, start):
    route = np.array([[1.0, 1.0], [4.0, 1.2], [4.2, 3.0], [1.1, 2.8]])
    path = WeavingPath(route, speed_m_s=0.25, start=start)
    round_s = path.length_m / 0.25
    first, second = path.pose(time_s), path.pose(time_s + round_s)
    np.testing.assert_allclose(first[:2], second[:2], atol=1e-6)
    assert np.cos(first[2] - second[2]) == pytest.approx(1.0)


def test_a_closed_curve_passes_its_waypoints():
    waypoints = np.array([[1.0, 1.0], [4.0, 1.2], [4.2, 3.0], [1.1, 2.8]])
    curve = closed_curve(waypoints)
    for waypoint in waypoints:
        assert np.linalg.norm(curve - waypoint, axis=1).min() < 0.01


def test_perfect_odometry_is_the_motion_from_the_start():
    perfect = OdometryNoise(
        distance_scale=1.0,
        yaw_drift_rad_per_s=0.0,
        relative_distance_sigma=0.0,
        relative_yaw_sigma=0.0,
    )
    odometry = DriftingOdometry(perfect, np.random.default_rng(0))
    at = poses(worlds.bedroom(0), duration_s=5.0)
    for number, pose in enumerate(at):
        T_odom_base = odometry.step(0.05 * number, pose)
    turn = at[0, 2]
    moved = at[-1, :2] - at[0, :2]
    expected = np.array(
        [
            np.cos(turn) * moved[0] + np.sin(turn) * moved[1],
            -np.sin(turn) * moved[0] + np.cos(turn) * moved[1],
        ]
    )
    np.testing.assert_allclose(T_odom_base[:2, 3], expected, atol=1e-9)


def test_odometry_drifts_and_starts_at_zero():
    odometry = DriftingOdometry(OdometryNoise(), np.random.default_rng(0))
    np.testing.assert_array_equal(odometry.step(0.0, np.array([3.0, 2.0, 1.0])), np.eye(4))
    for number in range(1, 201):
        T_odom_base = odometry.step(0.05 * number, np.array([3.0, 2.0, 1.0]))
    # Ten seconds of standing: the heading alone drifts.
    assert np.arctan2(T_odom_base[1, 0], T_odom_base[0, 0]) == pytest.approx(0.04)
