"""RANSAC against OpenCV, its guards on degenerate curves, and the honesty of its covariance."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.optimize import approx_fprime
from scipy.stats import chi2

from fusion_core.model.errors import RegistrationFailed
from fusion_core.registration.draws import draw_samples, evaluate_samples
from fusion_core.registration.models import MODELS, PARAMETERS, apply_transform, fit_transform
from fusion_core.registration.ransac import PUBLISHED, RegistrationSettings, register

RIGID = np.array(
    [[np.cos(0.12), np.sin(0.12), 0.0], [-np.sin(0.12), np.cos(0.12), 0.0], [0.05, -0.03, 1.0]]
)
MAPS = {
    "rigid": RIGID,
    "similarity": np.diag([1.06, 1.06, 1.0]) @ RIGID,
    "affine": np.array([[1.1, 0.05, 0.0], [0.0, 0.98, 0.0], [0.0, 0.0, 1.0]]) @ RIGID,
    "homography": RIGID @ np.array([[1.05, 0.0, 0.03], [0.0, 1.0, 0.02], [0.0, 0.0, 1.0]]),
}


def room_curve(count=180):
    """(count, 2): the walls of a room with a cupboard, seen from inside over 140 degrees."""
    azimuth = np.linspace(-1.2, 1.2, count)
    distance = np.minimum(1.8 / np.abs(np.sin(azimuth) + 1e-12), 3.2 / np.cos(azimuth))
    distance = np.where((azimuth > 0.1) & (azimuth < 0.45), 2.0, distance)
    return distance[:, None] * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=1)


def wall_curve(count=120):
    azimuth = np.linspace(-0.5, 0.5, count)
    return 2.5 * np.stack([np.tan(azimuth), np.ones(count)], axis=1)


def pairs_of(curve, A, seed, outliers=0.4, sigma_m=0.01):
    """LiDAR points, depth points and the mask of good pairs; noise on both sides."""
    rng = np.random.default_rng(seed)
    depth = apply_transform(A, curve) + rng.normal(0.0, sigma_m, curve.shape)
    bad = rng.permutation(len(curve)) < round(outliers * len(curve))
    depth[bad] += rng.uniform(-1.5, 1.5, (bad.sum(), 2))
    return curve + rng.normal(0.0, sigma_m / 4.0, curve.shape), depth, ~bad


# OpenCV's MAGSAC has a noise scale of its own, in pixels: in metres it takes every pair for exact
# and is 40 times worse. In centimetres the noise is about one unit, as it expects.
PER_METRE = 100.0


def opencv_map(model, lidar, depth, method):
    """A by OpenCV, given centimetres and returned for metres."""
    cv2.setRNGSeed(0)
    lidar, depth, threshold = lidar * PER_METRE, depth * PER_METRE, 0.05 * PER_METRE
    if model == "homography":
        H = cv2.findHomography(lidar, depth, method, threshold)[0]
    else:
        estimate = cv2.estimateAffinePartial2D if model == "similarity" else cv2.estimateAffine2D
        found, _ = estimate(lidar, depth, method=method, ransacReprojThreshold=threshold)
        H = np.vstack([found, [0.0, 0.0, 1.0]])
    to_unit = np.diag([PER_METRE, PER_METRE, 1.0])
    return (np.linalg.inv(to_unit) @ H @ to_unit).T


@pytest.mark.parametrize("outliers", [0.3, 0.5])
@pytest.mark.parametrize(
    ("model", "methods"),
    [
        # estimateAffinePartial2D knows no USAC.
        ("similarity", [cv2.RANSAC, cv2.LMEDS]),
        ("affine", [cv2.RANSAC, cv2.USAC_MAGSAC]),
        ("homography", [cv2.RANSAC, cv2.USAC_MAGSAC]),
    ],
)
def test_as_accurate_as_opencv(model, methods, outliers):
    curve = room_curve()
    truth = apply_transform(MAPS[model], curve)
    chosen = RegistrationSettings(model=model, inlier_threshold_m=0.05)
    ours, rivals = [], {method: [] for method in methods}
    for seed in range(12):
        lidar, depth, _ = pairs_of(curve, MAPS[model], seed, outliers)
        found = register(lidar, depth, chosen)
        ours.append(np.linalg.norm(apply_transform(found.A, curve) - truth, axis=1).mean())
        for method, errors in rivals.items():
            oracle = opencv_map(model, lidar, depth, method)
            errors.append(np.linalg.norm(apply_transform(oracle, curve) - truth, axis=1).mean())
    assert max(ours) < 0.01
    for errors in rivals.values():
        assert np.median(ours) < 1.1 * np.median(errors)


@pytest.mark.parametrize("model", MODELS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=20)
def test_exact_pairs_among_outliers_are_recovered(model, seed):
    lidar = room_curve()
    depth = apply_transform(MAPS[model], lidar)
    bad = np.random.default_rng(seed).permutation(len(lidar)) < 60
    depth[bad] += 3.0
    found = register(lidar, depth, RegistrationSettings(seed=seed))
    assert found.model == model
    np.testing.assert_array_equal(found.inliers, ~bad)
    A = found.A * MAPS[model][2, 2] / found.A[2, 2]
    np.testing.assert_allclose(A, MAPS[model], atol=1e-8)
    np.testing.assert_allclose(found.A @ found.A_inverse, np.eye(3), atol=1e-9)
    assert found.has_converged


@pytest.mark.parametrize("model", MODELS)
def test_auto_takes_the_model_of_the_pairs(model):
    taken = []
    for seed in range(10):
        lidar, depth, _ = pairs_of(room_curve(), MAPS[model], seed)
        taken.append(register(lidar, depth, RegistrationSettings()).model)
    assert taken.count(model) >= 9, taken


@pytest.mark.parametrize("model", MODELS)
@given(turn_rad=st.floats(-3.0, 3.0), x_m=st.floats(-3.0, 3.0), z_m=st.floats(-3.0, 3.0))
@settings(max_examples=20)
def test_a_rigid_motion_of_the_depth_points_moves_the_map(model, turn_rad, x_m, z_m):
    lidar, depth, _ = pairs_of(room_curve(), MAPS[model], 2)
    cosine, sine = np.cos(turn_rad), np.sin(turn_rad)
    motion = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [x_m, z_m, 1.0]])
    chosen = RegistrationSettings(model=model)
    found = register(lidar, depth, chosen)
    moved = register(lidar, apply_transform(motion, depth), chosen)
    np.testing.assert_array_equal(moved.inliers, found.inliers)
    np.testing.assert_allclose(moved.A, found.A @ motion, atol=1e-6)
    assert moved.mean_error_m == pytest.approx(found.mean_error_m, abs=1e-6)


@pytest.mark.parametrize("model", MODELS)
@given(seed=st.integers(0, 10_000))
@settings(max_examples=20)
def test_the_order_of_the_pairs_does_not_matter_for_given_draws(model, seed):
    lidar, depth, _ = pairs_of(room_curve(60), MAPS[model], 4)
    order = np.random.default_rng(seed).permutation(60)
    samples = draw_samples(60, 6, 20, (seed, 0))
    A, agree = evaluate_samples(model, lidar, depth, samples, 0.1)
    position = np.argsort(order)
    A_moved, agree_moved = evaluate_samples(
        model, lidar[order], depth[order], position[samples], 0.1
    )
    np.testing.assert_array_equal(A_moved, A)
    np.testing.assert_array_equal(agree_moved, agree[:, order])


def test_swapping_the_sides_inverts_a_rigid_map():
    lidar, depth, _ = pairs_of(room_curve(), RIGID, 6)
    there = register(lidar, depth, RegistrationSettings(model="rigid"))
    back = register(depth, lidar, RegistrationSettings(model="rigid"))
    np.testing.assert_array_equal(there.inliers, back.inliers)
    np.testing.assert_allclose(back.A, there.A_inverse, atol=1e-9)


def test_quality_equals_its_definition():
    lidar, depth, good = pairs_of(room_curve(), RIGID, 8)
    lidar[[5, 60]] = np.nan
    depth[[7, 60], 1] = np.nan
    found = register(lidar, depth, RegistrationSettings(model="affine"))
    lengths = {}
    for i in range(len(lidar)):
        if not (np.isnan(lidar[i]).any() or np.isnan(depth[i]).any()):
            lengths[i] = np.linalg.norm((np.array([*lidar[i], 1.0]) @ found.A)[:2] - depth[i])
    assert found.valid == len(lengths) == 177
    assert found.mean_error_m == pytest.approx(np.mean(list(lengths.values())))
    assert np.isnan(found.residual_m[[5, 7, 60]]).all()
    assert not found.inliers[[5, 7, 60]].any()
    np.testing.assert_allclose(found.residual_m[list(lengths)], list(lengths.values()))
    # A few far pairs fall within the threshold by chance.
    assert (found.inliers & ~good).sum() <= 4
    # 0.01 m in D and a quarter of it in L.
    assert found.sigma_m == pytest.approx(0.0103, rel=0.2)


@pytest.mark.parametrize("model", MODELS)
def test_the_covariance_is_honest(model):
    """Mean NEES over 400 trials within the 95 % interval of chi-square."""
    curve, trials = room_curve(100), 400
    probes = np.array([[-1.5, 1.5], [1.5, 1.5], [-0.5, 3.0], [1.0, 2.5]])
    truth = apply_transform(MAPS[model], probes)
    nees, errors, sds, back_errors, back_sds = [], [], [], [], []
    chosen = RegistrationSettings(model=model, stopping="fixed", draws=20)
    for seed in range(trials):
        rng = np.random.default_rng(10_000 + seed)
        depth = apply_transform(MAPS[model], curve) + rng.normal(0.0, 0.01, curve.shape)
        found = register(curve, depth, chosen)
        images, sd_m = found.predict(probes)
        jacobian = approx_fprime(
            found.A.ravel(), lambda a: apply_transform(a.reshape(3, 3), probes).ravel(), 1e-7
        )
        error = (images - truth).ravel()
        joint = jacobian @ found.covariance @ jacobian.T
        nees.append(error @ np.linalg.pinv(joint, rtol=1e-4, hermitian=True) @ error)
        errors.append(np.sum((images - truth) ** 2, axis=1))
        sds.append(sd_m**2)
        back, back_sd_m = found.predict_inverse(truth)
        back_errors.append(np.sum((back - probes) ** 2, axis=1))
        back_sds.append(back_sd_m**2)
    freedom = PARAMETERS[model]
    low, high = chi2.ppf([0.025, 0.975], freedom * trials) / trials
    assert low < np.mean(nees) < high
    np.testing.assert_allclose(np.mean(errors, axis=0), np.mean(sds, axis=0), rtol=0.2)
    np.testing.assert_allclose(np.mean(back_errors, axis=0), np.mean(back_sds, axis=0), rtol=0.2)


@pytest.mark.parametrize("model", MODELS)
def test_refits_end_where_the_inliers_support_themselves(model):
    refits = []
    for seed in range(10):
        lidar, depth, _ = pairs_of(room_curve(), MAPS[model], seed, outliers=0.5, sigma_m=0.03)
        found = register(lidar, depth, RegistrationSettings(model=model))
        assert found.has_converged
        np.testing.assert_array_equal(found.inliers, found.residual_m <= 0.10)
        np.testing.assert_allclose(
            found.A, fit_transform(model, lidar[found.inliers], depth[found.inliers]).A, atol=1e-9
        )
        refits.append(found.refits)
    assert max(refits) > 1
    once = RegistrationSettings(model=model, refits_max=1)
    lidar, depth, _ = pairs_of(
        room_curve(), MAPS[model], int(np.argmax(refits)), outliers=0.5, sigma_m=0.03
    )
    assert not register(lidar, depth, once).has_converged


def test_the_covariance_of_a_rigid_map_has_no_scale():
    """The area of a rigid map is certain, and not that of a similarity: gradient of det A."""
    turn = np.array(
        [[np.cos(0.8), np.sin(0.8), 0.0], [-np.sin(0.8), np.cos(0.8), 0.0], [0.2, 0.1, 1.0]]
    )
    lidar, depth, _ = pairs_of(room_curve(), turn, 0)
    variances = {}
    for model in ("rigid", "similarity"):
        found = register(lidar, depth, RegistrationSettings(model=model))
        gradient = approx_fprime(
            found.A.ravel(), lambda a: np.linalg.det(a.reshape(3, 3)[:2, :2]), 1e-7
        )
        variances[model] = gradient @ found.covariance @ gradient
    assert variances["rigid"] < 1e-6 * variances["similarity"]


@pytest.mark.parametrize("model", ["affine", "homography"])
def test_the_inverse_propagates_the_uncertainty_through_a_sheared_map(model):
    shear = np.array([[1.6, 0.9, 0.0], [-0.1, 0.6, 0.02], [0.0, 0.0, 1.0]])
    if model == "affine":
        shear[:2, 2] = 0.0
    lidar, depth, _ = pairs_of(room_curve(), shear, 0)
    found = register(lidar, depth, RegistrationSettings(model=model, guards=False))
    for point in apply_transform(shear, np.array([[-1.5, 1.5], [0.5, 3.0]])):

        def back(entries, point=point):
            return apply_transform(np.linalg.inv(entries.reshape(3, 3)), point[None])[0]

        jacobian = approx_fprime(found.A.ravel(), back, 1e-7)
        expected = np.sqrt(np.trace(jacobian @ found.covariance @ jacobian.T))
        image, sd_m = found.predict_inverse(point[None])
        np.testing.assert_allclose(image[0], back(found.A.ravel()))
        assert sd_m[0] == pytest.approx(expected, rel=1e-4)


def test_prediction_of_a_missing_point_is_missing():
    lidar, depth, _ = pairs_of(room_curve(), RIGID, 8)
    found = register(lidar, depth, RegistrationSettings())
    for predicted in (found.predict, found.predict_inverse):
        image, sd_m = predicted(np.array([[np.nan, np.nan], [0.0, 2.0]]))
        assert np.isnan(image[0]).all()
        assert np.isnan(sd_m[0])
        assert np.isfinite(image[1]).all()
        assert 0.0 < sd_m[1] < 0.01


@pytest.mark.parametrize("seed", range(10))
def test_on_a_plain_wall_repairs_stay_bounded(seed):
    curve = wall_curve()
    lidar, depth, _ = pairs_of(curve, RIGID, seed, outliers=0.3)
    found = register(lidar, depth, RegistrationSettings())
    assert found.model in ("rigid", "similarity")
    repaired, sd_m = found.predict_inverse(apply_transform(RIGID, curve))
    assert np.linalg.norm(repaired - curve, axis=1).max() < 0.02
    assert sd_m.max() < 0.02
    # A point in front of the wall, where nothing held the map.
    repaired, _ = found.predict_inverse(apply_transform(RIGID, np.array([[0.3, 1.0]])))
    assert np.linalg.norm(repaired - [[0.3, 1.0]]) < 0.05


@pytest.mark.parametrize("seed", range(10))
def test_an_affine_map_on_a_plain_wall_is_refused(seed):
    lidar, depth, _ = pairs_of(wall_curve(), RIGID, seed, outliers=0.3)
    with pytest.raises(RegistrationFailed, match=r"affine: .*\d+ inliers of 120 valid pairs"):
        register(lidar, depth, RegistrationSettings(model="affine"))


def test_published_goes_wrong_on_a_plain_wall_as_the_paper_does():
    probe = np.array([[0.3, 1.0]])
    worst = 0.0
    for seed in range(10):
        lidar, depth, _ = pairs_of(wall_curve(), RIGID, seed, outliers=0.3)
        found = register(lidar, depth, PUBLISHED)
        assert found.model == "affine"
        assert len(found.draws) == 84
        repaired, _ = found.predict_inverse(apply_transform(RIGID, probe))
        worst = max(worst, float(np.linalg.norm(repaired - probe)))
    assert worst > 0.5


@pytest.mark.parametrize("chosen", [PUBLISHED, RegistrationSettings(model="affine")])
def test_collinear_pairs_are_refused_with_their_number(chosen):
    curve = wall_curve()
    with pytest.raises(RegistrationFailed, match="all 120 valid pairs lie on a line"):
        register(curve, apply_transform(RIGID, curve), chosen)


def test_collinear_images_have_no_inverse():
    curve = room_curve()
    with pytest.raises(RegistrationFailed, match="no inverse: the images of its 180 inliers"):
        register(curve, curve * [1.0, 0.0] + [0.0, 2.0], PUBLISHED)


def test_coinciding_pairs_are_refused():
    same = np.tile([1.0, 2.0], (30, 1))
    with pytest.raises(
        RegistrationFailed, match="rigid: all 30 valid pairs lie on a line or a point"
    ):
        register(same, same, RegistrationSettings())


def test_too_few_pairs_are_counted():
    lidar, depth, _ = pairs_of(room_curve(), RIGID, 0)
    lidar[11:] = np.nan
    with pytest.raises(RegistrationFailed, match="11 of 180 pairs are valid on both sides; 12"):
        register(lidar, depth, RegistrationSettings())
    lidar[5:] = np.nan
    with pytest.raises(RegistrationFailed, match="5 of 180 pairs are valid on both sides; 6"):
        register(lidar, depth, PUBLISHED)


def test_pairs_without_consensus_are_refused():
    rng = np.random.default_rng(0)
    lidar, depth = rng.uniform(-20.0, 20.0, (2, 180, 2))
    with pytest.raises(RegistrationFailed, match=r"rigid: \d+ of 180 valid pairs agree, 12"):
        register(lidar, depth, RegistrationSettings())


@pytest.mark.parametrize(
    ("distortion", "reason"),
    [
        (np.diag([-1.0, 1.0, 1.0]), "mirrors"),
        (np.diag([1.4, 1.4, 1.0]), "scales"),
        (np.diag([0.7, 0.7, 1.0]), "scales"),
        (np.diag([1.2, 0.9, 1.0]), "stretches"),
    ],
)
def test_a_map_that_distorts_is_refused_unless_the_guards_are_off(distortion, reason):
    lidar, depth, _ = pairs_of(room_curve(), distortion @ RIGID, 1)
    with pytest.raises(RegistrationFailed, match=reason):
        register(lidar, depth, RegistrationSettings(model="affine"))
    found = register(lidar, depth, PUBLISHED)
    np.testing.assert_allclose(found.A, distortion @ RIGID, atol=0.02)


def test_auto_says_which_models_it_refused():
    lidar, depth, _ = pairs_of(wall_curve(), RIGID, 0, outliers=0.3)
    found = register(lidar, depth, RegistrationSettings())
    assert {refusal.model for refusal in found.rejected} == {"affine", "homography"}


def test_a_homography_that_hides_valid_pairs_is_refused():
    curve = room_curve()
    horizon = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -0.05], [0.0, 0.0, 1.05]])
    depth = apply_transform(horizon, curve)
    lidar = np.vstack([curve, [[0.0, 30.0]]])
    depth = np.vstack([depth, [[0.0, 3.0]]])
    chosen = RegistrationSettings(model="homography", scale_max=2.0, anisotropy_max=2.0)
    with pytest.raises(RegistrationFailed, match="horizon leaves 1 of 181"):
        register(lidar, depth, chosen)
    unguarded = register(lidar, depth, RegistrationSettings(model="homography", guards=False))
    assert unguarded.mean_error_m == np.inf


def test_the_same_input_gives_the_same_bytes_and_is_left_alone():
    lidar, depth, _ = pairs_of(room_curve(), RIGID, 3)
    before = lidar.tobytes(), depth.tobytes()
    first = register(lidar, depth, RegistrationSettings(seed=4))
    second = register(lidar, depth, RegistrationSettings(seed=4))
    other = register(lidar, depth, RegistrationSettings(seed=5))
    assert (lidar.tobytes(), depth.tobytes()) == before
    assert lidar.flags.writeable
    for name in ("A", "A_inverse", "inliers", "residual_m", "covariance"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
        assert not getattr(first, name).flags.writeable
    assert first.draws[0].pairs.tobytes() == second.draws[0].pairs.tobytes()
    assert first.draws[0].pairs.tobytes() != other.draws[0].pairs.tobytes()


def test_adaptive_draws_follow_the_inlier_ratio():
    made = []
    for outliers in (0.1, 0.5):
        lidar, depth, _ = pairs_of(room_curve(), RIGID, 3, outliers)
        made.append(len(register(lidar, depth, RegistrationSettings(model="rigid")).draws))
    assert made[0] == 84
    assert made[1] > 250


def test_a_sample_must_determine_the_model():
    RegistrationSettings(model="rigid", sample_size=2)
    with pytest.raises(ValidationError, match="at least 4 for the model auto"):
        RegistrationSettings(sample_size=3)
    with pytest.raises(ValidationError, match="at least 3 for the model affine"):
        RegistrationSettings(model="affine", sample_size=2)


def test_shapes_are_checked():
    with pytest.raises(ValueError, match=r"pairs must be \(m, 2\)"):
        register(np.zeros((5, 2)), np.zeros((4, 2)), RegistrationSettings())
