"""Draws shown again, pairs in the plane, residuals along the curve, epsilon in its units."""

from types import SimpleNamespace

import numpy as np
import pytest

from fusion_core.denoising.noise_scale import NoiseScale
from fusion_core.model.classes import NoiseClass
from fusion_core.registration.models import apply_transform
from fusion_core.registration.ransac import RegistrationSettings, register
from fusion_core.workflows.fuse.epsilon import (
    EPSILON_UNITS,
    convert_epsilon,
    measure_epsilon,
    unit_lengths_m,
)
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.registration_details import (
    consensus_probabilities,
    decompose_registration,
    draw_at,
    planar_pairs,
    residual_curve,
)


def registered(model="rigid", **values):
    """A corner of which every third pair is off, and its registration."""
    rng = np.random.default_rng(4)
    along = np.linspace(-1.5, 1.5, 90)
    lidar_m = np.stack([along, 3.0 - np.abs(along)], axis=1) + rng.normal(0.0, 0.01, (90, 2))
    depth_m = lidar_m + np.array([0.02, 0.01])
    depth_m[::3] += rng.uniform(0.3, 1.0, (30, 2))
    depth_m[5] = np.nan
    settings = RegistrationSettings(model=model, draws=60, stopping="fixed", **values)
    return register(lidar_m, depth_m, settings)


def test_each_draw_is_that_of_the_registration():
    found = registered()
    counts = []
    for index, draw in enumerate(found.draws):
        shown = draw_at(found, index)
        assert shown.index == index
        np.testing.assert_array_equal(shown.pairs, draw.pairs)
        np.testing.assert_array_equal(shown.A, draw.A)
        np.testing.assert_array_equal(shown.is_inlier, draw.is_inlier)
        assert shown.inliers == draw.inliers
        counts.append(shown.inliers)
    assert counts[found.best_draw] == max(counts)


def test_the_best_draws_inliers_are_those_that_the_refits_began_with():
    found = registered(refits_max=1)
    best = draw_at(found, found.best_draw)
    np.testing.assert_array_equal(best.is_inlier, found.inliers)
    np.testing.assert_array_equal(
        best.mapped_m, apply_transform(best.A, found.draws.lidar_points_m)
    )


@pytest.mark.parametrize("index", [60, -61])
def test_there_is_no_other_draw(index):
    with pytest.raises(IndexError):
        draw_at(registered(), index)


def test_the_consensus_is_the_papers_formula():
    found = registered()
    c = found.inliers.sum() / 89
    consensus = consensus_probabilities(found)
    assert consensus.inlier_fraction == pytest.approx(c)
    assert consensus.clean_probability == pytest.approx(c**6)
    assert consensus.any_clean_probability == pytest.approx(1.0 - (1.0 - c**6) ** 60)


def test_pairs_before_and_after_are_those_of_the_registration():
    found = registered()
    pairs = planar_pairs(SimpleNamespace(registration=found))
    before_m = np.linalg.norm(pairs.lidar_m - pairs.depth_m, axis=1)
    after_m = np.linalg.norm(pairs.mapped_m - pairs.depth_m, axis=1)
    np.testing.assert_allclose(after_m, found.residual_m)
    assert np.median(after_m[pairs.inliers]) < np.median(before_m[pairs.inliers])
    np.testing.assert_allclose(
        decompose_registration(found).displacement_m, (0.02, 0.01), atol=0.01
    )


def test_without_a_map_the_points_are_there():
    azimuth_rad = np.array([0.1, 0.0, -0.1])
    pairs = SimpleNamespace(
        azimuth_rad=azimuth_rad,
        lidar_range_m=np.array([2.0, 2.0, np.nan]),
        depth_as_range_m=np.full(3, 2.5),
    )
    plane = planar_pairs(SimpleNamespace(registration=None, correspondence=pairs))
    assert plane.mapped_m is None
    np.testing.assert_allclose(plane.lidar_m[1], (0.0, 2.0))
    # The beam of greater azimuth is on the left.
    assert plane.depth_m[0, 0] < 0.0 < plane.depth_m[2, 0]
    assert np.isnan(plane.lidar_m[2]).all()


