"""Planar poses against (4, 4) transforms."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from fusion_core.model.geometry import (
    make_transform,
    planar_from_transform,
    rotation_from_yaw_pitch_roll,
    transform_from_planar,
)
from fusion_core.model.planar_poses import (
    compose_poses,
    invert_pose,
    pose_after,
    relative_pose,
    transform_planar_points,
    velocity_between,
)

poses = st.tuples(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0), st.floats(-3.1, 3.1)).map(
    np.array
)


def assert_same(found, expected):
    np.testing.assert_allclose(found[:2], expected[:2], atol=1e-9)
    assert abs(np.exp(1j * found[2]) - np.exp(1j * expected[2])) < 1e-9


@given(poses, poses)
def test_they_compose_as_transforms_do(a, b):
    T = transform_from_planar(a) @ transform_from_planar(b)
    assert_same(compose_poses(a, b), planar_from_transform(T))


def test_many_transforms_are_turns_about_the_vertical_and_moves():
    many = np.random.default_rng(2).normal(0.0, 2.0, (4, 5, 3))
    found = transform_from_planar(many)
    for pose, T in zip(many.reshape(-1, 3), found.reshape(-1, 4, 4), strict=True):
        rotation = rotation_from_yaw_pitch_roll(pose[2], 0.0, 0.0)
        np.testing.assert_array_equal(T, make_transform(rotation, np.append(pose[:2], 0.0)))


@given(poses)
def test_a_pose_and_its_inverse_cancel(a):
    assert_same(compose_poses(a, invert_pose(a)), np.zeros(3))
    assert_same(compose_poses(invert_pose(a), a), np.zeros(3))


@given(poses, poses)
def test_a_relative_pose_leads_from_one_to_the_other(a, b):
    assert_same(compose_poses(a, relative_pose(a, b)), b)


def test_many_poses_equal_each_alone():
    rng = np.random.default_rng(1)
    a, b = rng.normal(0.0, 2.0, (2, 20, 3))
    together = compose_poses(a, b)
    for pose_a, pose_b, found in zip(a, b, together, strict=True):
        np.testing.assert_array_equal(found, compose_poses(pose_a, pose_b))


@given(poses)
def test_points_move_as_by_the_transform(a):
    points_m = np.array([[1.0, 2.0], [-3.0, 0.5]])
    T = transform_from_planar(a)
    np.testing.assert_allclose(
        transform_planar_points(a, points_m), points_m @ T[:2, :2].T + T[:2, 3], atol=1e-9
    )


velocities = st.tuples(*[st.floats(-2.0, 2.0)] * 3).map(np.array)


@given(velocities, st.floats(-1.5, 1.5))
def test_a_constant_velocity_leads_where_the_matrix_exponential_does(velocity, seconds):
    x, y, turn = velocity * seconds
    T = expm(np.array([[0.0, -turn, x], [turn, 0.0, y], [0.0, 0.0, 0.0]]))
    expected = np.array([T[0, 2], T[1, 2], np.arctan2(T[1, 0], T[0, 0])])
    assert_same(pose_after(velocity, seconds), expected)


@given(velocities, st.floats(0.01, 1.5))
def test_the_velocity_between_two_poses_leads_from_one_to_the_other(velocity, seconds):
    found = velocity_between(pose_after(velocity, seconds), seconds)
    np.testing.assert_allclose(found, velocity, atol=1e-9)


@given(velocities, st.floats(-1.0, 1.0))
def test_velocities_of_many_lead_where_each_does(velocity, seconds):
    each = pose_after(np.stack([velocity, -velocity]), np.array([seconds, 0.5 * seconds]))
    assert_same(each[0], pose_after(velocity, seconds))
    assert_same(each[1], pose_after(-velocity, 0.5 * seconds))
