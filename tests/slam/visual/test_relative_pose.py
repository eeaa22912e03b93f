"""The pose between two views, against truth and against OpenCV, with an honest covariance."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.model.geometry import invert_transform
from fusion_core.slam.visual.drift import small_motion_between
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.relative_pose import (
    RelativePose,
    RelativePoseSettings,
    estimate_relative_pose,
    points_in_camera_m,
)
from fusion_core.slam.visual.relative_pose_refinement import small_motion
from tests.slam.visual.feature_world import INTRINSICS, camera_pose, hall, observe

NOISE = ObservationNoise(pixel_sigma=0.5, depth_sigma_per_m2=0.0015)
# Depths of the imitated camera have no common scale error.
SETTINGS = RelativePoseSettings(depth_scale_sigma=0.0)


def views(seed, T_first_second=None, **noise):
    rng = np.random.default_rng(seed)
    T_world_first = camera_pose(3.0, 1.0, 0.1)
    if T_first_second is None:
        T_first_second = small_motion(
            np.concatenate([rng.normal(0.0, 0.1, 3), rng.normal(0.0, 0.3, 3)])
        )
    world = hall()
    first, a = observe(world, T_world_first, rng, **noise)
    second, b = observe(world, T_world_first @ T_first_second, rng, **noise)
    return first, second, T_first_second, a, b


def estimate(first, second, asked=SETTINGS):
    return estimate_relative_pose(first, second, INTRINSICS, NOISE, asked)


def test_the_pose_is_the_true_one_and_its_covariance_is_honest():
    normalised = []
    for seed in range(25):
        first, second, truth, a, b = views(seed)
        found = estimate(first, second)
        assert isinstance(found, RelativePose)
        off = small_motion_between(truth, found.T_first_second)
        assert np.linalg.norm(off[3:]) < 0.02
        assert np.linalg.norm(off[:3]) < 0.006
        normalised.append(off @ np.linalg.solve(found.covariance, off))
        # What is matched is the same point.
        assert np.mean(a[found.matches[:, 0]] == b[found.matches[:, 1]]) > 0.98
    # The mean of 25 chi-squares of six degrees of freedom is 6 ± 0.7.
    assert 4.0 < np.mean(normalised) < 8.8


def test_it_agrees_with_opencvs_refinement_of_the_same_matches():
    first, second, _, _, _ = views(3)
    found = estimate(first, second)
    with_depth = found.matches[np.isfinite(first.depths_m[found.matches[:, 0]])]
    points = points_in_camera_m(first, INTRINSICS)[with_depth[:, 0]]
    _, turn, shift = cv2.solvePnP(
        points, second.pixels[with_depth[:, 1]], INTRINSICS.matrix, None, flags=cv2.SOLVEPNP_SQPNP
    )
    T_second_first = np.eye(4)
    T_second_first[:3, :3], T_second_first[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    off = small_motion_between(invert_transform(T_second_first), found.T_first_second)
    assert np.linalg.norm(off[3:]) < 0.01
    assert np.linalg.norm(off[:3]) < 0.004


@settings(max_examples=8)
@given(st.integers(0, 10_000))
def test_the_pose_of_the_first_in_the_second_is_the_inverse(seed):
    first, second, _, _, _ = views(seed)
    there, back = estimate(first, second), estimate(second, first)
    assert isinstance(there, RelativePose)
    assert isinstance(back, RelativePose)
    off = small_motion_between(there.T_first_second, invert_transform(back.T_first_second))
    # They start from other draws and weigh the same noise from the other side.
    assert np.sqrt(off @ np.linalg.solve(there.covariance, off)) < 3.0


def test_depth_in_one_view_is_enough():
    first, second, truth, _, _ = views(5)
    without = replace(second, depths_m=np.full(len(second), np.nan))
    for a, b, T in ((first, without, truth), (without, first, invert_transform(truth))):
        found = estimate(a, b)
        assert isinstance(found, RelativePose)
        assert np.linalg.norm(small_motion_between(T, found.T_first_second)[3:]) < 0.02


def test_without_depth_there_is_no_pose():
    first, second, _, _, _ = views(5)
    none = np.full(len(second), np.nan)
    a, b = replace(first, depths_m=none[: len(first)]), replace(second, depths_m=none)
    if len(first) > len(second):
        a = replace(first, depths_m=np.full(len(first), np.nan))
    assert estimate(a, b) == "matches that contradict each other"


def test_two_places_give_no_pose():
    first, _, _, _, _ = views(1)
    rng = np.random.default_rng(1)
    elsewhere, _ = observe(hall(), camera_pose(-3.0, 0.0, np.pi), rng)
    assert isinstance(estimate(first, elsewhere), str)


def test_matches_at_random_places_give_no_pose():
    first, second, _, _, _ = views(2)
    rng = np.random.default_rng(2)
    scattered = replace(second, pixels=rng.uniform([0, 0], [639, 479], (len(second), 2)))
    assert isinstance(estimate(first, scattered), str)


@pytest.mark.parametrize(
    ("asked", "reason"),
    [
        (RelativePoseSettings(inliers_min=5000), "too few inliers"),
        (RelativePoseSettings(inlier_ratio_min=1.0), "features should be seen"),
        (RelativePoseSettings(depth_scale_sigma=0.5), "do not determine the pose"),
        (RelativePoseSettings(distance_max=1), "too few matches"),
    ],
)
def test_a_refusal_has_its_reason(asked, reason):
    first, second, _, _, _ = views(4, flips=20)
    assert reason in estimate(first, second, asked)


def test_outliers_do_not_move_the_pose():
    first, second, truth, _, _ = views(6)
    rng = np.random.default_rng(6)
    moved = rng.random(len(second)) < 0.4
    pixels = np.where(
        moved[:, np.newaxis], second.pixels + rng.normal(0.0, 60.0, (len(second), 2)), second.pixels
    )
    found = estimate(first, replace(second, pixels=pixels))
    assert isinstance(found, RelativePose)
    assert np.linalg.norm(small_motion_between(truth, found.T_first_second)[3:]) < 0.02
