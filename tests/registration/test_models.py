"""The four least-squares fits against closed forms, other libraries and numeric derivatives."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from skimage.transform import EuclideanTransform, SimilarityTransform

from fusion_core.registration.models import (
    MODELS,
    SINGULAR_CONDITION,
    apply_transform,
    fit_transform,
    point_covariance,
    point_jacobian,
    residuals,
    solve_least_squares,
)


def true_map(model, turn_rad=0.12, x_m=0.05, z_m=-0.03):
    """A map of the given model that is none of a simpler one."""
    scale = 1.0 if model == "rigid" else 1.06
    cosine, sine = scale * np.cos(turn_rad), scale * np.sin(turn_rad)
    A = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [x_m, z_m, 1.0]])
    if model in ("affine", "homography"):
        A[:2, :2] = A[:2, :2] @ np.array([[1.05, 0.02], [0.0, 0.97]])
    if model == "homography":
        A[:2, 2] = 0.015, 0.02
    return A


def points(seed, count=40):
    return np.random.default_rng(seed).uniform([-2.0, 1.0], [2.0, 5.0], size=(count, 2))


def same_map(A, B):
    return np.allclose(A / A[2, 2], B / B[2, 2], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("model", MODELS)
@given(
    turn_rad=st.floats(-3.0, 3.0),
    x_m=st.floats(-1.0, 1.0),
    z_m=st.floats(-0.5, 0.5),
    seed=st.integers(0, 1000),
)
def test_exact_pairs_give_the_map_back(model, turn_rad, x_m, z_m, seed):
    A = true_map(model, turn_rad, x_m, z_m)
    lidar = points(seed, 12)
    depth = apply_transform(A, lidar)
    assert same_map(fit_transform(model, lidar, depth).A, A)
    assert np.nanmax(residuals(fit_transform(model, lidar, depth).A, lidar, depth)) < 1e-9
    assert np.nanmax(residuals(solve_least_squares(model, lidar, depth), lidar, depth)) < 1e-6


@pytest.mark.parametrize("model", MODELS)
def test_a_stack_of_samples_equals_one_sample_at_a_time(model):
    rng = np.random.default_rng(3)
    lidar, depth = rng.normal(size=(2, 30, 6, 2))
    stacked = solve_least_squares(model, lidar, depth)
    for i in range(30):
        np.testing.assert_allclose(
            stacked[i], solve_least_squares(model, lidar[i], depth[i]), rtol=1e-7, atol=1e-9
        )


@pytest.mark.parametrize("model", MODELS)
def test_residuals_equal_a_loop(model):
    A = np.stack([true_map(model, turn) for turn in (0.0, 0.4, -0.2)])
    lidar, depth = points(1, 7), points(2, 7)
    expected = np.empty((3, 7))
    for k in range(3):
        for i in range(7):
            x, z, w = np.array([*lidar[i], 1.0]) @ A[k]
            expected[k, i] = np.hypot(x / w - depth[i, 0], z / w - depth[i, 1])
    np.testing.assert_allclose(residuals(A, lidar, depth), expected, rtol=1e-12)


def noisy_pairs(model, seed, sigma_m=0.02, count=60):
    rng = np.random.default_rng(seed)
    lidar = points(seed, count)
    return lidar, apply_transform(true_map(model), lidar) + rng.normal(0.0, sigma_m, (count, 2))


@pytest.mark.parametrize("seed", range(5))
def test_rigid_and_similarity_equal_umeyama_of_scikit_image(seed):
    lidar, depth = noisy_pairs("similarity", seed)
    for model, oracle in (("rigid", EuclideanTransform), ("similarity", SimilarityTransform)):
        expected = oracle.from_estimate(lidar, depth).params.T
        np.testing.assert_allclose(fit_transform(model, lidar, depth).A, expected, atol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_affine_equals_lstsq_of_equation_5(seed):
    lidar, depth = noisy_pairs("affine", seed)
    ones = np.ones((len(lidar), 1))
    expected = np.linalg.lstsq(np.hstack([lidar, ones]), np.hstack([depth, ones]), rcond=None)[0]
    np.testing.assert_allclose(fit_transform("affine", lidar, depth).A, expected, atol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_homography_is_no_worse_than_opencv(seed):
    lidar, depth = noisy_pairs("homography", seed)
    oracle = cv2.findHomography(lidar, depth, 0)[0].T
    oracle = oracle / (np.array([*lidar.mean(0), 1.0]) @ oracle)[2]
    ours = fit_transform("homography", lidar, depth).A
    np.testing.assert_allclose(ours, oracle, atol=1e-3)
    assert np.sum(residuals(ours, lidar, depth) ** 2) <= np.sum(
        residuals(oracle, lidar, depth) ** 2
    ) * (1.0 + 1e-9)


@pytest.mark.parametrize("model", MODELS)
@given(turn_rad=st.floats(-3.0, 3.0), x_m=st.floats(-3, 3), z_m=st.floats(-3, 3))
def test_a_rigid_motion_of_the_depth_points_moves_the_map(model, turn_rad, x_m, z_m):
    lidar, depth = noisy_pairs(model, 11)
    motion = true_map("rigid", turn_rad, x_m, z_m)
    moved = fit_transform(model, lidar, apply_transform(motion, depth)).A
    np.testing.assert_allclose(moved, fit_transform(model, lidar, depth).A @ motion, atol=1e-6)


@given(seed=st.integers(0, 1000), turn_rad=st.floats(-3.0, 3.0))
def test_swapping_the_sides_inverts_a_rigid_map(seed, turn_rad):
    rng = np.random.default_rng(seed)
    lidar = points(seed)
    depth = apply_transform(true_map("rigid", turn_rad), lidar) + rng.normal(0.0, 0.05, lidar.shape)
    there, back = fit_transform("rigid", lidar, depth).A, fit_transform("rigid", depth, lidar).A
    np.testing.assert_allclose(there @ back, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("model", ["rigid", "similarity"])
def test_a_mirrored_curve_is_answered_by_a_rotation(model):
    lidar = points(5)
    mirrored = lidar * [-1.0, 1.0]
    assert np.linalg.det(fit_transform(model, lidar, mirrored).A) > 0.0


@pytest.mark.parametrize("model", MODELS)
def test_points_that_coincide_determine_nothing(model):
    same = np.tile([1.0, 2.0], (8, 1))
    undetermined = fit_transform(model, same, points(0, 8))
    assert undetermined.condition == np.inf
    assert np.isnan(undetermined.A).all()


@pytest.mark.parametrize("model", ["affine", "homography"])
def test_points_on_a_line_determine_no_rich_map(model):
    line = np.stack([np.linspace(-2.0, 2.0, 20), np.full(20, 3.0)], axis=1)
    depth = apply_transform(true_map("rigid"), line)
    assert fit_transform(model, line, depth).condition >= SINGULAR_CONDITION
    assert same_map(fit_transform("rigid", line, depth).A, true_map("rigid"))


@pytest.mark.parametrize("model", MODELS)
def test_one_undetermined_sample_leaves_the_rest_of_the_stack_alone(model):
    lidar = np.stack([points(0, 6), np.tile([1.0, 2.0], (6, 1)), points(1, 6)])
    depth = np.stack([points(2, 6)] * 3)
    stacked = solve_least_squares(model, lidar, depth)
    for i in (0, 2):
        np.testing.assert_allclose(
            stacked[i], solve_least_squares(model, lidar[i], depth[i]), rtol=1e-7, atol=1e-9
        )


@pytest.mark.parametrize("model", MODELS)
def test_derivatives_equal_numeric_ones(model):
    A = true_map(model)
    covariance = np.cov(np.random.default_rng(0).normal(size=(9, 40)))
    for point in points(4, 5):
        by_point = approx_fprime(point, lambda p: apply_transform(A, p[None])[0], 1e-7)
        np.testing.assert_allclose(point_jacobian(A, point[None])[0], by_point.T, atol=1e-5)

        by_entry = approx_fprime(
            A.ravel(), lambda a, p=point: apply_transform(a.reshape(3, 3), p[None])[0], 1e-7
        )
        np.testing.assert_allclose(
            point_covariance(A, covariance, point[None])[0],
            by_entry @ covariance @ by_entry.T,
            rtol=1e-4,
        )


def test_a_point_beyond_the_horizon_has_no_image():
    A = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    image = apply_transform(A, np.array([[0.3, 1.0], [0.3, 2.0], [0.3, 5.0]]))
    np.testing.assert_allclose(image[0], [0.6, 2.0])
    assert np.isnan(image[1:]).all()
    assert np.isnan(residuals(A, np.array([[0.3, 5.0]]), np.zeros((1, 2)))).all()
