"""Mounting and planes together: exact on exact data, honest on noisy data."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from fusion_core.calibration.turning.plane_bundle import solve_bundle
from tests.calibration.box_turns import ON_ITS_SIDE, ROOM, SOMEWHERE, make_turn

NORMALS = np.array([normal for normal, _ in ROOM])
OFFSETS = np.array([offset for _, offset in ROOM])


def members(turn):
    cloud = turn.in_rig(SOMEWHERE)
    return np.abs(cloud @ NORMALS.T - OFFSETS).argmin(axis=1)


@pytest.mark.parametrize("lever", [0.0, 0.2])
def test_exact_points_give_the_truth_from_a_poor_start(lever):
    nominal = ON_ITS_SIDE.copy()
    nominal[:3, 3] = [lever, -lever, 0.3]
    turn = make_turn(scans=40, nominal=nominal)
    solution = solve_bundle(turn, members(turn), np.zeros(4), NORMALS, OFFSETS + 0.02)
    assert solution.converged
    np.testing.assert_allclose(solution.parameters, SOMEWHERE, atol=1e-8)
    np.testing.assert_allclose(solution.normals, NORMALS, atol=1e-7)
    np.testing.assert_allclose(solution.offsets_m, OFFSETS, atol=1e-7)


def test_the_estimate_has_no_bias_and_an_honest_covariance():
    """Over draws of noise: 10 cm in a small room, where derivatives at the measured points instead
    of where the beams meet their planes would move θ by 1.2 deviations, each time."""
    exact = make_turn([(normal, 0.5 * offset) for normal, offset in ROOM], scans=40, columns=24)
    offsets = 0.5 * OFFSETS
    plane_of = np.abs(exact.in_rig(SOMEWHERE) @ NORMALS.T - offsets).argmin(axis=1)
    rng = np.random.default_rng(0)
    rays = exact.points_in_lidar_m / np.linalg.norm(exact.points_in_lidar_m, axis=1)[:, np.newaxis]
    draws, errors, normalised = 40, [], []
    for _ in range(draws):
        noise_m = 0.1 * rng.standard_normal((len(rays), 1))
        turn = replace(exact, points_in_lidar_m=exact.points_in_lidar_m + noise_m * rays)
        solution = solve_bundle(turn, plane_of, SOMEWHERE, NORMALS, offsets)
        error = solution.parameters - SOMEWHERE
        errors.append(error / np.sqrt(np.diag(solution.covariance)))
        normalised.append(error @ np.linalg.solve(solution.covariance, error))
    assert np.abs(np.mean(errors, axis=0)).max() < 3.5 / np.sqrt(draws)
    low, high = chi2.ppf([0.005, 0.995], 4 * draws) / draws
    assert low < np.mean(normalised) < high


def test_few_steps_from_far_away():
    """With a wrong derivative the steps would end in the same place, but many."""
    parameters = np.array([0.5, 0.4, 0.05, -0.05])
    turn = make_turn(scans=40, parameters=parameters)
    plane_of = np.abs(turn.in_rig(parameters) @ NORMALS.T - OFFSETS).argmin(axis=1)
    start = parameters + np.array([0.02, -0.02, 0.01, 0.01])
    solution = solve_bundle(turn, plane_of, start, NORMALS, OFFSETS, iterations_max=4)
    np.testing.assert_allclose(solution.parameters, parameters, atol=1e-9)


def test_what_lies_off_the_planes_weighs_nothing():
    turn = make_turn(scans=60, sigma_m=0.01)
    points = turn.points_in_lidar_m.copy()
    points[::20] *= 0.93
    spoilt = replace(turn, points_in_lidar_m=points)
    clean = solve_bundle(turn, members(turn), SOMEWHERE, NORMALS, OFFSETS)
    solution = solve_bundle(spoilt, members(turn), SOMEWHERE, NORMALS, OFFSETS)
    deviations = np.sqrt(np.diag(clean.covariance))
    assert (np.abs(solution.parameters - clean.parameters) < 3.0 * deviations).all()


def test_a_floor_alone_says_nothing_of_the_offset():
    turn = make_turn([ROOM[0]], scans=40)
    none = np.zeros(len(turn.points_in_lidar_m), dtype=np.int64)
    solution = solve_bundle(turn, none, SOMEWHERE, NORMALS[:1], OFFSETS[:1])
    assert np.isnan(solution.covariance).all()