def frame(azimuth_rad, residual_m, *, lidar_class=None, depth_class=None, epsilon_m=0.1, E_m=0.04):
    good = np.full(len(azimuth_rad), int(NoiseClass.GOOD))
    epsilon = np.full(len(azimuth_rad), epsilon_m)
    residual = np.array(residual_m)
    return FusedFrame(
        match=SimpleNamespace(
            correspondence=SimpleNamespace(
                azimuth_rad=np.array(azimuth_rad),
                residual_m=residual,
                lidar_range_m=np.full(len(azimuth_rad), 2.0),
            ),
            registration=None if E_m is None else SimpleNamespace(mean_error_m=E_m),
        ),
        classes=SimpleNamespace(
            lidar_class=good if lidar_class is None else np.array(lidar_class),
            depth_class=good if depth_class is None else np.array(depth_class),
            epsilon_m=epsilon,
        ),
        repair=None,
        camera_range_m=None,
    )


def test_residuals_rise_in_azimuth_and_leave_missing_ones_out():
    curve = residual_curve(
        frame(
            [0.2, 0.1, 0.0, -0.1],
            [0.01, np.nan, -0.3, 0.02],
            lidar_class=[0, 1, 2, 3],
            depth_class=[0, 0, 0, 3],
        )
    )
    np.testing.assert_allclose(curve.azimuth_deg, np.rad2deg([-0.1, 0.0, 0.2]))
    np.testing.assert_allclose(curve.residual_mm, [20.0, -300.0, 10.0])
    np.testing.assert_allclose(curve.epsilon_mm, 100.0)
    assert curve.pair_class.tolist() == [NoiseClass.CONFLICT, NoiseClass.BURR, NoiseClass.GOOD]


def test_a_curve_across_the_scans_seam_stays_in_one_piece():
    curve = residual_curve(frame([3.1, 3.14, -3.12, -3.08], [0.0, 0.1, 0.2, 0.3]))
    np.testing.assert_allclose(curve.residual_mm, [0.0, 100.0, 200.0, 300.0])
    assert np.ptp(curve.azimuth_deg) < 10.0


LENGTHS_M = {"sigma": 0.038, "E": 0.061, "m": 1.0}


@pytest.mark.parametrize("old", EPSILON_UNITS)
@pytest.mark.parametrize("new", EPSILON_UNITS)
def test_a_unit_and_back_is_the_same_length(old, new):
    there = convert_epsilon(2.6, old, new, LENGTHS_M)
    assert there * LENGTHS_M[new] == pytest.approx(2.6 * LENGTHS_M[old])
    assert convert_epsilon(there, new, old, LENGTHS_M) == pytest.approx(2.6)


def test_a_unit_without_a_length_has_its_usual_value():
    assert convert_epsilon(2.6, "sigma", "E", {"sigma": 0.038, "m": 1.0}) == 1.2
    assert convert_epsilon(1.2, "E", "sigma", {"sigma": 0.038, "m": 1.0}) == 2.6


def test_lengths_of_the_units():
    alignment = SimpleNamespace(scale=NoiseScale(floor_m=0.0, fraction=0.02))
    match = frame([0.1, 0.0], [0.01, np.nan]).match
    assert unit_lengths_m(match, alignment) == {"m": 1.0, "E": 0.04, "sigma": 0.04}
    nothing = frame([0.1], [np.nan], E_m=None).match
    assert unit_lengths_m(nothing, alignment) == {"m": 1.0}
    assert "E" not in unit_lengths_m(frame([0.1], [0.0], E_m=np.inf).match, alignment)


def test_epsilon_in_a_frame_counts_what_lies_beyond():
    said = measure_epsilon(frame([0.2, 0.1, 0.0, -0.1], [0.05, -0.2, np.nan, 0.1]))
    assert (said.beyond, said.compared) == (1, 3)
    assert said.band_m == pytest.approx((0.04, 0.04 * np.sqrt(2.0)))
    assert np.isnan(measure_epsilon(frame([0.2], [0.0], E_m=None)).band_m).all()
