"""Rotations between two samples, against scipy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from fusion_core.model.geometry import rotation_from_quaternion
from fusion_core.model.interpolation import interpolate_transform, quaternion_from_rotation, slerp

seeds = st.integers(0, 2**32 - 1)
fractions = st.floats(0.0, 1.0)


def random_rotation(seed: int) -> Rotation:
    return Rotation.random(rng=np.random.default_rng(seed))


@given(seeds)
def test_quaternion_and_rotation_are_inverse(seed: int) -> None:
    rotation = random_rotation(seed).as_matrix()
    quaternion = quaternion_from_rotation(rotation)
    assert quaternion[3] >= 0.0
    assert np.allclose(rotation_from_quaternion(*quaternion), rotation, atol=1e-12)


@pytest.mark.parametrize("half_turn", np.eye(3))
def test_quaternion_of_half_turns(half_turn: np.ndarray) -> None:
    """Where the trace is -1 the textbook formula divides by zero."""
    rotation = Rotation.from_rotvec(np.pi * half_turn).as_matrix()
    quaternion = quaternion_from_rotation(rotation)
    assert np.allclose(np.abs(quaternion), [*half_turn, 0.0], atol=1e-12)


@given(seeds, seeds, fractions)
def test_slerp_is_scipys(first: int, second: int, fraction: float) -> None:
    before, after = random_rotation(first), random_rotation(second)
    ours = rotation_from_quaternion(*slerp(before.as_quat(), after.as_quat(), fraction))
    oracle = Slerp([0.0, 1.0], Rotation.concatenate([before, after]))(fraction)
    assert np.allclose(ours, oracle.as_matrix(), atol=1e-9)


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 0.9e-4, 1.1e-4, 1e-3])
def test_slerp_of_nearly_equal_rotations_turns_evenly(angle_rad: float) -> None:
    before = np.array([0.0, 0.0, 0.0, 1.0])
    after = Rotation.from_rotvec([0.0, 0.0, angle_rad]).as_quat()
    quarter = Rotation.from_quat(slerp(before, after, 0.25)).as_rotvec()[2]
    assert quarter == pytest.approx(0.25 * angle_rad, abs=1e-15, rel=1e-7)


@given(seeds, fractions)
def test_interpolation_reversed_is_the_same(seed: int, fraction: float) -> None:
    rng = np.random.default_rng(seed)
    ends = np.tile(np.eye(4), (2, 1, 1))
    ends[:, :3, :3] = Rotation.random(2, rng=rng).as_matrix()
    ends[:, :3, 3] = rng.normal(size=(2, 3))
    forth = interpolate_transform(ends[0], ends[1], fraction)
    back = interpolate_transform(ends[1], ends[0], 1.0 - fraction)
    assert np.allclose(forth, back, atol=1e-9)
    assert np.allclose(forth[:3, 3], (1 - fraction) * ends[0, :3, 3] + fraction * ends[1, :3, 3])
