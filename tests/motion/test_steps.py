"""Planar steps against matrices."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.geometry import (
    invert_transform,
    planar_from_transform,
    transform_from_planar,
)
from fusion_core.model.planar_poses import compose_poses, relative_pose
from fusion_core.motion.steps import (
    integrate_steps,
    rotate_covariance,
    steps_between,
    subtract_poses,
)

metres = st.floats(-100.0, 100.0)
radians = st.floats(-7.0, 7.0)
poses = st.tuples(metres, metres, radians).map(np.array)


def same(first: FloatArray, second: FloatArray) -> None:
    np.testing.assert_allclose(first[:2], second[:2], atol=1e-9)
    assert abs(wrap_angle(first[2] - second[2])) < 1e-9


@given(poses, poses)
def test_compose_and_relative_are_those_of_matrices(first: FloatArray, second: FloatArray) -> None:
    T_first, T_second = transform_from_planar(first), transform_from_planar(second)
    same(compose_poses(first, second), planar_from_transform(T_first @ T_second))
    same(relative_pose(first, second), planar_from_transform(invert_transform(T_first) @ T_second))
    same(compose_poses(first, relative_pose(first, second)), second)


@given(poses, st.lists(poses, min_size=0, max_size=8))
def test_a_chain_is_step_after_step(start: FloatArray, steps: list[FloatArray]) -> None:
    chain = integrate_steps(np.array(steps).reshape(-1, 3), start)
    pose = np.array([start[0], start[1], wrap_angle(start[2])])
    for k, step in enumerate(steps):
        same(chain[k], pose)
        pose = compose_poses(pose, step)
    same(chain[-1], pose)
    for made, step in zip(steps_between(chain), steps, strict=True):
        same(made, step)


def test_a_difference_of_yaws_is_wrapped() -> None:
    away = subtract_poses(np.array([1.0, 2.0, 3.1]), np.array([0.5, 2.5, -3.1]))
    np.testing.assert_allclose(away, [0.5, -0.5, 6.2 - 2.0 * np.pi], atol=1e-12)


@pytest.mark.parametrize("yaw_rad", [0.3, -2.0])
def test_a_covariance_in_other_axes_is_that_of_the_samples(yaw_rad: float) -> None:
    random = np.random.default_rng(0)
    errors = random.normal(0.0, [1.0, 0.1, 0.02], (1000, 3))
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turned = np.stack(
        [c * errors[:, 0] + s * errors[:, 1], c * errors[:, 1] - s * errors[:, 0], errors[:, 2]],
        axis=1,
    )
    np.testing.assert_allclose(
        rotate_covariance(yaw_rad, np.cov(errors.T)), np.cov(turned.T), atol=1e-12
    )
