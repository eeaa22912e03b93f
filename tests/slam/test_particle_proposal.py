"""The proposal in a simulated room against sums over a fine grid of poses."""

import numpy as np
import pytest

from fusion_core.model.planar_poses import compose_poses, transform_planar_points
from fusion_core.slam.particle_maps import OCCUPANCY, add_scan
from fusion_core.slam.particle_proposal import MotionModel, log_likelihoods, propose
from fusion_core.slam.scan_to_grid import INFORMATION_OF_A_SCAN, LatticeSearch, ProbabilityGrid
from tests.benchmarks.scan_matching_room import WALLS, cast, rectangle

RESOLUTION_M = 0.05
CORNER_M = (-1.0, -1.0)
MOTION = MotionModel(sigma_m=0.04, sigma_rad=0.02)
TRUTH = np.array([5.6, 4.1, 0.3])
SEARCH = LatticeSearch(translation_m=0.15, rotation_rad=0.06, prior_weight=(1.0, 1.0))
CORRIDOR = rectangle((5.5, 4.0), (400.0, 2.0), 0.0)


def in_place(cells):
    return ProbabilityGrid(cells, CORNER_M, RESOLUTION_M)


def points_of(walls, pose, rng, beams=180, half_widths_m=20.0):
    angles_rad = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    ranges_m, _ = cast(walls, pose, angles_rad)
    ranges_m = ranges_m + rng.normal(0.0, 0.015, beams)
    seen = ranges_m < half_widths_m
    ranges_m, angles_rad = ranges_m[seen], angles_rad[seen]
    return np.stack([ranges_m * np.cos(angles_rad), ranges_m * np.sin(angles_rad)], axis=1)


def map_of(walls, rng, half_widths_m=20.0):
    """Occupancy from ten scans about the truth."""
    cells = np.zeros((240, 280), dtype=np.uint8)
    for _ in range(10):
        pose = compose_poses(TRUTH, rng.normal(0.0, [0.3, 0.3, 0.5]))
        ends = (
            transform_planar_points(pose, points_of(walls, pose, rng, 720, half_widths_m))
            - CORNER_M
        ) / (RESOLUTION_M)
        add_scan(cells, (pose[:2] - CORNER_M) / RESOLUTION_M, ends, ends)
    return OCCUPANCY[cells]


@pytest.fixture(scope="module")
def room():
    return map_of(WALLS, np.random.default_rng(1))


def proposed(occupancy, points_m, predicted, motion=MOTION, occupancy_min=0.3):
    return propose(
        in_place(occupancy),
        points_m,
        predicted,
        motion,
        search=SEARCH,
        occupancy_min=occupancy_min,
    )


def brute_force(occupancy, points_m, predicted, motion, centre, half_widths, count=31):
    """Mean, covariance and log of the integral over a box, by the midpoint rule."""
    axes = [c + np.linspace(-r, r, count) for c, r in zip(centre, half_widths, strict=True)]
    poses = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    sigmas = np.array([motion.sigma_m, motion.sigma_m, motion.sigma_rad])
    log = log_likelihoods(in_place(occupancy), points_m, poses)
    log -= 0.5 * (((poses - predicted) / sigmas) ** 2).sum(axis=1)
    log -= np.log((2.0 * np.pi) ** 1.5 * sigmas.prod())
    weights = np.exp(log - log.max())
    mean = weights @ poses / weights.sum()
    covariance = np.cov(poses.T, aweights=weights, ddof=0)
    cell = np.prod([axis[1] - axis[0] for axis in axes])
    return mean, covariance, log.max() + np.log(weights.sum() * cell)


