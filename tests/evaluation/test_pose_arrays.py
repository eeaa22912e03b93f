"""Arrays of poses against the same operation of the model on one pose."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.evaluation.pose_arrays import (
    interpolate_poses,
    invert_poses,
    project_to_plane,
    relative_poses,
    rotation_angles_rad,
    translation_norms_m,
)
from fusion_core.model.geometry import (
    invert_transform,
    planar_from_transform,
    transform_from_planar,
)
from fusion_core.model.trajectory import Trajectory
from tests.evaluation.random_poses import random_transforms, random_walk

START_NS = 1_700_000_000_000_000_001


@given(st.integers(0, 2**32 - 1))
def test_relative_and_inverse_agree_with_one_pose_at_a_time(seed: int) -> None:
    first, second = random_transforms(5, seed), random_transforms(5, seed + 1)
    assert np.allclose(invert_poses(first), [invert_transform(pose) for pose in first])
    one_by_one = [invert_transform(a) @ b for a, b in zip(first, second, strict=True)]
    assert np.allclose(relative_poses(first, second), one_by_one)


def test_a_relative_pose_far_from_the_origin_keeps_its_digits() -> None:
    first = random_transforms(50, seed=1)
    first[:, :3, 3] += 5e6
    second = first.copy()
    second[:, 0, 3] += 0.5
    assert np.abs(translation_norms_m(relative_poses(first, second)) - 0.5).max() < 1e-12


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 0.3, 3.0, np.pi])
def test_sizes(angle_rad: float) -> None:
    poses = np.stack([transform_from_planar(np.array([3.0, -4.0, angle_rad]))] * 2)
    assert rotation_angles_rad(poses) == pytest.approx([angle_rad] * 2, abs=1e-15)
    assert translation_norms_m(poses) == pytest.approx([5.0, 5.0])


@given(st.integers(0, 2**32 - 1))
def test_planar_drops_height_pitch_and_roll(seed: int) -> None:
    poses = random_transforms(5, seed)
    expected = [transform_from_planar(planar_from_transform(pose)) for pose in poses]
    assert np.allclose(project_to_plane(poses), expected)


@given(
    st.lists(st.integers(0, 1000), min_size=1, max_size=6, unique=True),
    st.lists(st.integers(-10, 1010), min_size=1, max_size=8),
)
def test_poses_are_those_of_the_trajectory_one_by_one(own: list[int], query: list[int]) -> None:
    trajectory = random_walk(START_NS + np.array(sorted(own), dtype=np.int64), seed=len(own))
    stamps_ns = START_NS + np.array(query, dtype=np.int64)
    poses, known = interpolate_poses(trajectory, stamps_ns)
    assert known.tolist() == [min(own) <= stamp <= max(own) for stamp in query]
    expected = [trajectory.pose_at(int(stamp_ns)) for stamp_ns in stamps_ns[known]]
    assert poses.shape == (known.sum(), 4, 4)
    assert np.allclose(poses, np.reshape(expected, (-1, 4, 4)))


def test_within_a_long_gap_only_recorded_stamps_are_known() -> None:
    trajectory = Trajectory.from_planar(np.array([0, 10, 30, 40]), np.zeros((4, 3)))
    stamps_ns = np.array([30, 29, 5, 11, 0, 35, 40, 41, 10])
    _, known = interpolate_poses(trajectory, stamps_ns, max_gap_ns=10)
    assert stamps_ns[known].tolist() == [30, 5, 0, 35, 40, 10]
    _, known = interpolate_poses(trajectory, stamps_ns, max_gap_ns=9)
    assert stamps_ns[known].tolist() == [30, 0, 40, 10]
