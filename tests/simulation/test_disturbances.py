"""Disturbances of both sensors: each against its own rule, a brute-force loop or a closed form."""

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.simulation import depth_camera, lidar
from fusion_core.simulation.depth_camera import DepthNoise
from fusion_core.simulation.disturbances import corner_bias_m, isolated, nearer
from fusion_core.simulation.lidar import LidarNoise
from tests.simulation.views import LIMITS, depth_view, lidar_view

SEEDS = range(6)


def steps(rng, count, low=0.3, high=5.5):
    """A curve of pieces at random ranges."""
    return np.repeat(rng.uniform(low, high, count // 11 + 1), 11)[:count]


@pytest.mark.parametrize("seed", SEEDS)
def test_no_spurious_return_or_spike_lies_behind_the_first_opaque_surface(seed):
    rng = np.random.default_rng(seed)
    true_m = steps(rng, 682, high=9.0)
    glass = rng.random(682) < 0.3
    behind_m = np.where(glass, true_m + rng.uniform(0.5, 3.0, 682), np.nan)
    view = lidar_view(true_m, glass=glass, behind_m=behind_m)
    for noise in (LidarNoise(spurious_fraction=1.0), LidarNoise(spike_fraction=1.0)):
        # Every beam is spurious; of the spikes only the first stays.
        sweep = lidar.add_noise(view, noise, LIMITS, np.random.default_rng(seed))
        opaque_m = np.where(glass, behind_m, true_m)
        early = np.ones(682, bool) if noise.spurious_fraction == 1.0 else np.arange(682) == 0
        seen = early & np.isfinite(sweep.ranges_m)
        assert (sweep.ranges_m[seen] <= opaque_m[seen] + 1e-9).all()


def test_spurious_returns_fill_the_way_to_the_surface_evenly():
    view = lidar_view(np.full(40_000, 2.0))
    noise = LidarNoise(spurious_fraction=1.0, spike_fraction=0.0, lost_runs=0.0)
    sweep = lidar.add_noise(view, noise, LIMITS, np.random.default_rng(1))
    shares, _ = np.histogram(sweep.ranges_m, bins=4, range=(LIMITS[0], 2.0))
    np.testing.assert_allclose(shares / 40_000, 0.25, atol=0.02)


@pytest.mark.parametrize("seed", SEEDS)
def test_mixed_beams_lie_strictly_between_their_two_surfaces_whatever_the_noise(seed):
    rng = np.random.default_rng(seed)
    true_m = steps(rng, 2_000)
    loud = LidarNoise(
        sigma_near_m=0.5,
        edge_mixed_fraction=1.0,
        spurious_fraction=0.0,
        spike_fraction=0.0,
        lost_runs=0.0,
    )
    sweep = lidar.add_noise(lidar_view(true_m), loud, (0.001, 99.0), np.random.default_rng(seed))
    checked = 0
    for i in range(1, len(true_m) - 1):
        before, here, after = true_m[i - 1 : i + 2]
        jump_m = max(abs(before - here), abs(after - here))
        bend = abs(1 / before - 2 / here + 1 / after)
        if bend > loud.edge_jump_per_m and jump_m > 0.002:
            other = before if abs(before - here) > abs(after - here) else after
            assert min(here, other) < sweep.ranges_m[i] < max(here, other)
            checked += 1
    assert checked > 200


@pytest.mark.parametrize("seed", SEEDS)
def test_mixed_pixels_lie_strictly_between_their_two_surfaces_whatever_the_noise(seed):
    rng = np.random.default_rng(seed)
    truth = np.tile(steps(rng, 300, 0.8, 5.0), (40, 1))
    loud = DepthNoise(
        sigma_per_m=0.2,
        edge_lost_fraction=0.0,
        edge_mixed_fraction=1.0,
        speckles=0.0,
        patches=0.0,
        spike_fraction=0.0,
    )
    image = depth_camera.add_noise(depth_view(truth), loud, np.random.default_rng(seed))
    checked = 0
    for column in range(1, 299):
        before, here, after = truth[0, column - 1 : column + 2]
        bend = abs(1 / before - 2 / here + 1 / after)
        jump_m = max(abs(before - here), abs(after - here))
        if bend > loud.edge_jump_per_m and jump_m > 0.002:
            other = before if abs(1 / before - 1 / here) > abs(1 / after - 1 / here) else after
            seen = image.depth_m[:, column][np.isfinite(image.depth_m[:, column])]
            assert (min(here, other) < seen).all()
            assert (seen < max(here, other)).all()
            checked += seen.size
    assert checked > 300


@pytest.mark.parametrize("shape", [(682,), (60, 80)])
@pytest.mark.parametrize("fraction", [0.002, 0.05, 0.6])
def test_isolated_samples_have_no_neighbour(shape, fraction):
    mask = isolated(shape, fraction, np.random.default_rng(3))
    places = np.argwhere(mask)
    for number, place in enumerate(places):
        for other in places[number + 1 :]:
            assert np.abs(place - other).max() > 1
    if fraction == 0.002:
        many = isolated((200_000,), fraction, np.random.default_rng(4))
        assert many.mean() == pytest.approx(fraction, rel=0.1)


def test_nearer_distances_are_uniform_in_their_inverse():
    drawn_m = nearer(np.full(50_000, 4.0), 0.5, np.random.default_rng(5))
    assert (drawn_m >= 0.5).all()
    assert (drawn_m < 4.0).all()
    quartiles = np.quantile(1.0 / drawn_m, [0.25, 0.5, 0.75])
    np.testing.assert_allclose(quartiles, 0.25 + np.array([0.25, 0.5, 0.75]) * 1.75, atol=0.02)


def test_spikes_are_single_burrs_before_the_surface():
    truth = np.full((240, 320), 3.0)
    noise = DepthNoise(spike_fraction=0.005, speckles=0.0, patches=0.0)
    image = depth_camera.add_noise(depth_view(truth), noise, np.random.default_rng(6))
    burr = image.kinds == NoiseClass.BURR
    assert burr.mean() == pytest.approx(0.005, rel=0.2)
    assert (image.depth_m[burr] < 3.0).all()
    beside = np.zeros_like(burr)
    for row, column in np.argwhere(burr):
        around = burr[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        beside[row, column] = around.sum() > 1
    assert not beside.any()


def test_spikes_do_not_shift_the_draws_of_the_other_disturbances():
    true_m = np.linspace(1.0, 5.0, 682)
    with_rain, without = (
        lidar.add_noise(
            lidar_view(true_m),
            LidarNoise(spike_fraction=fraction),
            LIMITS,
            np.random.default_rng(7),
        ).ranges_m
        for fraction in (0.05, 0.0)
    )
    assert 0.9 < np.isclose(with_rain, without, equal_nan=True).mean() < 1.0
    truth = np.full((60, 80), 2.0)
    with_rain, without = (
        depth_camera.add_noise(
            depth_view(truth), DepthNoise(spike_fraction=fraction), np.random.default_rng(7)
        ).depth_m
        for fraction in (0.02, 0.0)
    )
    assert 0.95 < np.isclose(with_rain, without, equal_nan=True).mean() < 1.0


def test_corner_bias_fades_linearly():
    bias_m = corner_bias_m(np.array([0.0, 0.05, 0.1, np.inf]), 0.04, 0.1)
    np.testing.assert_allclose(bias_m, [0.04, 0.02, 0.0, 0.0], atol=1e-12)
    assert corner_bias_m(np.zeros(3), 0.04, 0.0).tolist() == [0.0] * 3


def test_corners_read_too_far_and_time_of_flight_much_more():
    corner_m = np.zeros(40_000)
    ranges = lidar.add_noise(
        lidar_view(np.full(40_000, 2.0), corner_m=corner_m),
        LidarNoise(spurious_fraction=0.0, spike_fraction=0.0, lost_runs=0.0),
        LIMITS,
        np.random.default_rng(8),
    ).ranges_m
    # A slope, so that the steps of the disparity fall everywhere.
    truth = np.tile(2.0 * np.linspace(0.98, 1.02, 200), (200, 1))
    depth_m = depth_camera.add_noise(
        depth_view(truth, corner_m=corner_m.reshape(200, 200)),
        DepthNoise(speckles=0.0, patches=0.0, spike_fraction=0.0),
        np.random.default_rng(8),
    ).depth_m
    assert (ranges - 2.0).mean() == pytest.approx(LidarNoise().corner_bias_m, abs=5e-4)
    assert (depth_m - truth).mean() == pytest.approx(DepthNoise().corner_bias_m, abs=5e-4)
    assert DepthNoise().corner_bias_m < 0.25 * LidarNoise().corner_bias_m


def test_sunlit_beams_are_lost_or_noisy():
    count = 20_000
    quiet = LidarNoise(spurious_fraction=0.0, spike_fraction=0.0, lost_runs=0.0)
    view = lidar_view(np.full(count, 2.0), sunlit=np.ones(count, bool))
    sweep = lidar.add_noise(view, quiet, LIMITS, np.random.default_rng(9))
    assert np.isnan(sweep.ranges_m).mean() == pytest.approx(0.5, abs=0.02)
    assert np.nanstd(sweep.ranges_m) == pytest.approx(3.0 * 0.02, rel=0.05)


def test_sunlit_pixels_are_lost():
    sunlit = np.zeros((100, 100), bool)
    sunlit[:, 30:50] = True
    quiet = DepthNoise(patches=0.0, speckles=0.0, spike_fraction=0.0)
    image = depth_camera.add_noise(
        depth_view(np.full((100, 100), 2.0), sunlit=sunlit), quiet, np.random.default_rng(10)
    )
    lost = image.kinds == NoiseClass.HOLE
    assert lost[sunlit].mean() == pytest.approx(0.95, abs=0.02)
    assert not lost[~sunlit].any()


def test_mirrors_return_beams_near_their_normal_and_the_folded_path_elsewhere():
    count = 4_000
    quiet = LidarNoise(spurious_fraction=0.0, spike_fraction=0.0, lost_runs=0.0)
    view = lidar_view(
        np.full(count, 1.5),
        mirror=np.ones(count, bool),
        behind_m=np.full(count, 3.5),
        incidence_cos=np.repeat([1.0, np.cos(0.06)], count // 2),
    )
    sweep = lidar.add_noise(view, quiet, LIMITS, np.random.default_rng(11))
    front, oblique = slice(0, count // 2), slice(count // 2, None)
    assert (sweep.kinds[front] == NoiseClass.GOOD).all()
    assert (sweep.kinds[oblique] == NoiseClass.HOLE).mean() == pytest.approx(0.1, abs=0.03)
    ghosts = sweep.ranges_m[oblique][sweep.kinds[oblique] == NoiseClass.BURR]
    assert ghosts.size + (sweep.kinds[oblique] == NoiseClass.HOLE).sum() == count // 2
    assert ghosts.mean() == pytest.approx(3.5, abs=0.01)


@pytest.mark.parametrize("incidence_rad", [0.0, 0.5])
def test_panes_and_mirrors_by_angle_before_a_camera(incidence_rad):
    rng = np.random.default_rng(12)
    shape = (200, 200)
    glass = np.zeros(shape, bool)
    glass[:, :100] = True
    view = depth_view(
        np.full(shape, 1.5),
        glass=glass,
        mirror=~glass,
        incidence_cos=np.full(shape, np.cos(incidence_rad)),
        behind_m=np.full(shape, 3.0),
        surface_draw=rng.random(shape),
    )
    quiet = DepthNoise(patches=0.0, speckles=0.0, spike_fraction=0.0)
    kinds = depth_camera.add_noise(view, quiet, rng).kinds
    pane = [(kinds[:, :100] == kind).mean() for kind in range(3)]
    mirror = [(kinds[:, 100:] == kind).mean() for kind in range(3)]
    if incidence_rad == 0.0:
        np.testing.assert_allclose(pane, [0.3, 0.7 * 0.85, 0.7 * 0.15], atol=0.02)
        np.testing.assert_allclose(mirror, [0.0, 1.0, 0.0], atol=0.02)
    else:
        np.testing.assert_allclose(pane, [0.0, 0.85, 0.15], atol=0.02)
        np.testing.assert_allclose(mirror, [0.0, 0.4, 0.6], atol=0.02)


def test_what_a_pane_shows_stays_on_it():
    rng = np.random.default_rng(13)
    shape = (60, 80)
    view = depth_view(
        np.full(shape, 1.5),
        glass=np.ones(shape, bool),
        incidence_cos=np.full(shape, 0.8),
        behind_m=np.full(shape, 3.0),
        surface_draw=rng.random(shape),
    )
    quiet = DepthNoise(patches=0.0, speckles=0.0, spike_fraction=0.0)
    first, second = (
        depth_camera.add_noise(view, quiet, np.random.default_rng(seed)).kinds for seed in (1, 2)
    )
    np.testing.assert_array_equal(first, second)
