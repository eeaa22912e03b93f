"""Fused odometry on simulated motion: faults unknown to the method, and Li 2022's (8)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import MissingStream
from fusion_core.motion.fusion import FusedOdometry, FusionSettings, fuse_odometry
from fusion_core.motion.fusion_published import next_gain
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from tests.motion.simulated_motion import stamps, step_errors, track_of, weaving

COUNT = 301
TRUTH = weaving(COUNT)
WHEEL, LASER, VISUAL = (0.002, 0.001, 0.003), (0.001, 0.001, 0.001), (0.003, 0.003, 0.002)
PUBLISHED = FusionSettings(method="published")


def sources(**more: slice) -> list[OdometryTrajectory]:
    """Wheel, laser and visual with noise; ``more``: which steps of one are not measured."""
    return [
        track_of(name, TRUTH, sigma, seed=seed, unmeasured=more.get(name))
        for seed, (name, sigma) in enumerate(
            (("wheel", WHEEL), ("laser", LASER), ("visual", VISUAL))
        )
    ]


def slipping(factor: float, when: slice) -> OdometryTrajectory:
    """Wheels that report ``factor`` times the distance, with an unchanged covariance."""
    steps = TRUTH.copy()
    steps[when, 0] *= factor
    return track_of("wheel", steps, WHEEL, seed=0)


def way_error_m(trajectory: OdometryTrajectory, when: slice = slice(None)) -> float:
    """Of the summed forward distance; the noise alone of 300 steps is 2 cm for the laser."""
    return abs(float(step_errors(trajectory, TRUTH)[when, 0].sum()))


def rms(fusion: FusedOdometry, truth: FloatArray = TRUTH) -> FloatArray:
    errors = step_errors(fusion.trajectory, truth)
    return np.sqrt(np.mean(errors**2, axis=0))


def test_it_is_the_least_squares_mean_of_the_steps() -> None:
    """Against numpy's solver on the stacked and whitened steps, with full covariances."""
    random = np.random.default_rng(5)
    truth = weaving(6)
    trajectories = []
    for name in ("wheel", "laser", "visual"):
        root = random.normal(0.0, 0.01, (3, 3))
        covariance = root @ root.T + 1e-6 * np.eye(3)
        trajectories.append(
            track_of(name, truth, (0.002,) * 3, seed=len(name), covariance=covariance)
        )
    settings = FusionSettings(gate=1e9, window=1000, sigma_min_m=1e-9, sigma_min_rad=1e-9)
    fusion = fuse_odometry(trajectories, settings)
    for k in range(5):
        roots = [np.linalg.cholesky(np.linalg.inv(t.drift_covariance[k])).T for t in trajectories]
        rows = np.concatenate(roots)
        right = np.concatenate(
            [root @ t.steps[k] for root, t in zip(roots, trajectories, strict=True)]
        )
        expected, *_ = np.linalg.lstsq(rows, right, rcond=None)
        np.testing.assert_allclose(fusion.trajectory.steps[k], expected, atol=1e-6)
        np.testing.assert_allclose(
            fusion.trajectory.drift_covariance[k],
            np.linalg.inv(rows.T @ rows),
            rtol=1e-3,
            atol=1e-10,
        )


def test_it_is_better_than_each_source_and_knows_how_good_it_is() -> None:
    trajectories = sources()
    fusion = fuse_odometry(trajectories)
    best = np.min(
        [np.sqrt(np.mean(step_errors(t, TRUTH) ** 2, axis=0)) for t in trajectories], axis=0
    )
    assert (rms(fusion) < best).all()
    said = np.sqrt(
        np.mean(np.diagonal(fusion.trajectory.step_covariance, axis1=1, axis2=2), axis=0)
    )
    np.testing.assert_allclose(rms(fusion), said, rtol=0.25)
    assert fusion.weights.rejected.mean() < 0.01


def test_the_order_of_the_sources_does_not_matter() -> None:
    trajectories = sources(laser=slice(50, 70))
    one, other = fuse_odometry(trajectories), fuse_odometry(trajectories[::-1])
    np.testing.assert_allclose(
        one.trajectory.poses_odom_lidar, other.trajectory.poses_odom_lidar, atol=1e-9
    )
    np.testing.assert_allclose(one.weights.translation, other.weights.translation[:, ::-1])


