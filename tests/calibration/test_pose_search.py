"""The metric by which a pose moves points in the image."""

import numpy as np

from fusion_core.calibration.pose_error import apply_pose_error
from fusion_core.calibration.refinement.guess_uncertainty import jackknife_covariance, risk_of_worse
from fusion_core.calibration.refinement.pose_search import bearing_metric, step_basis
from fusion_core.model.geometry import transform_points
from tests.calibration.textured_street import T_CAMERA_LIDAR


def test_the_metric_is_the_mean_square_of_the_moves_in_the_image():
    rng = np.random.default_rng(7)
    points = rng.uniform([4.0, -3.0, -2.0], [20.0, 3.0, 2.0], (200, 3))
    metric = bearing_metric(points, T_CAMERA_LIDAR)

    def places(T):
        moved = transform_points(T, points)
        return moved[:, :2] / moved[:, 2:]

    for _ in range(5):
        error = 1e-5 * rng.normal(size=6)
        moves = places(apply_pose_error(T_CAMERA_LIDAR, error)) - places(T_CAMERA_LIDAR)
        expected = np.square(moves).sum(axis=1).mean()
        np.testing.assert_allclose(error @ metric @ error, expected, rtol=1e-3)


def test_steps_of_the_basis_move_the_image_or_use_up_the_prior():
    metric, precision = np.diag([4.0, 1.0, 1.0, 1e-2, 1e-2, 1e-9]), np.diag([1e4] * 3 + [400.0] * 3)
    basis = step_basis(metric, precision, 0.01)
    np.testing.assert_allclose(basis.T @ (metric / 1e-4 + precision) @ basis, np.eye(6), atol=1e-9)


def test_the_risk_agrees_with_draws():
    rng = np.random.default_rng(8)
    for _ in range(5):
        half = rng.normal(size=(6, 6))
        covariance, metric = half @ half.T, np.diag(rng.random(6))
        mean, moved = rng.normal(size=6), rng.normal(size=6)
        truth = rng.multivariate_normal(mean, covariance, 40_000)
        to_result = np.einsum("ni,ij,nj->n", truth - moved, metric, truth - moved)
        to_guess = np.einsum("ni,ij,nj->n", truth, metric, truth)
        drawn = (to_result > to_guess).mean()
        assert abs(risk_of_worse(moved, mean, covariance, metric) - drawn) < 0.01


def test_a_pose_that_does_not_move_is_not_worse():
    assert risk_of_worse(np.zeros(6), np.ones(6), np.eye(6), np.eye(6)) == 0.0


def test_the_jackknife_of_a_mean_is_its_variance():
    values = np.random.default_rng(9).normal(size=(12, 6))
    without = np.array([np.delete(values, i, axis=0).mean(axis=0) for i in range(12)])
    expected = np.cov(values.T) / 12
    np.testing.assert_allclose(jackknife_covariance(without), expected, atol=1e-12)
