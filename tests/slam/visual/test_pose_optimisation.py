"""Motion-only adjustment against scipy's least squares on the same residuals."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import least_squares

from fusion_core.model.geometry import invert_transform, make_transform, transform_points
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.pose_optimisation import exp_se3, optimise_pose, orthonormalise

CAMERA = np.array([525.0, 520.0, 319.5, 239.5])
DEPTH_SIGMA = 0.003


def pose_of(x):
    return make_transform(np.asarray(cv2.Rodrigues(np.asarray(x[:3]))[0], float), np.asarray(x[3:]))


def scene(rng, count=200, pixel_sigma=1.0):
    """Points, and what a camera at a pose sees of them; a fifth without depth."""
    x_true = np.array([0.1, -0.2, 0.05, 0.3, -0.1, 0.2])
    T = pose_of(x_true)
    uv = rng.uniform([0, 0], [640, 480], (count, 2))
    z = rng.uniform(1.0, 5.0, count)
    in_camera = np.column_stack([(uv - CAMERA[2:]) / CAMERA[:2] * z[:, None], z])
    points = transform_points(invert_transform(T), in_camera)
    pixels = uv + rng.normal(0.0, pixel_sigma, uv.shape)
    depths = 1.0 / (1.0 / z + rng.normal(0.0, DEPTH_SIGMA, count))
    depths[rng.uniform(size=count) < 0.2] = np.nan
    return T, points, pixels, depths


def residuals(T, points, pixels, depths, sigmas):
    p = transform_points(T, points)
    uv = p[:, :2] / p[:, 2:] * CAMERA[:2] + CAMERA[2:]
    inverse = np.nan_to_num((1.0 / p[:, 2] - 1.0 / depths) / DEPTH_SIGMA)
    return np.concatenate([((uv - pixels) / sigmas[:, None]).ravel(), inverse])


@pytest.mark.parametrize("seed", range(3))
def test_it_is_scipys_optimum(seed):
    rng = np.random.default_rng(seed)
    T, points, pixels, depths = scene(rng, pixel_sigma=0.3)
    # Nothing exceeds the threshold of an outlier, so that both minimise plain squares.
    sigmas = np.ones(len(points))
    start = exp_se3(np.array([0.02, -0.02, 0.01, 0.05, 0.05, -0.05])) @ T
    fit = optimise_pose(start, points, pixels, depths, sigmas, DEPTH_SIGMA, CAMERA)
    kept = fit.is_inlier
    assert kept.sum() > 0.97 * len(points)
    best = least_squares(
        lambda x: residuals(pose_of(x), points[kept], pixels[kept], depths[kept], sigmas[kept]),
        np.zeros(6),
        xtol=1e-14,
        ftol=1e-14,
        gtol=1e-14,
    )
    np.testing.assert_allclose(fit.T_camera_map, pose_of(best.x), atol=2e-6)
    # The information is J'J of a motion from the left; scipy's J is of another parameter.
    step = 1e-6
    columns = []
    for axis in np.eye(6):
        ahead, behind = (
            residuals(
                expm(sign * step * twist(axis)) @ fit.T_camera_map,
                points[kept], pixels[kept], depths[kept], sigmas[kept],
            )
            for sign in (1, -1)
        )  # fmt: skip
        columns.append((ahead - behind) / (2 * step))
    J = np.stack(columns, axis=1)
    np.testing.assert_allclose(fit.information, J.T @ J, rtol=1e-3, atol=1e-3 * (J.T @ J).max())


def twist(xi):
    wx, wy, wz = xi[:3]
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = [[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]]
    matrix[:3, 3] = xi[3:]
    return matrix


@given(st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6))
def test_the_exponential_map_is_the_matrix_exponential(xi):
    T = exp_se3(np.array(xi))
    np.testing.assert_allclose(T, expm(twist(xi)), atol=1e-9)
    np.testing.assert_allclose(exp_se3(-np.array(xi)) @ T, np.eye(4), atol=1e-9)


def test_a_third_of_gross_outliers_does_not_move_it():
    rng = np.random.default_rng(5)
    T, points, pixels, depths = scene(rng)
    wrong = rng.uniform(size=len(points)) < 0.33
    pixels[wrong] += rng.uniform(30.0, 80.0, (wrong.sum(), 2))
    start = exp_se3(np.array([0.01, 0.01, 0.0, 0.02, 0.0, 0.02])) @ T
    fit = optimise_pose(start, points, pixels, depths, np.ones(len(points)), DEPTH_SIGMA, CAMERA)
    off = invert_transform(T) @ fit.T_camera_map
    assert np.linalg.norm(off[:3, 3]) < 0.01
    assert not fit.is_inlier[wrong].any()
    assert fit.is_inlier[~wrong].mean() > 0.9


def test_depth_weighs_by_its_square():
    """At 1 m a depth says more of the distance than the pixels do, at 8 m less."""
    noise = ObservationNoise(depth_sigma_per_m2=DEPTH_SIGMA)
    sigmas_m = [noise.depth_sigma_per_m2 * z**2 for z in (1.0, 8.0)]
    for z, sigma_m in zip((1.0, 8.0), sigmas_m, strict=True):
        # One point on the axis: nothing but its depth says how far it is.
        points = np.array([[0.0, 0.0, z]] * 3)
        fit = optimise_pose(
            np.eye(4), points, np.tile(CAMERA[2:], (3, 1)), np.full(3, z), np.ones(3),
            noise.depth_sigma_per_m2, CAMERA,
        )  # fmt: skip
        assert fit.information[5, 5] == pytest.approx(3.0 / sigma_m**2, rel=1e-6)


def test_a_rotation_stays_one():
    rng = np.random.default_rng(1)
    T = pose_of(rng.normal(size=6)) + np.pad(rng.normal(0.0, 1e-3, (3, 3)), ((0, 1), (0, 1)))
    orthonormalise(T)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


def test_too_few_points_leave_the_start():
    start = pose_of([0.1, 0.0, 0.0, 1.0, 2.0, 3.0])
    none = np.empty((0, 3))
    fit = optimise_pose(start, none, none[:, :2], none[:, 0], none[:, 0], DEPTH_SIGMA, CAMERA)
    np.testing.assert_array_equal(fit.T_camera_map, start)