@pytest.mark.parametrize("factor", [3.0, 0.0])
@pytest.mark.parametrize("count", [2, 3])
def test_wheels_that_slip_for_three_seconds_are_rejected(factor: float, count: int) -> None:
    slip = slice(100, 130)
    trajectories = [slipping(factor, slip), *sources()[1:count]]
    fusion = fuse_odometry(trajectories)
    assert fusion.weights.rejected[slip, 0].mean() > 0.95
    assert fusion.weights.translation[slip, 0].max() < 0.25
    assert fusion.weights.rejected[slip, 1:].mean() < 0.05
    # The wheels alone are off by the slip: 1.2 m and more.
    assert way_error_m(trajectories[0], slip) > 1.0
    assert way_error_m(fusion.trajectory, slip) < 0.02
    # Once they grip again they count again.
    assert fusion.weights.translation[180:, 0].mean() > 0.1


def test_an_overconfident_source_counts_less() -> None:
    """A laser that errs by 3 mm and says 1 mm: too little to be refused, and too often."""
    said = np.diag(np.square(LASER))
    boasting = track_of("laser", TRUTH, (0.003, 0.003, 0.003), seed=1, covariance=said)
    wheel, _, visual = sources()
    fusion = fuse_odometry([wheel, boasting, visual])
    believed = ~fusion.weights.rejected[:, 1]
    taken = np.array([1.0 / sigma**2 for sigma in (WHEEL[2], LASER[2], VISUAL[2])])
    by_its_word = taken[1] / taken.sum()
    assert fusion.weights.rotation[believed, 1][50:].mean() < 0.8 * by_its_word
    honest = fuse_odometry(sources()).weights.rotation[:, 1]
    assert honest.mean() == pytest.approx(by_its_word, rel=0.05)


def test_a_source_that_drops_out_has_no_weight_and_one_that_is_there_all() -> None:
    dark, blind = slice(80, 120), slice(100, 140)
    fusion = fuse_odometry(sources(visual=dark, laser=blind))
    weights = fusion.weights
    np.testing.assert_array_equal(weights.translation[dark, 2], 0.0)
    np.testing.assert_array_equal(weights.rotation[blind, 1], 0.0)
    np.testing.assert_allclose(weights.translation[100:120], np.tile([1.0, 0.0, 0.0], (20, 1)))
    assert fusion.trajectory.measured.all()
    assert not weights.rejected[100:120].any()
    assert np.isnan(weights.residual_m[dark, 2]).all()
    assert way_error_m(fusion.trajectory) < 0.05


def test_unmeasured_steps_repeat_the_velocity_and_are_marked() -> None:
    lost = slice(100, 110)
    fusion = fuse_odometry(sources(wheel=lost, laser=lost, visual=lost))
    np.testing.assert_array_equal(np.flatnonzero(~fusion.trajectory.measured), np.arange(100, 110))
    np.testing.assert_allclose(
        fusion.trajectory.steps[lost], np.tile(fusion.trajectory.steps[99], (10, 1))
    )
    assert (fusion.weights.translation[lost] == 0.0).all()
    assert fusion.trajectory.pose_at(int(stamps(COUNT)[105])) is None
    assert "10 steps that no source measured" in fusion.trajectory.notes[-1]


def test_along_a_corridor_the_wheels_count_and_across_it_the_laser() -> None:
    """The laser keeps a guess along the corridor, and its covariance says that it does."""
    steps = TRUTH.copy()
    steps[:, 0] = 0.0
    said = np.diag([1e4, 0.001**2, 0.001**2])
    laser = track_of("laser", steps, (1e-9, 0.001, 0.001), seed=1, covariance=said)
    fusion = fuse_odometry([track_of("wheel", TRUTH, (0.002, 0.02, 0.02), seed=0), laser])
    errors = rms(fusion)
    assert errors[0] < 0.0025
    assert errors[1] < 0.0012
    assert errors[2] < 0.0012
    assert not fusion.weights.rejected.any()
    np.testing.assert_allclose(fusion.weights.translation.mean(axis=0), 0.5, atol=0.01)


def test_rotations_are_fused_across_pi() -> None:
    steps = np.tile([0.0, 0.0, np.pi - 0.001], (20, 1))
    fusion = fuse_odometry(
        [
            track_of("wheel", steps, (0.001, 0.001, 0.01), seed=0),
            track_of("laser", steps, (0.001, 0.001, 0.01), seed=1),
        ]
    )
    assert np.abs(step_errors(fusion.trajectory, steps)[:, 2]).max() < 0.05


def test_one_source_alone_stays_what_it_is() -> None:
    alone = sources()[1]
    for settings in (FusionSettings(), PUBLISHED):
        fusion = fuse_odometry([alone], settings)
        np.testing.assert_allclose(fusion.trajectory.steps, alone.steps, atol=1e-12)
        np.testing.assert_allclose(fusion.weights.translation, 1.0)


