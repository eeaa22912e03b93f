"""The optimum of a pose graph, against a general solver."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from fusion_core.model.planar_poses import compose_poses, invert_pose, relative_pose
from fusion_core.slam.pose_graph import Edge, optimise, residuals


def ring(seed=1, count=8):
    """Poses on a ring, noisy steps round it, and loops across."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(count) / count
    truth = np.stack([np.cos(angle), np.sin(angle), angle + 0.5 * np.pi], axis=1) * [3.0, 3.0, 1.0]
    pairs = [(i, i + 1, False) for i in range(count - 1)]
    pairs += [(0, count - 1, True), (1, 5, True), (2, 6, True)]
    edges = []
    for first, second, is_loop in pairs:
        root = rng.normal(0.0, 3.0, (3, 3))
        edges.append(
            Edge(
                first=first,
                second=second,
                pose_first_second=compose_poses(
                    relative_pose(truth[first], truth[second]), rng.normal(0.0, 0.05, 3)
                ),
                information=root @ root.T + np.diag([50.0, 40.0, 90.0]),
                is_loop=is_loop,
            )
        )
    return compose_poses(truth, rng.normal(0.0, 0.1, truth.shape)), edges


def logarithm(pose):
    """(3,) the twist of a planar pose: the translation is V times the twist's."""
    angle = pose[2]
    a, b = np.sinc(angle / np.pi), np.sin(angle / 2.0) * np.sinc(angle / (2.0 * np.pi))
    return np.array([*np.linalg.solve([[a, -b], [b, a]], pose[:2]), angle])


def by_scipy(start, edges, robust_scale):
    def errors(free):
        poses = np.concatenate([start[:1], free.reshape(-1, 3)])
        rows = []
        for edge in edges:
            found = compose_poses(invert_pose(poses[edge.first]), poses[edge.second])
            away = logarithm(compose_poses(invert_pose(edge.pose_first_second), found))
            whitened = np.linalg.cholesky(edge.information).T @ away
            if edge.is_loop and robust_scale is not None:
                squared = robust_scale**2 * np.log1p((whitened @ whitened) / robust_scale**2)
                whitened = whitened * np.sqrt(squared / (whitened @ whitened))
            rows.append(whitened)
        return np.concatenate(rows)

    best = least_squares(errors, start[1:].ravel(), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    return np.concatenate([start[:1], best.x.reshape(-1, 3)])


@pytest.mark.parametrize("robust_scale", [None, 1.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_optimum_is_that_of_a_general_solver(seed, robust_scale):
    start, edges = ring(seed)
    found, expected = optimise(start, edges, robust_scale), by_scipy(start, edges, robust_scale)
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=2e-3)
    np.testing.assert_allclose(np.exp(1j * found[:, 2]), np.exp(1j * expected[:, 2]), atol=2e-3)


def test_a_wrong_loop_is_overruled():
    start, edges = ring()
    wrong = Edge(
        first=3,
        second=7,
        pose_first_second=np.array([4.0, -2.0, 1.0]),
        information=np.diag([2500.0, 2500.0, 10000.0]),
        is_loop=True,
    )
    right = optimise(start, edges, 1.0)
    robust = np.abs(optimise(start, [*edges, wrong], 1.0) - right)[:, :2].max()
    squared = np.abs(optimise(start, [*edges, wrong], None) - right)[:, :2].max()
    assert robust < 0.05
    assert squared > 1.0


def test_the_first_pose_stays():
    start, edges = ring()
    np.testing.assert_allclose(optimise(start, edges, 1.0)[0, :2], start[0, :2], atol=1e-6)


def test_residuals_are_the_deviations_of_edges_from_the_poses():
    poses = np.array([[1.0, 2.0, 0.5 * np.pi], [1.0, 4.0, np.pi]])
    edge = Edge(
        first=0,
        second=1,
        pose_first_second=np.array([1.5, 0.0, 0.5 * np.pi]),
        information=np.eye(3),
        is_loop=False,
    )
    # The second is 2 m ahead of the first; half a metre more, to the right of its own heading.
    np.testing.assert_allclose(residuals(poses, [edge]), [[0.0, -0.5, 0.0]], atol=1e-12)
    assert residuals(poses, []).shape == (0, 3)
