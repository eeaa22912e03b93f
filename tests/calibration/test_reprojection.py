"""Reprojection filtering (18), held-out evidence, and a covariance that holds."""

import numpy as np
import pytest
from scipy.stats import chi2

from fusion_core.calibration.features.guess_check import keep_better
from fusion_core.calibration.features.pose_fit import (
    pose_jacobian,
    reprojection_residuals,
)
from fusion_core.calibration.features.reprojection import (
    PUBLISHED,
    ReprojectionSettings,
    covariance_of,
    estimate_pose,
    held_out_residuals,
    image_blocks,
    reprojection_curve,
)
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.lens.projection import project_points
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.geometry import transform_points
from tests.calibration.test_dlt import points_before, pose
from tests.calibration.textured_room import intrinsics

CAMERA = intrinsics(distortion=(-0.1, 0.02))
SETTINGS = ReprojectionSettings()
T_TRUE = pose(0)
T_START = apply_pose_error(T_TRUE, np.array([0.02, -0.01, 0.01, 0.05, -0.03, 0.04]))


def pairs(
    seed: int, count: int = 300, sigma_px: float = 0.5, wrong: int = 0, shared_px: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Points and pixels with noise; the first ``wrong`` are mismatches, and pairs of one part of
    the image share an error."""
    rng = np.random.default_rng(seed)
    points = points_before(T_TRUE, count, seed)
    pixels = project_points(transform_points(T_TRUE, points), CAMERA)
    blocks = image_blocks(pixels, CAMERA)
    pixels = pixels + rng.normal(scale=sigma_px, size=pixels.shape)
    pixels += rng.normal(scale=shared_px, size=(48, 2))[blocks]
    pixels[:wrong] += rng.uniform(-60, 60, (wrong, 2))
    return points, pixels


def test_the_rms_is_equation_18() -> None:
    residuals = np.array([[1.0, 2.0], [-3.0, 0.5], [0.0, -1.0]])
    m_u = np.sqrt((1.0 + 9.0 + 0.0) / 3.0)
    m_v = np.sqrt((4.0 + 0.25 + 1.0) / 3.0)
    assert reprojection_rms(residuals) == pytest.approx(np.hypot(m_u, m_v))


@pytest.mark.parametrize("settings", [SETTINGS, PUBLISHED])
def test_mismatches_are_filtered_and_the_pose_is_found(settings: ReprojectionSettings) -> None:
    points, pixels = pairs(1, wrong=40)
    found = estimate_pose(points, pixels, CAMERA, T_START, settings)
    off = np.linalg.norm(reprojection_residuals(T_TRUE, points, pixels, CAMERA), axis=1)
    assert not found.used[off > 10.0].any()
    assert found.used[40:].mean() > 0.97
    error = np.abs(pose_error(T_TRUE, found.fit.T_camera_lidar))
    # DLT has twelve parameters for six.
    assert error.max() < (0.003 if settings is SETTINGS else 0.05)


def test_dlt_needs_no_start() -> None:
    points, pixels = pairs(2)
    estimate_pose(points, pixels, CAMERA, None, PUBLISHED)
    estimate_pose(points, pixels, CAMERA, None, SETTINGS)


def test_the_jacobian_is_the_derivative_of_the_pixels() -> None:
    points, pixels = pairs(3, count=20)
    jacobian = pose_jacobian(T_TRUE, points, pixels, CAMERA)
    step = 1e-4 * np.array([1.0, -2.0, 0.5, 3.0, 1.0, -1.0])
    moved = project_points(transform_points(apply_pose_error(T_TRUE, step), points), CAMERA)
    before = project_points(transform_points(T_TRUE, points), CAMERA)
    np.testing.assert_allclose(jacobian @ step, moved - before, atol=2e-3)


def test_too_few_pairs_that_agree_are_refused_with_their_number() -> None:
    points, pixels = pairs(4, count=14, wrong=4)
    with pytest.raises(CalibrationFailed, match=r"only \d+ of 14 pairs .* at least 12"):
        estimate_pose(points, pixels, CAMERA, T_START, SETTINGS)


def test_held_out_pairs_are_judged_by_others_alone() -> None:
    points, pixels = pairs(5, count=200)
    whole = held_out_residuals(points, pixels, CAMERA, T_START, SETTINGS)
    assert np.isfinite(whole).all()
    assert reprojection_rms(whole) == pytest.approx(0.5 * np.sqrt(2.0), rel=0.1)
    blocks = image_blocks(pixels, CAMERA)
    moved = pixels.copy()
    one = blocks == blocks[0]
    moved[one] += 0.3
    again = held_out_residuals(points, moved, CAMERA, T_START, SETTINGS)
    if np.array_equal(image_blocks(moved, CAMERA), blocks):
        np.testing.assert_allclose(again[one], whole[one] - 0.3, atol=1e-6)


@pytest.mark.parametrize(
    ("shared_px", "seeds"),
    [
        (0.5, 6),
        pytest.param(0.0, 40, marks=pytest.mark.slow),
        pytest.param(0.5, 40, marks=pytest.mark.slow),
    ],
)
def test_the_covariance_holds_also_where_neighbours_share_errors(
    shared_px: float, seeds: int
) -> None:
    nees = []
    for seed in range(seeds):
        points, pixels = pairs(seed, sigma_px=0.4, shared_px=shared_px)
        found = estimate_pose(points, pixels, CAMERA, T_START, SETTINGS)
        held_out = held_out_residuals(points, pixels, CAMERA, T_START, SETTINGS)
        covariance, _ = covariance_of(found, points, pixels, held_out, CAMERA, SETTINGS)
        error = pose_error(T_TRUE, found.fit.T_camera_lidar)
        nees.append(error @ np.linalg.solve(covariance, error))
    low, high = chi2.ppf([0.005, 0.995], 6 * seeds) / seeds
    assert low < np.mean(nees) < high


def test_the_curve_falls_with_more_pairs_and_by_the_filter() -> None:
    points, pixels = pairs(6, wrong=40)
    found = estimate_pose(points, pixels, CAMERA, T_START, SETTINGS)
    curve = reprojection_curve(points, pixels, CAMERA, T_START, found.used, SETTINGS)
    assert curve.pairs[-1] == 300
    assert curve.filtered_px[-3] < 1.0 < curve.unfiltered_px[-1] < curve.unfiltered_px[0]


def kept(T_guess: FloatArray) -> ExtrinsicsEstimate:
    points, pixels = pairs(7)
    found = estimate_pose(points, pixels, CAMERA, T_START, SETTINGS)
    estimate = ExtrinsicsEstimate(
        T_camera_lidar=found.fit.T_camera_lidar,
        covariance=np.eye(6),
        method="",
        verdict="Good.",
        improved=True,
    )
    held_out = held_out_residuals(points, pixels, CAMERA, T_START, SETTINGS)
    return keep_better(estimate, T_guess, points, pixels, held_out, CAMERA)


def test_a_guess_that_is_as_good_is_kept_and_a_worse_one_is_not() -> None:
    same = kept(T_TRUE)
    assert not same.improved
    np.testing.assert_array_equal(same.T_camera_lidar, T_TRUE)
    assert "guess is kept" in same.verdict
    better = kept(T_START)
    assert better.improved
    np.testing.assert_array_equal(better.T_guess, T_START)
    assert "replaces the guess" in better.verdict