@pytest.mark.parametrize("seed", range(4))
def test_mean_covariance_and_weight_are_the_integrals(room, seed):
    rng = np.random.default_rng(10 + seed)
    points_m = points_of(WALLS, TRUTH, rng)
    predicted = TRUTH + rng.normal(0.0, [0.04, 0.04, 0.02])
    found = proposed(room, points_m, predicted)
    half_widths = 4.5 * np.sqrt(np.diag(found.covariance))
    mean, covariance, log_evidence = brute_force(
        room, points_m[::2], predicted, MOTION, found.mean, half_widths
    )
    sigmas = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.mean / sigmas, mean / sigmas, atol=0.15)
    np.testing.assert_allclose(
        found.covariance / np.outer(sigmas, sigmas), covariance / np.outer(sigmas, sigmas), atol=0.2
    )
    assert found.log_evidence == pytest.approx(log_evidence, abs=0.15)
    # The scan is far more informative than the motion model.
    assert (sigmas < 0.6 * np.array([MOTION.sigma_m, MOTION.sigma_m, MOTION.sigma_rad])).all()
    assert np.hypot(*(found.mean - TRUTH)[:2]) < 0.03
    assert abs(found.mean[2] - TRUTH[2]) < 0.01


def keys(distance):
    """Keys' kernel of 1981 with a = -1/2."""
    t = np.abs(distance)
    near = 1.5 * t**3 - 2.5 * t**2 + 1.0
    far = -0.5 * t**3 + 2.5 * t**2 - 4.0 * t + 2.0
    return np.where(t < 1.0, near, np.where(t < 2.0, far, 0.0))


def test_the_likelihood_is_as_defined(room):
    rng = np.random.default_rng(3)
    points_m = points_of(WALLS, TRUTH, rng)
    poses = TRUTH + rng.normal(0.0, [0.05, 0.05, 0.02], (20, 3))
    found = log_likelihoods(in_place(room), points_m, poses)
    for pose, value in zip(poses, found, strict=True):
        at = (transform_planar_points(pose, points_m) - CORNER_M) / RESOLUTION_M - 0.5
        along_y = keys(at[:, 1:] - np.arange(room.shape[0]))
        along_x = keys(at[:, :1] - np.arange(room.shape[1]))
        field = ((along_y @ room) * along_x).sum(axis=1) / 255.0
        expected = -0.5 * INFORMATION_OF_A_SCAN * ((1.0 - field) ** 2).mean()
        assert value == pytest.approx(expected, rel=1e-9)


def test_the_better_the_prediction_the_greater_the_weight(room):
    points_m = points_of(WALLS, TRUTH, np.random.default_rng(7))
    evidence = [
        proposed(room, points_m, TRUTH + np.array([off_m, 0.0, 0.0])).log_evidence
        for off_m in (0.0, 0.06, 0.12)
    ]
    assert evidence[0] > evidence[1] > evidence[2]
    # Between two predictions the motion model alone differs.
    sigma_m = MOTION.sigma_m
    assert evidence[0] - evidence[2] == pytest.approx(0.5 * (0.12 / sigma_m) ** 2, rel=0.3)


def test_along_a_corridor_the_motion_model_decides():
    rng = np.random.default_rng(2)
    corridor = map_of(CORRIDOR, rng, 5.0)
    pose = np.array([5.6, 4.1, 0.0])
    points_m = points_of(CORRIDOR, pose, rng, half_widths_m=4.0)
    found = proposed(corridor, points_m, pose + np.array([0.05, 0.03, 0.01]))
    sigmas = np.sqrt(np.diag(found.covariance))
    assert sigmas[0] > 0.8 * MOTION.sigma_m
    assert sigmas[1] < 0.4 * MOTION.sigma_m
    assert found.mean[0] - pose[0] == pytest.approx(0.05, abs=0.025)
    assert abs(found.mean[1] - pose[1]) < 0.015


def test_no_match_gives_no_proposal(room):
    rng = np.random.default_rng(8)
    points_m = points_of(WALLS, TRUTH, rng)
    assert proposed(np.zeros_like(room), points_m, TRUTH) is None
    assert proposed(room, points_m + np.array([0.0, 0.7]), TRUTH, occupancy_min=0.6) is None
    assert proposed(room, points_m, TRUTH) is not None
