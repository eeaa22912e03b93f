"""The optimum of a graph of poses in space, against a general solver; and how drift grows."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fusion_core.model.geometry import invert_transform
from fusion_core.slam.visual.drift import (
    DriftSettings,
    drift_covariance,
    shortest_path,
    small_motion_between,
)
from fusion_core.slam.visual.essential_graph import (
    PoseEdge,
    connected_parts,
    essential_edges,
    loop_chi2,
    optimise_poses,
)
from fusion_core.slam.visual.loop_closing import LoopCloser
from fusion_core.slam.visual.relative_pose_refinement import small_motion
from tests.slam.visual.feature_world import INTRINSICS, DriftingTracker, hall, round_trip


def twist_matrix(xi):
    w, v = xi[:3], xi[3:]
    result = np.zeros((4, 4))
    result[:3, :3] = [[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]]
    result[:3, 3] = v
    return result


def logarithm(T):
    """(6,) the twist of a motion (Barfoot 2017, eqs. 7.85, 7.86): the translation is J times its
    second half."""
    w = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    angle = np.linalg.norm(w)
    W = twist_matrix(np.append(w, np.zeros(3)))[:3, :3]
    J = np.eye(3) + (1.0 - np.cos(angle)) / angle**2 * W
    J += (angle - np.sin(angle)) / angle**3 * W @ W
    return np.append(w, np.linalg.solve(J, T[:3, 3]))


def ring(seed, count=6):
    rng = np.random.default_rng(seed)
    truth = [np.eye(4)]
    for _ in range(count - 1):
        truth.append(truth[-1] @ small_motion(rng.normal(0.0, 0.5, 6)))
    pairs = [(i, i + 1, False) for i in range(count - 1)]
    pairs += [(0, count - 1, True), (1, 4, True)]
    edges = []
    for first, second, is_loop in pairs:
        root = rng.normal(0.0, 0.03, (6, 6))
        T = invert_transform(truth[first]) @ truth[second] @ small_motion(rng.normal(0.0, 0.05, 6))
        covariance = root @ root.T + 1e-3 * np.eye(6)
        edges.append(
            PoseEdge(
                first=first,
                second=second,
                T_first_second=T,
                covariance=covariance,
                is_loop=is_loop,
            )
        )
    start = np.array([T @ small_motion(rng.normal(0.0, 0.1, 6)) for T in truth])
    return start, edges


def moved(start, free):
    steps = [np.eye(4), *(expm(twist_matrix(xi)) for xi in free.reshape(-1, 6))]
    return [T @ step for T, step in zip(start, steps, strict=True)]


def by_scipy(start, edges, robust_scale):
    # Once for all evaluations of the errors, of which there are thousands.
    whitening = [np.linalg.inv(np.linalg.cholesky(edge.covariance)) for edge in edges]
    measured = [np.linalg.inv(edge.T_first_second) for edge in edges]

    def errors(free):
        poses = moved(start, free)
        rows = []
        back = np.linalg.inv(poses)
        for edge, W, T_second_first in zip(edges, whitening, measured, strict=True):
            found = back[edge.first] @ poses[edge.second]
            whitened = W @ logarithm(T_second_first @ found)
            if edge.is_loop and robust_scale is not None:
                squared = robust_scale**2 * np.log1p((whitened @ whitened) / robust_scale**2)
                whitened = whitened * np.sqrt(squared / (whitened @ whitened))
            rows.append(whitened)
        return np.concatenate(rows)

    best = least_squares(errors, np.zeros(6 * (len(start) - 1)), xtol=1e-12, ftol=1e-12)
    return moved(start, best.x)


@pytest.mark.parametrize("robust_scale", [None, 1.0])
def test_the_optimum_is_that_of_a_general_solver(robust_scale):
    start, edges = ring(1)
    found = optimise_poses(start, edges, robust_scale)
    np.testing.assert_allclose(found, by_scipy(start, edges, robust_scale), atol=2e-3)


def test_each_part_keeps_its_first_pose():
    start, edges = ring(2)
    doubled = np.concatenate([start, start])
    count = len(start)
    others = [
        PoseEdge(
            first=edge.first + count,
            second=edge.second + count,
            T_first_second=edge.T_first_second,
            covariance=edge.covariance,
            is_loop=edge.is_loop,
        )
        for edge in edges
    ]
    found = optimise_poses(doubled, [*edges, *others], None)
    np.testing.assert_allclose(found[:count], found[count:], atol=1e-5)
    np.testing.assert_allclose(found[0], start[0], atol=1e-6)


def test_a_wrong_loop_is_overruled_by_the_kernel():
    start, edges = ring(3)
    right = optimise_poses(start, edges, None)
    wrong = PoseEdge(
        first=0,
        second=3,
        T_first_second=right[3] @ small_motion(np.array([0.0, 0.5, 0.0, 3.0, -2.0, 0.0])),
        covariance=1e-3 * np.eye(6),
        is_loop=True,
    )
    robust = optimise_poses(right, [*edges, wrong], 3.0)
    assert np.abs(robust - right)[:, :3, 3].max() < 0.1
    assert loop_chi2(robust, wrong) > 100.0


def test_drift_is_what_random_steps_give():
    """Steps whose variances are the declared ones, drawn; their sum has the covariance."""
    settings = DriftSettings(translation_m_per_m=0.02, rotation_rad_per_m=0.01, turn_m_per_rad=0.0)
    rng = np.random.default_rng(4)
    poses = [np.eye(4)]
    for _ in range(12):
        poses.append(poses[-1] @ small_motion(np.array([0.0, 0.15, 0.02, 0.1, 0.0, 0.3])))
    poses = np.array(poses)
    steps = invert_each(poses[:-1]) @ poses[1:]
    lengths = np.linalg.norm(steps[:, :3, 3], axis=1)
    sigmas = np.sqrt(lengths * lengths.sum())[:, np.newaxis] * np.repeat([0.01, 0.02], 3)
    drawn = []
    for _ in range(1500):
        T = np.eye(4)
        for step, sigma in zip(steps, sigmas, strict=True):
            T = T @ step @ small_motion(rng.normal(0.0, sigma))
        drawn.append(small_motion_between(poses[-1], T))
    expected = drift_covariance(poses, settings)
    found = np.cov(np.array(drawn).T)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.1)


def invert_each(T):
    return np.array([invert_transform(one) for one in T])


def test_a_straight_path_drifts_by_the_declared_part_of_it():
    settings = DriftSettings()
    poses = np.array([small_motion(np.array([0, 0, 0, 0, 0, s])) for s in np.linspace(0, 20, 41)])
    sigma = np.sqrt(np.diag(drift_covariance(poses, settings)))
    assert sigma[5] == pytest.approx(20.0 * settings.translation_m_per_m)
    np.testing.assert_allclose(sigma[:3], 20.0 * settings.rotation_rad_per_m)
    # Turned early, it is off to the side by the angle times what is left of the path.
    aside = 20.0**2 * settings.rotation_rad_per_m / np.sqrt(3.0)
    assert sigma[3] == pytest.approx(np.hypot(aside, sigma[5]), rel=0.05)


def test_the_path_of_least_drift_is_taken():
    poses = np.array([small_motion(np.array([0, 0, 0, 0, 0, s])) for s in (0.0, 5.0, 1.0, 2.0)])
    pairs = [(0, 1), (1, 3), (0, 2), (2, 3)]
    assert shortest_path(poses, pairs, 0, 3, DriftSettings()) == [0, 2, 3]
    assert shortest_path(poses, pairs[:1], 0, 3, DriftSettings()) is None
    assert connected_parts(4, pairs[:1]).tolist() == [0, 0, 1, 2]


def test_the_edges_of_a_map_hold_at_its_own_poses():
    tracker = DriftingTracker(hall(), 1, drift=[0.0, 0.002, 0.0, 0.0, 0.0, 0.0])
    closer = LoopCloser(tracker.map, INTRINSICS)
    for pose in round_trip(count=16, turns=0.3):
        closer.add(tracker.add(pose))
    tracker.map.cull_keyframe(7)
    edges = essential_edges(tracker.map, [(2, 4), (6, 7)], DriftSettings(), 10.0)
    pairs = {(edge.first, edge.second) for edge in edges}
    assert {(0, 1), (2, 4), (6, 8)} <= pairs
    assert all(7 not in pair for pair in pairs)
    poses = np.array([tracker.map.pose_of(i) for i in range(16)])
    assert max(loop_chi2(poses, edge) for edge in edges) < 1e-9
