"""Alignment of positions: known motions are found, the rest is a least-squares optimum."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.evaluation.umeyama import Group, Similarity, align_positions
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ScanLoomError
from tests.evaluation.random_poses import random_transforms

SEEDS = st.integers(0, 2**32 - 1)


def motion(seed: int, group: Group) -> Similarity:
    random = np.random.default_rng(seed)
    turn, shift_m = random.uniform(-1.8, 1.8, 3), random.uniform(-50.0, 50.0, 3)
    if group == "se2":
        turn[:2] = shift_m[2] = 0.0
    return Similarity(
        rotation=Rotation.from_rotvec(turn).as_matrix(),
        translation_m=shift_m,
        scale=float(random.uniform(0.1, 10.0)) if group == "sim3" else 1.0,
    )


def moved(positions_m: FloatArray, by: Similarity) -> FloatArray:
    return by.scale * positions_m @ by.rotation.T + by.translation_m


def squared(moving_m: FloatArray, fixed_m: FloatArray, by: Similarity) -> float:
    return float(((moved(moving_m, by) - fixed_m) ** 2).sum())


@pytest.mark.parametrize("group", ["se2", "se3", "sim3"])
@given(seed=SEEDS)
def test_a_known_motion_is_found(group: Group, seed: int) -> None:
    positions_m = random_transforms(6, seed)[:, :3, 3]
    true = motion(seed, group)
    found = align_positions(positions_m, moved(positions_m, true), group)
    assert np.allclose(found.rotation, true.rotation)
    assert np.allclose(found.translation_m, true.translation_m)
    assert found.scale == pytest.approx(true.scale)


@pytest.mark.parametrize("group", ["se2", "se3", "sim3"])
@given(seed=SEEDS)
def test_no_motion_nearby_is_better(group: Group, seed: int) -> None:
    """Also where the best match would be a mirror image, and for points that do not match."""
    random = np.random.default_rng(seed)
    moving_m = random.normal(0.0, 2.0, (6, 3))
    fixed_m = moving_m * [1.0, -1.0, 1.0] + random.normal(0.0, 0.3, (6, 3))
    found = align_positions(moving_m, fixed_m, group)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    least = squared(moving_m, fixed_m, found)
    for _ in range(10):
        turn, shift_m = random.normal(0.0, 0.01, 3), random.normal(0.0, 0.01, 3)
        if group == "se2":
            turn[:2] = shift_m[2] = 0.0
        other = Similarity(
            rotation=Rotation.from_rotvec(turn).as_matrix() @ found.rotation,
            translation_m=found.translation_m + shift_m,
            scale=found.scale * (1.0 + float(random.normal(0.0, 0.01)) * (group == "sim3")),
        )
        assert squared(moving_m, fixed_m, other) >= least


def test_a_flat_path_is_not_a_line() -> None:
    positions_m = random_transforms(6, seed=3)[:, :3, 3]
    positions_m[:, 2] = 0.0
    true = motion(4, "se3")
    found = align_positions(positions_m, moved(positions_m, true), "se3")
    assert np.allclose(found.rotation, true.rotation)


@pytest.mark.parametrize("group", ["se3", "sim3"])
def test_a_line_determines_no_rotation_in_space(group: Group) -> None:
    line_m = np.linspace(0.0, 5.0, 20)[:, np.newaxis] * [1.0, 0.3, -0.2]
    with pytest.raises(ScanLoomError, match=f"by {group}: they lie on one line or point"):
        align_positions(line_m, moved(line_m, motion(5, "se3")), group)


def test_in_the_plane_a_line_is_enough_and_a_point_is_not() -> None:
    line_m = np.linspace(0.0, 5.0, 20)[:, np.newaxis] * [1.0, 0.3, 0.0]
    true = motion(6, "se2")
    assert np.allclose(align_positions(line_m, moved(line_m, true), "se2").rotation, true.rotation)
    with pytest.raises(ScanLoomError, match="one point"):
        align_positions(np.ones((4, 3)), line_m[:4], "se2")


@pytest.mark.parametrize("group", ["se2", "se3", "sim3"])
def test_one_position_determines_nothing(group: Group) -> None:
    with pytest.raises(ScanLoomError, match=group):
        align_positions(np.zeros((1, 3)), np.ones((1, 3)), group)


def test_poses_are_turned_and_their_positions_scaled() -> None:
    poses = random_transforms(4, seed=7)
    by = motion(8, "sim3")
    laid = by.apply(poses)
    assert np.allclose(laid[:, :3, 3], moved(poses[:, :3, 3], by))
    assert np.allclose(laid[:, :3, :3], by.rotation @ poses[:, :3, :3])
    assert np.array_equal(laid[:, 3], poses[:, 3])
