"""Local bundle adjustment against scipy's least squares, and against gtsam."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from fusion_core.model.geometry import invert_transform, make_transform, transform_points
from fusion_core.slam.visual.bundle_adjustment import BundleProblem, adjust_bundle
from fusion_core.slam.visual.global_adjustment import adjust_sparse
from fusion_core.slam.visual.keyframes import DepthAlignment
from fusion_core.slam.visual.pose_optimisation import exp_se3

CAMERA = np.array([525.0, 525.0, 319.5, 239.5])
DEPTH_SIGMA = 0.003


def problem(rng, keyframes=4, landmarks=40, pixel_sigma=0.5, spoil=0.0):
    """Keyframes before a cloud of landmarks, disturbed; the first is fixed."""
    truth = [
        invert_transform(
            make_transform(
                np.asarray(cv2.Rodrigues(np.array([0.0, 0.05 * k, 0.02 * k]))[0], float),
                np.array([0.2 * k, 0.02 * k, 0.05 * k]),
            )
        )
        for k in range(keyframes)
    ]
    points = rng.uniform([-1.0, -0.8, 2.0], [1.0, 0.8, 4.0], (landmarks, 3))
    k, m = (index.ravel() for index in np.mgrid[:keyframes, :landmarks])
    seen = rng.uniform(size=len(k)) < 0.8
    k, m = k[seen], m[seen]
    p = np.stack(
        [T[:3, :3] @ x + T[:3, 3] for T, x in zip([truth[i] for i in k], points[m], strict=True)]
    )
    pixels = p[:, :2] / p[:, 2:] * CAMERA[:2] + CAMERA[2:]
    pixels += rng.normal(0.0, pixel_sigma, pixels.shape)
    pixels[rng.uniform(size=len(k)) < spoil] += 40.0
    depths = 1.0 / (1.0 / p[:, 2] + rng.normal(0.0, DEPTH_SIGMA, len(k)))
    depths[rng.uniform(size=len(k)) < 0.3] = np.nan
    disturbed = [truth[0], *(exp_se3(rng.normal(0.0, 0.01, 6)) @ T for T in truth[1:])]
    return (
        np.stack(truth),
        points,
        BundleProblem(
            T_camera_map=np.stack(disturbed),
            is_fixed=np.arange(keyframes) == 0,
            points_in_map_m=points + rng.normal(0.0, 0.03, points.shape),
            keyframes=k,
            landmarks=m,
            pixels=pixels,
            depths_m=depths,
            pixel_sigmas=np.ones(len(k)),
            camera=CAMERA,
            depth_sigma_per_m2=DEPTH_SIGMA,
        ),
    )


def residuals(poses, points, given, kept):
    p = np.einsum("oij,oj->oi", poses[given.keyframes, :3, :3], points[given.landmarks])
    p += poses[given.keyframes, :3, 3]
    uv = p[:, :2] / p[:, 2:] * CAMERA[:2] + CAMERA[2:]
    inverse = np.nan_to_num((1.0 / p[:, 2] - 1.0 / given.depths_m) / DEPTH_SIGMA)
    off = np.column_stack([(uv - given.pixels) / given.pixel_sigmas[:, None], inverse])
    return off[kept].ravel()


@pytest.mark.parametrize("seed", range(3))
def test_it_is_scipys_optimum(seed):
    _, _, given = problem(np.random.default_rng(seed))
    found = adjust_bundle(given, 30)
    kept = found.is_inlier
    assert kept.mean() > 0.97
    free = len(given.T_camera_map) - 1

    def unpacked(x):
        steps = x[: 6 * free].reshape(free, 6)
        moved = [exp_se3(s) @ T for s, T in zip(steps, given.T_camera_map[1:], strict=True)]
        return np.stack([given.T_camera_map[0], *moved]), x[6 * free :].reshape(-1, 3)

    best = least_squares(
        lambda x: residuals(*unpacked(x), given, kept),
        np.concatenate([np.zeros(6 * free), given.points_in_map_m.ravel()]),
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
    )
    poses, points = unpacked(best.x)
    ours = residuals(found.T_camera_map, found.points_in_map_m, given, kept)
    # Huber weighs the few inliers beyond its threshold in earlier rounds alone.
    assert 0.5 * (ours**2).sum() == pytest.approx(best.cost, rel=1e-3)
    np.testing.assert_allclose(found.T_camera_map, poses, atol=1e-3)
    np.testing.assert_allclose(found.points_in_map_m, points, atol=5e-3)
    np.testing.assert_array_equal(found.T_camera_map[0], given.T_camera_map[0])
    assert found.cost[1] < 0.1 * found.cost[0]


def test_outliers_are_told_apart():
    truth, _, given = problem(np.random.default_rng(7), landmarks=80, spoil=0.08)
    found = adjust_bundle(given, 20)
    moved = np.linalg.inv(truth) @ found.T_camera_map
    assert np.linalg.norm(moved[:, :3, 3], axis=1).max() < 0.01
    assert 0.85 < found.is_inlier.mean() < 0.95


def test_two_runs_give_the_same_bytes():
    _, _, given = problem(np.random.default_rng(2))
    first, second = adjust_bundle(given, 5), adjust_bundle(given, 5)
    assert first.T_camera_map.tobytes() == second.T_camera_map.tobytes()
    assert first.points_in_map_m.tobytes() == second.points_in_map_m.tobytes()


def test_landmarks_of_a_fixed_keyframe_are_where_their_depth_is():
    """One fixed keyframe with depth: each landmark by itself."""
    pixels = np.array([[319.5, 239.5], [419.5, 239.5]])
    given = BundleProblem(
        T_camera_map=np.eye(4)[np.newaxis].repeat(2, axis=0),
        is_fixed=np.array([True, False]),
        points_in_map_m=np.array([[0.1, 0.0, 1.9], [0.3, 0.1, 2.2]]),
        keyframes=np.array([0, 0, 1, 1]),
        landmarks=np.array([0, 1, 0, 1]),
        pixels=np.concatenate([pixels, pixels]),
        depths_m=np.full(4, 2.0),
        pixel_sigmas=np.ones(4),
        camera=CAMERA,
        depth_sigma_per_m2=DEPTH_SIGMA,
    )
    found = adjust_bundle(given, 50)
    expected = np.array([[0.0, 0.0, 2.0], [100.0 / 525.0 * 2.0, 0.0, 2.0]])
    np.testing.assert_allclose(found.points_in_map_m, expected, atol=1e-5)
    np.testing.assert_allclose(
        transform_points(found.T_camera_map[1], found.points_in_map_m), expected, atol=1e-5
    )


def aligned(truth, given, information):
    """With depth alignments that are off, of the first keyframe (fixed) and of others."""
    rng = np.random.default_rng(11)
    return replace(
        given,
        alignments=tuple(
            DepthAlignment(
                first=first,
                second=second,
                T_second_first=exp_se3(rng.normal(0.0, 0.003, 6))
                @ truth[second]
                @ invert_transform(truth[first]),
                information=information,
            )
            for first, second in ((1, 0), (2, 1), (1, 3))
        ),
    )


@pytest.mark.parametrize("seed", range(2))
def test_alignments_weigh_as_gtsams_between_factors(seed):
    rng = np.random.default_rng(seed)
    truth, _, given = problem(rng)
    root = rng.normal(size=(6, 6))
    given = aligned(truth, given, 1e5 * (root @ root.T + np.eye(6)))
    ours, theirs = adjust_bundle(given, 60, rounds=1), adjust_sparse(given, 60)
    assert ours.cost == pytest.approx(theirs.cost, rel=2e-3)
    np.testing.assert_allclose(ours.T_camera_map, theirs.T_camera_map, atol=2e-4)
    without = adjust_bundle(replace(given, alignments=()), 60, rounds=1)
    assert np.abs(without.T_camera_map - ours.T_camera_map).max() > 1e-3


def test_a_certain_alignment_is_kept_to():
    truth, _, given = problem(np.random.default_rng(3))
    given = aligned(truth, given, 1e12 * np.eye(6))
    found = adjust_bundle(given, 60).T_camera_map
    for a in given.alignments:
        said = found[a.second] @ invert_transform(found[a.first])
        np.testing.assert_allclose(said, a.T_second_first, atol=1e-5)


def test_nothing_fixed_is_refused():
    _, _, given = problem(np.random.default_rng(0))
    with pytest.raises(ValueError, match="fixed"):
        BundleProblem(
            **{
                name: getattr(given, name)
                for name in BundleProblem.__dataclass_fields__
                if name != "is_fixed"
            },
            is_fixed=np.zeros(4, np.bool_),
        )
