"""DLT against exact pairs, and its refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.calibration.features.dlt import pose_from_projection, solve_pose, solve_projection
from fusion_core.calibration.pose_error import pose_error
from fusion_core.lens.projection import project_points
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import invert_transform, make_transform, transform_points
from tests.calibration.textured_room import intrinsics

CAMERA = intrinsics(distortion=(-0.2, 0.05, 0.001, -0.0005, 0.0))


def pose(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return make_transform(Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3))


def points_before(T_camera_lidar: FloatArray, count: int, seed: int) -> FloatArray:
    """Points in the LiDAR's frame, in the field of view at 1 to 6 m."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1.0, 6.0, count)
    plane = rng.uniform((-0.5, -0.38), (0.5, 0.38), (count, 2))
    seen = np.concatenate([plane, np.ones((count, 1))], axis=1) * depth[:, np.newaxis]
    return transform_points(invert_transform(T_camera_lidar), seen)


@given(st.integers(0, 1000), st.integers(6, 40))
def test_exact_pairs_give_the_pose(seed: int, count: int) -> None:
    T = pose(seed)
    points = points_before(T, count, seed)
    pixels = project_points(transform_points(T, points), CAMERA)
    estimate, reprojects = solve_pose(points, pixels, CAMERA)
    # Six random pairs may be nearly degenerate.
    assert np.abs(pose_error(T, estimate)).max() < 1e-4
    assert np.linalg.det(estimate[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(
        project_points(transform_points(reprojects, points), CAMERA), pixels, atol=1e-3
    )


def test_the_matrix_fulfils_the_equations() -> None:
    T = pose(1)
    points = points_before(T, 30, 1)
    K = CAMERA.matrix
    seen = transform_points(T, points) @ K.T
    M = solve_projection(points, seen[:, :2] / seen[:, 2:])
    np.testing.assert_allclose(M, K @ T[:3], rtol=1e-6, atol=1e-6)


def test_a_matrix_of_any_scale_has_a_proper_rotation() -> None:
    K = CAMERA.matrix
    T = pose(2)
    noisy = 3.7 * (K @ T[:3]) * (1.0 + 0.01 * np.random.default_rng(0).normal(size=(3, 4)))
    estimate = pose_from_projection(noisy, K)
    np.testing.assert_allclose(estimate[:3, :3] @ estimate[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(estimate[:3, :3]) > 0.0
    np.testing.assert_allclose(pose_from_projection(K @ T[:3] * 3.7, K), T, atol=1e-9)


def test_five_pairs_do_not_suffice() -> None:
    T = pose(3)
    points = points_before(T, 5, 3)
    with pytest.raises(CalibrationFailed, match=r"5 pairs .* at least 6"):
        solve_pose(points, project_points(transform_points(T, points), CAMERA), CAMERA)


@pytest.mark.parametrize("noise_m", [0.0, 0.01])
def test_points_in_one_plane_are_refused_with_their_singular_values(noise_m: float) -> None:
    T = pose(4)
    points = points_before(T, 60, 4)
    normal = np.array([0.6, 0.0, 0.8])
    points -= np.outer(points @ normal, normal)
    points += np.random.default_rng(0).normal(scale=noise_m, size=points.shape)
    with pytest.raises(CalibrationFailed, match=r"one plane: their singular values are .* m\."):
        solve_projection(points, points[:, :2])
