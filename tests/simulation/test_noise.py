"""The noise models against their own settings, and the kinds against the values."""

import numpy as np
import pytest

from fusion_core.model.classes import SAME_SURFACE_M, NoiseClass
from fusion_core.simulation import depth_camera, lidar
from fusion_core.simulation.depth_camera import DepthNoise
from fusion_core.simulation.lidar import LidarNoise
from tests.simulation.views import LIMITS, depth_view, lidar_view


@pytest.mark.parametrize(("true_m", "sigma"), [(0.5, 0.01), (1.0, 0.01), (3.0, 0.03), (5.0, 0.05)])
def test_good_ranges_have_the_sigma_of_the_data_sheet(true_m, sigma):
    sweep = lidar.add_noise(
        lidar_view(np.full(20_000, true_m)), LidarNoise(), LIMITS, np.random.default_rng(1)
    )
    error = sweep.ranges_m[sweep.kinds == NoiseClass.GOOD] - true_m
    assert error.std() == pytest.approx(sigma, rel=0.03)
    assert abs(error.mean()) < sigma / 20


@pytest.mark.parametrize("true_m", [0.9, 2.0, 4.0])
def test_good_depths_have_the_sigma_that_khoshelham_measured(true_m):
    # A slope, so that the steps of the disparity fall everywhere.
    truth = np.tile(true_m * np.linspace(0.98, 1.02, 400), (100, 1))
    image = depth_camera.add_noise(depth_view(truth), DepthNoise(), np.random.default_rng(2))
    good = image.kinds == NoiseClass.GOOD
    error = (image.depth_m - truth)[good] / truth[good] ** 2
    assert error.std() == pytest.approx(1.425e-3, rel=0.05)


def test_ranges_are_whole_millimetres():
    sweep = lidar.add_noise(
        lidar_view(np.linspace(0.5, 5, 682)), LidarNoise(), LIMITS, np.random.default_rng(3)
    )
    mm = sweep.ranges_m[sweep.kinds != NoiseClass.HOLE] * 1000
    np.testing.assert_allclose(mm, np.rint(mm), atol=1e-6)


def scattered_sweep(seed):
    """A curve with steps, glass and dark pieces."""
    rng = np.random.default_rng(seed)
    true_m = np.repeat(rng.uniform(0.3, 6.5, 62), 11)
    glass = np.repeat(rng.random(62) < 0.2, 11)
    return lidar_view(
        true_m,
        glass=glass,
        dark=~glass & np.repeat(rng.random(62) < 0.2, 11),
        behind_m=np.where(glass, true_m + 1.5, np.nan),
        incidence_cos=np.repeat(rng.random(62), 11),
    )


@pytest.mark.parametrize("seed", range(5))
def test_kinds_of_beams_follow_from_their_values(seed):
    noise = LidarNoise()
    view = scattered_sweep(seed)
    sweep = lidar.add_noise(view, noise, LIMITS, np.random.default_rng(seed))
    np.testing.assert_array_equal(np.isnan(sweep.ranges_m), sweep.kinds == NoiseClass.HOLE)
    off = np.abs(sweep.ranges_m - view.true_m) / np.maximum(0.01, 0.01 * view.true_m)
    surely_off = np.abs(sweep.ranges_m - view.true_m) > SAME_SURFACE_M
    assert not (surely_off & (off > 5.0) & (sweep.kinds == NoiseClass.GOOD)).any()
    assert off[sweep.kinds == NoiseClass.BURR].min() > 3.0
    assert set(np.unique(sweep.kinds)) == {0, 1, 2}
    assert np.nanmax(sweep.ranges_m) <= LIMITS[1]


