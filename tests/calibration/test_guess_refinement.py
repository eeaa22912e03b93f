"""Refinement from a guess: back to the truth of a simulated scene, and never worse."""

from pathlib import Path

import numpy as np
import pytest

from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.calibration.refinement.guess_refinement import (
    GuessRefinement,
    GuessRefinementSettings,
    refine_from_guess,
)
from fusion_core.model.errors import CalibrationFailed
from tests.benchmarks.bench_guess import disturbances, mean_displacement_px
from tests.benchmarks.street_scenes import read_scene
from tests.calibration.textured_street import (
    INTRINSICS,
    T_CAMERA_LIDAR,
    TexturedStreet,
    textured_street,
)

DISTURBANCE = np.array([0.02, -0.008, 0.01, 0.05, -0.04, 0.03])


@pytest.fixture(scope="module")
def street() -> TexturedStreet:
    return textured_street()


@pytest.fixture(scope="module")
def refined(street: TexturedStreet) -> GuessRefinement:
    return refine(street, apply_pose_error(T_CAMERA_LIDAR, DISTURBANCE))


def refine(street, T_guess, intensity="its own", **settings):
    return refine_from_guess(
        street.points_m,
        street.intensity if isinstance(intensity, str) else intensity,
        street.grey,
        INTRINSICS,
        T_guess,
        GuessRefinementSettings(**{"starts": 3, **settings}),
    )


def test_a_disturbed_guess_comes_back_to_the_truth_by_exact_beams(street):
    T_guess = apply_pose_error(T_CAMERA_LIDAR, DISTURBANCE)
    estimate = refine(street, T_guess, bearing_bias_sd_beams=0.0, starts=2).estimate
    error = pose_error(T_CAMERA_LIDAR, estimate.T_camera_lidar)
    assert estimate.improved
    assert np.degrees(np.linalg.norm(error[:3])) < 0.05
    assert np.linalg.norm(error[3:]) < 0.01
    # 0.999 of chi-squared with six degrees of freedom.
    assert error @ np.linalg.solve(estimate.covariance, error) < 22.5


def test_with_beams_of_common_scanners_a_disturbed_guess_comes_near_the_truth(refined):
    error = pose_error(T_CAMERA_LIDAR, refined.estimate.T_camera_lidar)
    assert refined.estimate.improved
    # Scanners with beams 0.25 degrees apart are that inexact: all of the way would be a risk.
    assert np.degrees(np.linalg.norm(error[:3])) < 0.2
    assert np.linalg.norm(error[3:]) < 0.5 * np.linalg.norm(DISTURBANCE[3:])
    best = pose_error(T_CAMERA_LIDAR, refined.T_best)
    assert np.degrees(np.linalg.norm(best[:3])) < 0.1
    assert np.linalg.norm(best[3:]) < 0.02
    # 0.999 of chi-squared with six degrees of freedom.
    assert error @ np.linalg.solve(refined.estimate.covariance, error) < 22.5


def test_the_evidence_is_shown(refined):
    assert refined.estimate.basin > 0.5
    assert refined.information_after > refined.information_before
    for family in ("intensity", "edges"):
        assert refined.distance_after[family] < refined.distance_before[family]
        assert sum(refined.held_out_gain[family]) > 0.0
    assert max(refined.risk.values()) <= 0.02
    # The profile's middle is the result, and its top is near there.
    tops = np.abs(refined.profile.argmax(axis=1) - refined.profile.shape[1] // 2)
    assert (tops <= 3).all()


def test_a_guess_that_is_right_is_not_made_worse(street):
    estimate = refine(street, T_CAMERA_LIDAR).estimate
    error = pose_error(T_CAMERA_LIDAR, estimate.T_camera_lidar)
    assert np.degrees(np.linalg.norm(error[:3])) < 0.02
    assert np.linalg.norm(error[3:]) < 0.005
    if not estimate.improved:
        assert np.array_equal(estimate.T_camera_lidar, T_CAMERA_LIDAR)
        assert "The guess is kept: " in estimate.verdict


@pytest.mark.slow
def test_an_image_of_noise_keeps_the_guess(street):
    grey = np.random.default_rng(10).integers(0, 256, street.grey.shape).astype(np.uint8)
    noise = TexturedStreet(points_m=street.points_m, intensity=street.intensity, grey=grey)
    T_guess = apply_pose_error(T_CAMERA_LIDAR, DISTURBANCE)
    estimate = refine(noise, T_guess).estimate
    assert not estimate.improved
    assert np.array_equal(estimate.T_camera_lidar, T_guess)
    assert np.isfinite(estimate.covariance).all()


@pytest.mark.parametrize("case", ["none", pytest.param("constant", marks=pytest.mark.slow)])
def test_without_an_intensity_edges_alone_are_compared(street, case):
    intensity = None if case == "none" else np.full(len(street.points_m), 7.0)
    T_guess = apply_pose_error(T_CAMERA_LIDAR, DISTURBANCE)
    found = refine(street, T_guess, intensity, starts=2)
    assert list(found.held_out_gain) == ["edges"]
    assert sum("edges alone were compared" in note for note in found.estimate.notes) == 1
    before, after = (
        np.linalg.norm(pose_error(T_CAMERA_LIDAR, T)[:3])
        for T in (T_guess, found.estimate.T_camera_lidar)
    )
    assert after <= before


@pytest.mark.slow
def test_points_without_a_position_are_left_out(street, refined):
    # And the same input gives the same bytes.
    missing = np.full((500, 3), np.nan)
    missing[::2] = np.inf
    missing[::5] = 0.0
    with_missing = TexturedStreet(
        points_m=np.concatenate([missing, street.points_m]),
        intensity=np.concatenate([np.zeros(500), street.intensity]),
        grey=street.grey,
    )
    found = refine(with_missing, apply_pose_error(T_CAMERA_LIDAR, DISTURBANCE))
    np.testing.assert_array_equal(found.estimate.T_camera_lidar, refined.estimate.T_camera_lidar)


def test_what_does_not_belong_together_is_refused_in_one_line(street):
    def refused(match, points=street.points_m, grey=street.grey, T_guess=T_CAMERA_LIDAR):
        with pytest.raises(CalibrationFailed, match=match) as failure:
            refine_from_guess(points, None, grey, INTRINSICS, T_guess)
        assert "\n" not in str(failure.value)

    refused("320 x 400 pixels, but .* images of 640 x 400", grey=street.grey[:, :320])
    refused("All pixels of the image have the value 9", grey=np.full_like(street.grey, 9))
    refused("None of the cloud's points", points=np.full((50, 3), np.nan))
    refused("look like millimetres", points=1000.0 * street.points_m)
    backwards = T_CAMERA_LIDAR.copy()
    backwards[[0, 2]] *= -1.0
    refused("Only 0 of .* points lie in the image", T_guess=backwards)
    refused("no rigid transform", T_guess=np.diag([2.0, 1.0, 1.0, 1.0]))


@pytest.mark.data
@pytest.mark.slow
def test_two_starts_of_a_real_street_do_not_end_worse(data_folder: Path):
    scene = read_scene(data_folder, "opencalib_manual")
    for disturbance in disturbances(2, seed=1):
        T_guess = apply_pose_error(scene.T_given, disturbance)
        estimate = refine_from_guess(
            scene.points_m, scene.intensity, scene.grey, scene.intrinsics, T_guess
        ).estimate
        before = mean_displacement_px(scene, T_guess)
        assert mean_displacement_px(scene, estimate.T_camera_lidar) <= before
        assert estimate.improved == (not np.array_equal(estimate.T_camera_lidar, T_guess))