def test_what_does_not_belong_together_is_refused() -> None:
    wheel, laser, _ = sources()
    with pytest.raises(MissingStream):
        fuse_odometry([])
    with pytest.raises(ValueError, match="each once"):
        fuse_odometry([wheel, wheel])
    with pytest.raises(ValueError, match="same stamps"):
        fuse_odometry([wheel, track_of("laser", TRUTH[:-1], LASER)])
    del laser


@given(st.floats(0.0, 1.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_the_published_gain_does_not_depend_on_the_data(K: float, X_v: float, X_s: float) -> None:
    """(6) after (7) and (8), worked out with numbers, is K² / (K² + (1 - K)²)."""
    if abs(X_v - X_s) < 1e-6:
        return
    X_k = X_v + K * (X_s - X_v)
    sigma_v, sigma_s = X_v - X_k, X_s - X_k
    assert next_gain(K) == pytest.approx(sigma_v**2 / (sigma_v**2 + sigma_s**2), abs=1e-6)


def test_as_published_one_source_takes_all() -> None:
    """The first gain is just below a half, so the camera has all within a few steps, for ever."""
    first = 0.0031**2 / (0.0031**2 + 0.003**2)
    visual = track_of("visual", TRUTH, (0.003,) * 3, seed=2)
    laser = track_of("laser", TRUTH, (0.0031,) * 3, seed=1)
    fusion = fuse_odometry([laser, visual], PUBLISHED)
    gain = fusion.weights.gain
    assert gain is not None
    expected = 1.0 - first
    for k in range(12):
        np.testing.assert_allclose(gain[k], expected, atol=1e-6)
        expected = next_gain(expected)
    np.testing.assert_allclose(fusion.weights.translation[12:, 1], 1.0, atol=1e-6)
    # Variances propagated, both go on to count.
    assert fuse_odometry([laser, visual]).weights.translation[:, 0].mean() == pytest.approx(
        0.48, abs=0.05
    )


def test_as_published_agreement_keeps_the_gain() -> None:
    """0 / 0 in (6): both deviations are zero."""
    laser, visual = track_of("laser", TRUTH, LASER), track_of("visual", TRUTH, LASER)
    fusion = fuse_odometry([laser, visual], PUBLISHED)
    assert fusion.weights.gain is not None
    np.testing.assert_allclose(fusion.weights.gain, 0.5)
    np.testing.assert_allclose(fusion.trajectory.steps, TRUTH, atol=1e-9)


def test_as_published_the_noise_at_standstill_decides_the_first_gain() -> None:
    """Ten seconds at rest, after some motion, with noise of 2 mm and 1 mm, of which the covariances
    know nothing."""
    steps = TRUTH.copy()
    steps[30:130] = 0.0
    said = np.diag([1e-4, 1e-4, 1e-4])
    visual = track_of("visual", steps, (0.002,) * 3, seed=2, covariance=said)
    laser = track_of("laser", steps, (0.001,) * 3, seed=1, covariance=said)
    settings = PUBLISHED.model_copy(update={"standstill_min_s": 8.0})
    gain = fuse_odometry([laser, visual], settings).weights.gain
    assert gain is not None
    np.testing.assert_allclose(gain[0], 0.8, atol=0.06)


def test_as_published_the_wheels_are_weighed_by_their_residuals() -> None:
    """(9): wheels that slip lose weight, with the delay of the window, and are never rejected."""
    trajectories = [slipping(3.0, slice(100, 130)), *sources()[1:]]
    fusion = fuse_odometry(trajectories, PUBLISHED)
    weights = fusion.weights
    # Half of the weight is lateral, where they do not slip.
    before = weights.translation[60:100, 0].mean()
    assert weights.translation[110:130, 0].mean() < before - 0.2
    assert not weights.rejected.any()
    np.testing.assert_allclose(weights.translation.sum(axis=1), 1.0)
    assert way_error_m(fusion.trajectory) < 0.3 * way_error_m(trajectories[0])


@pytest.mark.parametrize("settings", [FusionSettings(), PUBLISHED], ids=["covariance", "published"])
def test_weights_sum_to_one_with_any_dropouts(settings: FusionSettings) -> None:
    trajectories = sources(wheel=slice(0, 90), laser=slice(60, 150), visual=slice(140, 301))
    fusion = fuse_odometry(trajectories, settings)
    there = np.stack([t.measured for t in trajectories], axis=1).any(axis=1)
    for shares in (fusion.weights.translation, fusion.weights.rotation):
        np.testing.assert_allclose(shares[there].sum(axis=1), 1.0)
        np.testing.assert_array_equal(shares[~there], 0.0)
    np.testing.assert_array_equal(fusion.trajectory.measured, there)
