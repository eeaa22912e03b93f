"""(3) to (7) of Song 2022 against closed forms and scipy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.calibration.turning.half_turn_planes import PlanePair
from fusion_core.calibration.turning.plane_procrustes import (
    half_turn_pose,
    mounting_from_half_turn,
    plane_offset,
    procrustes_rotation,
    refine_pose,
)

SEEDS = st.integers(0, 2**32 - 1)
ANGLES = st.floats(-0.3, 0.3)
OFFSETS = st.floats(-0.1, 0.1)


def unit_normals(rng: np.random.Generator, count: int) -> np.ndarray:
    normals = rng.standard_normal((count, 3))
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


@given(SEEDS)
def test_the_rotation_is_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    left = unit_normals(rng, 6)
    turned = Rotation.random(random_state=seed % 2**31).apply(left)
    right = turned + 0.05 * rng.standard_normal(left.shape)
    expected, _ = Rotation.align_vectors(right, left)
    np.testing.assert_allclose(procrustes_rotation(left, right), expected.as_matrix(), atol=1e-9)


@given(SEEDS)
def test_two_directions_give_no_reflection(seed):
    """With normals in one plane V Uᵀ may be a reflection: both explain them."""
    rng = np.random.default_rng(seed)
    left = unit_normals(rng, 2)[rng.integers(0, 2, 5)]
    rotation = procrustes_rotation(left, left)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-9)
    np.testing.assert_allclose(rotation @ left.T, left.T, atol=1e-6)


@given(SEEDS)
def test_the_offset_is_that_of_the_planes(seed):
    rng = np.random.default_rng(seed)
    normals, shift = unit_normals(rng, 7), rng.uniform(-0.1, 0.1, 3)
    left_m = rng.uniform(1.0, 4.0, 7)
    # A point of the plane, moved by the shift, lies further along the normal.
    np.testing.assert_allclose(
        plane_offset(normals, left_m, left_m + normals @ shift), shift, atol=1e-9
    )


def make_pairs(
    rotation: np.ndarray, shift: np.ndarray, seed: int, sigma_m: float = 0.0
) -> tuple[PlanePair, ...]:
    rng = np.random.default_rng(seed)
    pairs = []
    for frame, normal in enumerate(unit_normals(rng, 9)):
        offset_m = float(rng.uniform(1.0, 3.0))
        spread = rng.uniform(-1.0, 1.0, (80, 3))
        points = spread + np.outer(offset_m - spread @ normal, normal)
        right = rotation @ normal
        pairs.append(
            PlanePair(
                frame=frame,
                normal_left=normal,
                offset_left_m=offset_m,
                normal_right=right,
                offset_right_m=float(offset_m + right @ shift),
                points_left_m=points + sigma_m * rng.standard_normal(points.shape),
            )
        )
    return tuple(pairs)


@settings(deadline=None, max_examples=20)
@given(SEEDS, ANGLES, ANGLES)
def test_marquardt_ends_at_the_truth(seed, angle, other):
    rotation = Rotation.from_euler("XY", [angle, other]).as_matrix()
    shift = np.array([0.02, -0.03, 0.01])
    found, offset = refine_pose(np.eye(3), np.zeros(3), make_pairs(rotation, shift, seed))
    np.testing.assert_allclose(found, rotation, atol=1e-7)
    np.testing.assert_allclose(offset, shift, atol=1e-7)


def test_a_cupboard_taken_for_the_wall_behind_it_is_left_out():
    rotation, shift = Rotation.from_euler("X", 0.04).as_matrix(), np.array([0.01, 0.0, 0.0])
    pairs = make_pairs(rotation, shift, 3, sigma_m=0.005)
    wrong = PlanePair(
        frame=9,
        normal_left=pairs[0].normal_left,
        offset_left_m=pairs[0].offset_left_m,
        normal_right=pairs[0].normal_right,
        offset_right_m=pairs[0].offset_right_m + 0.25,
        points_left_m=pairs[0].points_left_m,
    )
    found, offset, kept = half_turn_pose((*pairs, wrong))
    assert wrong not in kept
    np.testing.assert_allclose(found, rotation, atol=2e-3)
    np.testing.assert_allclose(offset, shift, atol=2e-3)


@given(ANGLES, ANGLES, OFFSETS, OFFSETS, st.tuples(OFFSETS, OFFSETS, OFFSETS))
def test_the_mounting_is_half_of_what_lies_between_the_half_turns(theta, beta, dx, dy, lever):
    """One point, seen by both: the two coordinates follow from the geometry of the axis alone."""
    tilt = Rotation.from_euler("XY", [theta, beta])
    half = np.diag([-1.0, -1.0, 1.0])
    lever_m, delta = np.array(lever), np.array([dx, dy, 0.0])
    world = np.random.default_rng(1).uniform(-3.0, 3.0, (8, 3))
    # What the nominal mounting makes of the point, at an angle and half a turn later.
    left = tilt.inv().apply(world - lever_m - delta) + lever_m
    right = tilt.inv().apply(world @ half - lever_m - delta) + lever_m
    rotated_back = right @ half
    rotation, _ = Rotation.align_vectors(
        rotated_back - rotated_back.mean(axis=0), left - left.mean(axis=0)
    )
    offset = rotated_back.mean(axis=0) - rotation.apply(left.mean(axis=0))
    found, about_axis = mounting_from_half_turn(rotation.as_matrix(), offset, lever_m)
    np.testing.assert_allclose(found, [theta, beta, dx, dy], atol=1e-8)
    np.testing.assert_allclose(about_axis, 0.0, atol=1e-8)
