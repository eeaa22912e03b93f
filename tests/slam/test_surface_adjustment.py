"""Keyframes, surfaces and odometry adjusted together, in a room with a thin panel."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.model.planar_poses import compose_poses, relative_pose, transform_planar_points
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.motion.steps import steps_between
from fusion_core.slam.surface_adjustment import (
    SurfaceAdjustmentSettings,
    _step_jacobian,
    _Steps,
    adjust_to_surfaces,
)
from fusion_core.slam.surface_elements import (
    SurfaceElementSettings,
    associate_returns,
    find_surface_elements,
)

ROOM_M = (6.0, 4.0)
# A panel of 2 cm that is seen from both sides.
PANEL_X_M, PANEL_M = (2.99, 3.01), (1.2, 2.8)
COUNT = 40
# Of a step of the graph: 3 cm and 0.01 rad.
LOCAL = np.diag(np.array([0.03, 0.03, 0.01]) ** -2.0)
SETTINGS = SurfaceAdjustmentSettings()


def true_poses():
    angle = np.linspace(0.0, 2.0 * np.pi, COUNT, endpoint=False)
    return np.stack(
        [3.0 + 2.0 * np.cos(angle), 2.0 + 1.3 * np.sin(angle), angle + 0.5 * np.pi], axis=1
    )


def scan_points_m(pose, rng, beams=240, relative_sigma=0.004):
    """(n, 2) returns of a full turn; the noise grows with the range."""
    azimuth = 2.0 * np.pi * np.arange(beams) / beams + pose[2]
    along = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    ranges_m = np.full(beams, np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for axis in (0, 1):
            for wall_m in (0.0, ROOM_M[axis]):
                away_m = (wall_m - pose[axis]) / along[:, axis]
                ranges_m = np.where(away_m > 1e-6, np.minimum(ranges_m, away_m), ranges_m)
        for panel_m in PANEL_X_M:
            away_m = (panel_m - pose[0]) / along[:, 0]
            y_m = pose[1] + away_m * along[:, 1]
            hit = (away_m > 1e-6) & (y_m > PANEL_M[0]) & (y_m < PANEL_M[1])
            ranges_m = np.where(hit, np.minimum(ranges_m, away_m), ranges_m)
    ranges_m = ranges_m + rng.normal(0.0, 1.0, beams) * relative_sigma * ranges_m
    azimuth = azimuth - pose[2]
    return ranges_m[:, np.newaxis] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)


def odometry_of(truth, rng, sigma=(0.002, 0.002, 0.001), scale=1.0, declared=1.0):
    """Steps with that noise, whose covariance is declared ``declared`` times as large."""
    steps = (
        steps_between(truth) * [scale, scale, 1.0] + rng.normal(0.0, 1.0, (COUNT - 1, 3)) * sigma
    )
    poses = [truth[0]]
    for step in steps:
        poses.append(compose_poses(poses[-1], step))
    covariance = np.repeat(np.diag(np.array(sigma) ** 2)[np.newaxis], COUNT - 1, axis=0)
    return OdometryTrajectory(
        name="visual-slam",
        stamps_ns=stamps_ns(),
        poses_odom_lidar=np.array(poses),
        step_covariance=declared**2 * covariance,
        drift_covariance=declared**2 * covariance,
        measured=np.ones(COUNT - 1, np.bool_),
        scale_sigma=0.01,
    )


def stamps_ns():
    return np.arange(COUNT, dtype=np.int64) * 500_000_000


def scene(seed=5):
    rng = np.random.default_rng(seed)
    truth = true_poses()
    points = [scan_points_m(pose, rng) for pose in truth]
    start = truth + rng.normal(0.0, 1.0, truth.shape) * [0.01, 0.01, 0.004]
    start[0] = truth[0]
    return truth, points, start, rng


def adjust(start, points, odometries=(), settings=SETTINGS, connected=None):
    connected = np.ones(len(start), np.bool_) if connected is None else connected
    steps = np.repeat(LOCAL[np.newaxis], len(start) - 1, axis=0)
    return adjust_to_surfaces(
        start, points, stamps_ns()[: len(start)], connected, steps, settings, odometries
    )


def off_m(poses, truth):
    """Distances after the rigid motion that brings both together best."""
    ours, true = poses[:, :2] - poses[:, :2].mean(axis=0), truth[:, :2] - truth[:, :2].mean(axis=0)
    u, _, vt = np.linalg.svd(ours.T @ true)
    return np.linalg.norm(ours @ u @ vt - true, axis=1)


def test_poses_come_to_millimetres_of_the_truth():
    truth, points, start, _ = scene()
    found = adjust(start, points)
    assert found.is_adjusted
    np.testing.assert_array_equal(found.poses_map_node[0], start[0])
    # 120 returns an axis with a deviation of about a centimetre leave one millimetre.
    assert off_m(start, truth).mean() > 0.01
    assert off_m(found.poses_map_node, truth).mean() < 0.002


def test_odometry_adds_to_what_the_scans_say_and_its_scale_is_found():
    truth, points, start, rng = scene()
    alone = adjust(start, points)
    track = odometry_of(truth, rng, sigma=(0.0005, 0.0005, 0.0003), scale=1.004)
    with_track = adjust(start, points, [track])
    ours = off_m(with_track.poses_map_node, truth).mean()
    assert ours < 0.8 * off_m(alone.poses_map_node, truth).mean()
    assert with_track.odometry_scales[0] == pytest.approx(1 / 1.004, abs=5e-4)
    # A step of the poses is scale times the measured one.
    assert with_track.odometry_factors[0] < 1.3


def test_an_odometry_that_claims_too_much_is_widened():
    truth, points, start, rng = scene()
    bold = odometry_of(truth, rng, sigma=(0.02, 0.02, 0.01), declared=0.05)
    found = adjust(start, points, [bold])
    assert found.odometry_factors[0] > 3.0
    assert off_m(found.poses_map_node, truth).mean() < 0.004


def test_a_slip_is_outweighed():
    truth, points, start, rng = scene()
    track = odometry_of(truth, rng)
    jumped = track.poses_odom_lidar.copy()
    jumped[20:, 0] += 0.3
    found = adjust(start, points, [replace(track, poses_odom_lidar=jumped)])
    assert off_m(found.poses_map_node, truth).max() < 0.01


def test_the_sides_of_a_panel_are_two_surfaces():
    truth, points, _, _ = scene()
    settings = SurfaceElementSettings()
    in_map_m = np.concatenate(
        [transform_planar_points(pose, own) for pose, own in zip(truth, points, strict=True)]
    )
    origins_m = np.repeat(truth[:, :2], [len(own) for own in points], axis=0)
    elements = find_surface_elements(in_map_m, settings)
    found = associate_returns(elements, in_map_m, origins_m, settings)
    on_panel = (np.abs(in_map_m[found.returns, 0] - 3.0) < 0.05) & (
        np.abs(in_map_m[found.returns, 1] - 2.0) < 0.5
    )
    from_left = origins_m[found.returns, 0] < 3.0
    left = set(found.sides[on_panel & from_left].tolist())
    right = set(found.sides[on_panel & ~from_left].tolist())
    assert left
    assert right
    assert not left & right
    # The noise is 0.4 % of the range.
    ranges_m = np.linalg.norm(in_map_m - origins_m, axis=1)[found.returns]
    far, near = ranges_m > 3.0, ranges_m < 1.0
    assert 2.0 < np.median(found.sigmas_m[far]) / np.median(found.sigmas_m[near]) < 7.0


def test_the_jacobian_is_that_of_differences():
    rng = np.random.default_rng(2)
    poses = rng.normal(0.0, 1.0, (4, 3))
    steps = _Steps(
        first=np.array([0, 1, 2]),
        second=np.array([1, 2, 3]),
        measured=rng.normal(0.0, 1.0, (3, 3)),
        information=np.repeat(np.eye(3)[np.newaxis], 3, axis=0),
        scale_sigma=0.01,
    )
    jacobian = _step_jacobian(steps, poses)
    for column in range(7):
        plus, minus, scale = poses.copy(), poses.copy(), np.zeros(2)
        numeric = np.zeros((3, 3))
        for row in range(3):
            plus, minus = poses.copy(), poses.copy()
            scale = np.ones(2)
            if column < 6:
                node = row + column // 3
                plus[node, column % 3] += 1e-6
                minus[node, column % 3] -= 1e-6
            else:
                scale = np.array([1.0 + 1e-6, 1.0 - 1e-6])
            numeric[row] = (
                steps.residuals(plus, scale[0])[row] - steps.residuals(minus, scale[1])[row]
            ) / 2e-6
        np.testing.assert_allclose(jacobian[:, :, column], numeric, atol=1e-7)


def test_along_a_corridor_the_graph_decides():
    rng = np.random.default_rng(3)
    truth = np.stack([np.linspace(0.0, 8.0, 40), np.zeros(40), np.zeros(40)], axis=1)
    x_m = np.linspace(-3.0, 3.0, 120)
    points = []
    for _ in truth:
        walls = [np.stack([x_m, np.full(120, y_m)], axis=1) for y_m in (-1.0, 1.0)]
        points.append(np.concatenate(walls) + rng.normal(0.0, 0.01, (240, 2)) * [0.0, 1.0])
    start = truth + rng.normal(0.0, 1.0, truth.shape) * [0.0, 0.01, 0.003]
    start[0] = truth[0]
    found = adjust(start, points).poses_map_node
    np.testing.assert_allclose(relative_pose(found[:-1], found[1:])[:, 0], 8.0 / 39, atol=2e-3)
    assert np.abs(found[:, 1]).max() < 0.01


def test_without_a_surface_nothing_moves():
    rng = np.random.default_rng(4)
    poses = rng.normal(0.0, 1.0, (5, 3))
    leaves = [rng.uniform(-9.0, 9.0, (30, 2)) for _ in poses]
    found = adjust(poses, leaves)
    assert not found.is_adjusted
    np.testing.assert_array_equal(found.poses_map_node, poses)


@pytest.mark.parametrize("settings", [{"rounds": 0}, {"keyframes_max": 10}])
def test_it_can_be_left_out(settings):
    _, points, start, _ = scene()
    found = adjust(start, points, settings=SurfaceAdjustmentSettings(**settings))
    assert not found.is_adjusted
    np.testing.assert_array_equal(found.poses_map_node, start)


def test_what_is_not_connected_stays():
    truth, points, start, _ = scene()
    connected = np.arange(COUNT) < 30
    found = adjust(start, points, connected=connected)
    np.testing.assert_array_equal(found.poses_map_node[30:], start[30:])
    assert off_m(found.poses_map_node[:30], truth[:30]).mean() < 0.003


def test_the_same_input_gives_the_same_bytes():
    truth, points, start, rng = scene()
    track = odometry_of(truth, rng)
    first, again = (adjust(start, points, [track]) for _ in range(2))
    assert first.poses_map_node.tobytes() == again.poses_map_node.tobytes()