@pytest.mark.parametrize("seed", range(5))
def test_kinds_of_pixels_follow_from_their_values(seed):
    rng = np.random.default_rng(seed)
    truth = np.kron(rng.uniform(0.3, 9.0, (12, 16)), np.ones((10, 10)))
    dark = np.kron(rng.random((12, 16)) < 0.2, np.ones((10, 10))).astype(bool)
    view = depth_view(truth, dark=dark)
    noise = DepthNoise()
    image = depth_camera.add_noise(view, noise, np.random.default_rng(seed))
    np.testing.assert_array_equal(np.isnan(image.depth_m), image.kinds == NoiseClass.HOLE)
    off = np.abs(image.depth_m - truth) / depth_camera.sigma_m(truth, noise)
    surely_off = np.abs(image.depth_m - truth) > SAME_SURFACE_M
    assert not (surely_off & (off > 6.0) & (image.kinds == NoiseClass.GOOD)).any()
    assert off[image.kinds == NoiseClass.BURR].min() > 3.0
    assert set(np.unique(image.kinds)) == {0, 1, 2}
    assert (image.kinds[(truth < 0.4) | (truth > 8.5)] != NoiseClass.GOOD).all()


def test_without_faults_every_sample_is_good():
    calm = LidarNoise(
        glass_through_fraction=0.0,
        edge_mixed_fraction=0.0,
        spurious_fraction=0.0,
        spike_fraction=0.0,
        lost_runs=0.0,
    )
    true_m = np.repeat([1.0, 3.0], 300)
    sweep = lidar.add_noise(lidar_view(true_m), calm, LIMITS, np.random.default_rng(0))
    assert (sweep.kinds == NoiseClass.GOOD).all()
    still = DepthNoise(
        edge_lost_fraction=0.0,
        edge_mixed_fraction=0.0,
        speckles=0.0,
        patches=0.0,
        spike_fraction=0.0,
    )
    truth = np.full((60, 80), 2.0)
    image = depth_camera.add_noise(depth_view(truth), still, np.random.default_rng(0))
    assert (image.kinds == NoiseClass.GOOD).all()


def test_mixed_beams_lie_between_their_surfaces():
    noise = LidarNoise(spurious_fraction=0.0, spike_fraction=0.0, lost_runs=0.0)
    true_m = np.tile(np.repeat([1.0, 3.0], 10), 200)
    sweep = lidar.add_noise(lidar_view(true_m), noise, LIMITS, np.random.default_rng(4))
    burr = sweep.kinds == NoiseClass.BURR
    assert burr.sum() > 100
    assert ((sweep.ranges_m[burr] > 0.95) & (sweep.ranges_m[burr] < 3.05)).all()
    beside = np.isin(np.arange(true_m.size) % 10, [0, 9])
    assert not burr[~beside].any()


def test_glass_returns_only_near_normal_incidence():
    count = 4000
    quiet = LidarNoise(spurious_fraction=0.0, spike_fraction=0.0, lost_runs=0.0)
    view = lidar_view(
        np.full(count, 2.0),
        glass=np.ones(count, dtype=bool),
        behind_m=np.full(count, 4.0),
        incidence_cos=np.repeat([1.0, 0.7], count // 2),
    )
    kinds = lidar.add_noise(view, quiet, LIMITS, np.random.default_rng(5)).kinds
    assert (kinds[: count // 2] == NoiseClass.GOOD).all()
    oblique = kinds[count // 2 :]
    assert (oblique != NoiseClass.GOOD).all()
    assert (oblique == NoiseClass.BURR).mean() == pytest.approx(0.15, abs=0.03)


@pytest.mark.parametrize(("true_m", "fraction"), [(1.0, 0.37), (4.0, 0.73)])
def test_dark_surfaces_lose_beams_with_their_range(true_m, fraction):
    quiet = LidarNoise(lost_runs=0.0)
    view = lidar_view(np.full(20_000, true_m), dark=np.ones(20_000, dtype=bool))
    kinds = lidar.add_noise(view, quiet, LIMITS, np.random.default_rng(6)).kinds
    assert (kinds == NoiseClass.HOLE).mean() == pytest.approx(fraction, abs=0.02)


def test_a_plane_has_no_edges():
    azimuth = np.linspace(-1.2, 1.2, 400)
    beside, _ = lidar._edges(0.6 / np.cos(azimuth), LidarNoise().edge_jump_per_m)
    assert not beside.any()
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 320), np.linspace(-0.4, 0.4, 240))
    beside, _ = depth_camera._edges(0.4 + 0.9 * u - 0.2 * v, DepthNoise().edge_jump_per_m)
    assert not beside.any()
